// SPDX-License-Identifier: Apache-2.0
// Interface between the plan (portable code) and the kernels (one copy per instruction set).
#pragma once

#include "geraf2/types.hpp"

namespace geraf2::detail {

/// Antenna groups whose coefficients are prepared together: 4 groups of 16 lanes are 6 KiB, which
/// leaves the rest of the first-level cache to the points.
inline constexpr index_t groups_per_tile = 4;

/// Points are worked on in fours, so that one load of an antenna's coefficients serves them all.
inline constexpr index_t point_quantum = 4;

/// Most coefficients per antenna of any tier: 2 x (3 + range order) + 2 x (profile degree + 1).
inline constexpr index_t max_coefficients = 80;

/// Sample pairs of one block of the exact method, which works on groups of pairs folded about the
/// middle of each block: 4 parts of 4 pairs and their 4 mirrors.
inline constexpr index_t pairs_per_fold = 8;

/// Vectors of one group's folded pairs.
inline constexpr index_t folded_vectors(index_t n_pairs) {
    return (n_pairs + pairs_per_fold - 1) / pairs_per_fold * (4 * pairs_per_fold);
}

/// Vectors that kernels need as scratch: coefficients of one tile, or folded pairs of one group.
inline constexpr index_t scratch_vectors(index_t n_pairs) {
    const index_t coefficients = groups_per_tile * max_coefficients;
    const index_t folded = folded_vectors(n_pairs);
    return coefficients < folded ? folded : coefficients;
}

/// Constants for all antennas and points. Phases are counted in half turns.
template <class T>
struct MatchedFilterTables {
    int tier = 0;        ///< index into `tiers`, or into `carrier_tiers` for centres of clusters
    index_t n_pairs = 0; ///< pairs of samples at equal distance from mid-band
    double first_pair = 0.0;            ///< that distance for the first pair: 1/2, or 0 (odd count)
    double half_turns_per_m = 0.0;      ///< carrier at mid-band, 2 f / c
    double step_half_turns_per_m = 0.0; ///< from sample to sample, 2 k dt / c
    double path_bias_m = 0.0;
    double range_limit = 0.0;    ///< largest phase error of both range series together [rad]
    double range_economy = 0.0;  ///< share of the first dropped term given to its neighbour
    double range_residual = 0.0; ///< residual of that term
    const T* profile = nullptr;  ///< (n_pairs, profile degree + 1) coefficients in half turns
};

/// Antennas in groups of `lanes`; the last group repeats its last antenna with a zero signal.
template <class T>
struct PackedAntennas {
    index_t n_groups = 0;
    const double* positions = nullptr; ///< (n_groups, 6, lanes): tx x, y, z, rx x, y, z [m]
    const T* signal = nullptr; ///< (n_groups, n_pairs, 4, lanes): re, im of s(+m) + s(-m), then of
                               ///< s(+m) - s(-m); see docs/math/matched-filter.md#pairs-of-samples
    index_t n_signals = 1;     ///< of the same antennas, one after another; the exact method only
};

/// Points near one centre; n_points is a multiple of point_quantum.
template <class T>
struct PointBlock {
    double center[3] = {};
    double radius = 0.0; ///< no point lies farther from the centre [m]
    index_t n_points = 0;
    const T* offsets = nullptr; ///< (n_points, 4): x - center and its square
};

/// Points centre + (offsets[0][i], offsets[1][j], offsets[2][k]); the last axis runs fastest.
template <class T>
struct PointTensor {
    double center[3] = {};
    double radius = 0.0; ///< no point lies farther from the centre [m]
    index_t count[3] = {};
    const T* offsets[3] = {}; ///< (count[axis]) [m]
};

/// Kernels for T at one instruction set. Inputs first, outputs last; group ranges are half open.
template <class T>
struct MatchedFilterKernels {
    int lanes;

    /// Adds the antennas' contributions to `image`, (n_points, 2, lanes): the sum over lanes is
    /// the caller's. `scratch`: (scratch_vectors, lanes).
    void (*block_fwd)(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
                      index_t group_begin, index_t group_end, const PointBlock<T>& block,
                      T* scratch, T* image);

    /// The same without approximation. points: (n_points, 3) [m], n_points a multiple of
    /// point_quantum. image: (n_signals, n_points, 2, lanes). Scratch for each of the signals.
    void (*exact_fwd)(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
                      index_t group_begin, index_t group_end, const double* points,
                      index_t n_points, T* scratch, T* image);

    /// Adjoint of block_fwd: adds to `signal`, laid out as PackedAntennas::signal.
    /// image: (n_points, 2); in the tiers for nodes (n_points, 2, lanes).
    void (*block_bwd)(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
                      index_t group_begin, index_t group_end, const PointBlock<T>& block,
                      const T* image, T* scratch, T* signal);

    /// Adjoint of exact_fwd; image: (n_signals, n_points, 2).
    void (*exact_bwd)(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
                      index_t group_begin, index_t group_end, const double* points,
                      index_t n_points, const T* image, T* scratch, T* signal);

    /// Gradient to positions of Re sum conj(image_grad) P. Adds to `points_grad`,
    /// (n_points, 3, lanes), and to `antennas_grad`, laid out as PackedAntennas::positions in T;
    /// either may be null.
    void (*positions_bwd)(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
                          index_t group_begin, index_t group_end, const double* points,
                          index_t n_points, const T* image_grad, T* scratch, T* points_grad,
                          T* antennas_grad);

    // The factorised method works on `lanes` clusters of antennas side by side.

    /// to[p] += sum_k weights[p, k] from[k]; weights: (n_to, n_from), from and to: rows of
    /// n_values numbers, a multiple of lanes.
    void (*contract)(index_t n_from, index_t n_to, index_t n_values, const T* weights,
                     const T* from, T* to);

    /// Interpolates along the last axis and multiplies by exp(j carrier phase of the clusters'
    /// centres). clusters: (6, lanes), as PackedAntennas::positions; rows: (count[0], count[1],
    /// n_nodes, 2, lanes); weights: (count[2], n_nodes). Adds to `sums`, (points, 2, lanes).
    void (*expand_fwd)(const MatchedFilterTables<T>& tables, const double* clusters,
                       const PointTensor<T>& points, index_t n_nodes, const T* weights,
                       const T* rows, T* sums);

    /// Adjoint of expand_fwd: adds to `rows`. values: (points, 2, lanes) if `per_lane`, else
    /// (points, 2).
    void (*expand_bwd)(const MatchedFilterTables<T>& tables, const double* clusters,
                       const PointTensor<T>& points, index_t n_nodes, const T* weights,
                       bool per_lane, const T* values, T* rows);

    /// Multiplies `values`, (points, 2, lanes), by exp(sign j carrier phase) of the clusters.
    void (*modulate)(const MatchedFilterTables<T>& tables, const double* clusters,
                     const PointTensor<T>& points, int sign, T* values);

    /// Sums over lanes: (n, lanes) to (n).
    void (*sum_lanes)(index_t n, const T* from, T* to);
};

} // namespace geraf2::detail
