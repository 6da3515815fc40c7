// SPDX-License-Identifier: Apache-2.0
// Interface between the tracer's driver (portable) and its kernels (one copy per instruction set).
#pragma once

#include "geraf2/types.hpp"
#include "matched_filter/kernels.hpp"

namespace geraf2::detail {

enum class AmplitudeKind {
    shared,          ///< (n_points, 2): real and imaginary part, the same for all antennas
    antenna_real,    ///< (n_groups, stride, lanes), in the caller's order of points
    antenna_complex, ///< (n_groups, stride, 2, lanes), likewise
};

/// One block of reflecting points; n_points of `block` is a multiple of point_quantum, and the
/// amplitude of the padding is zero: for the antenna kinds all of it has one index, the last.
template <class T>
struct ReflectorBlock {
    PointBlock<T> block;
    const double* positions = nullptr; ///< (n_points, 3) [m]
    const T* normals = nullptr;        ///< (n_points, 3), or null: no specular factor
    const T* amplitude = nullptr;      ///< by `kind`
    AmplitudeKind kind = AmplitudeKind::shared;
    const index_t* place = nullptr; ///< antenna kinds: each point's index among the amplitudes
    index_t stride = 0; ///< antenna kinds: points from one group's amplitudes to the next's
    bool exact = false; ///< too few points for the block method
};

/// Sums over antennas per point: amplitude (2), normal (3), position (3).
inline constexpr index_t sums_per_point = 8;

/// Outputs of the gradients; null where not wanted.
template <class T>
struct ReflectorSums {
    double* points = nullptr; ///< (n_points, sums_per_point), added to
    T* amplitude = nullptr;   ///< laid out as ReflectorBlock::amplitude of an antenna kind; set
    T* antennas = nullptr;    ///< laid out as PackedAntennas::positions in T; added to
    bool positions = false;   ///< gradients to positions are wanted
    bool shared = false;      ///< the sum over antennas of the amplitude's gradient is wanted
    bool normals = false;     ///< gradients to normals are wanted
};

/// Groups of antennas that a backward takes at most: the more, the less often it sums over lanes.
inline constexpr index_t groups_per_gather = 2 * groups_per_tile;

/// Kernels for T at one instruction set; group ranges are half open and at most groups_per_tile
/// long, those of `bwd` groups_per_gather. `scratch`: (scratch_vectors, lanes).
template <class T>
struct SignalTracerKernels {
    int lanes;

    /// Adds the block's echo to `signal`, laid out as PackedAntennas::signal. It begins at
    /// group_begin, and so do amplitudes of an antenna kind.
    void (*fwd)(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
                index_t group_begin, index_t group_end, const ReflectorBlock<T>& reflectors,
                T* scratch, T* signal);

    /// Backward of fwd; antennas.signal is the gradient to the signal.
    void (*bwd)(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
                index_t group_begin, index_t group_end, const ReflectorBlock<T>& reflectors,
                T* scratch, const ReflectorSums<T>& sums);

    /// From `rows`, (n_rows, n_values) with n_rows <= lanes, to (n_values, lanes); lanes beyond
    /// n_rows repeat the last row.
    void (*pack_rows)(const T* rows, index_t n_values, int n_rows, T* to);

    /// The inverse; lanes beyond n_rows are left out.
    void (*unpack_rows)(const T* from, index_t n_values, int n_rows, T* rows);
};

} // namespace geraf2::detail
