// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <complex>
#include <functional>
#include <memory>
#include <span>
#include <variant>

#include "geraf2/antennas.hpp"
#include "geraf2/voxel_grid.hpp"
#include "geraf2/wave.hpp"

namespace geraf2 {

/// A list (n_points, 3) [m], or a grid, whose blocks need no sorting.
using PointSet = std::variant<std::span<const double>, VoxelGrid>;

enum class MatchedFilterMethod {
    automatic,  ///< the cheapest: see choose_matched_filter
    exact,      ///< phasor recurrence over the samples, to rounding
    block,      ///< polynomials per block of points, to rtol
    factorised, ///< images of clusters of antennas, interpolated over boxes of a grid, to rtol
};

struct MatchedFilterOptions {
    MatchedFilterMethod method = MatchedFilterMethod::automatic;
    double rtol = 1e-3; ///< largest error of a phasor exp(j phase), but for `exact`
    int num_threads = 1;
    double max_memory_bytes = 1e9; ///< working memory of the factorised method
    int levels = 2;                ///< of clusters in the factorised method: 1, or 2 where it pays
    std::function<void(double)> progress = {}; ///< called with the share done between steps of
                                               ///< matched_filter_fwd, on the calling thread
};

/// What the automatic method takes, and the costs by which it chose, in multiply-adds of one lane.
struct MatchedFilterChoice {
    MatchedFilterMethod method = MatchedFilterMethod::block;
    double exact_cost = 0.0;
    double block_cost = 0.0;
    double factorised_cost = 0.0; ///< infinite where it is out of question: points are a list, or
                                  ///< too few for their plan to pay
    double exact_share = 0.0;     ///< share of a list's points that `automatic` images by `exact`,
                                  ///< as their blocks would be too empty
    double block_share = 0.0;     ///< share of the voxels too near for the factorised method, which
                                  ///< leaves them to `block`
};

/// Depends on sizes, geometry, waveform and rtol, and on nothing else.
template <class T>
MatchedFilterChoice choose_matched_filter(const AntennaPositions& antennas, const PointSet& points,
                                          const Waveform& waveform,
                                          const MatchedFilterOptions& options);

/// Everything of an image but its signal, prepared once for many signals of the same antennas at
/// the same points. Holds copies of the positions. Its functions change nothing: several threads
/// may call them at once. T: float or double.
template <class T>
class MatchedFilterPlan {
public:
    /// options.progress is not used.
    MatchedFilterPlan(const AntennaPositions& antennas, const PointSet& points,
                      const Waveform& waveform, const MatchedFilterOptions& options);
    ~MatchedFilterPlan();
    MatchedFilterPlan(MatchedFilterPlan&&) noexcept;
    MatchedFilterPlan& operator=(MatchedFilterPlan&&) noexcept;
    MatchedFilterPlan(const MatchedFilterPlan&) = delete;
    MatchedFilterPlan& operator=(const MatchedFilterPlan&) = delete;

    [[nodiscard]] index_t n_antennas() const noexcept;
    [[nodiscard]] index_t n_samples() const noexcept;
    [[nodiscard]] index_t n_points() const noexcept;

    /// What matched_filter_fwd computes.
    void image(std::span<const std::complex<T>> signal, // (n_antennas, n_samples)
               const std::function<void(double)>& progress,
               std::span<std::complex<T>> image) const; // (n_points)

    /// What matched_filter_bwd_signal computes.
    void adjoint(std::span<const std::complex<T>> image,   // (n_points)
                 std::span<std::complex<T>> signal) const; // (n_antennas, n_samples)

private:
    struct Impl;
    std::unique_ptr<const Impl> impl_;
};

/// Matched-filter image: P(x) = 1/N sum_i sum_t s_i(t) exp(+j 2 pi f(t) d_i(x) / c), with
/// d_i(x) = |x - tx_i| + |x - rx_i| + path_bias and N antennas
/// (docs/math/matched-filter.md#matched-filter).
///
/// The result does not depend on num_threads, not even in its last bit. T: float or double.
template <class T>
void matched_filter_fwd(std::span<const std::complex<T>> signal, // (n_antennas, n_samples)
                        const AntennaPositions& antennas, const PointSet& points,
                        const Waveform& waveform, const MatchedFilterOptions& options,
                        std::span<std::complex<T>> image); // (n_points)

/// Adjoint: s_i(t) = 1/N sum_x P(x) exp(-j 2 pi f(t) d_i(x) / c), the same approximation as
/// matched_filter_fwd with the same options.
template <class T>
void matched_filter_bwd_signal(std::span<const std::complex<T>> image, // (n_points)
                               const AntennaPositions& antennas, const PointSet& points,
                               const Waveform& waveform, const MatchedFilterOptions& options,
                               std::span<std::complex<T>> signal); // (n_antennas, n_samples)

/// Gradients to positions of L, where image_grad = dL/dRe P + j dL/dIm P; the method is exact.
/// Spans of outputs that are not wanted are empty. A point on an antenna adds nothing to the
/// gradient along their distance.
struct PositionGradients {
    std::span<double> tx;     ///< (n_antennas, 3)
    std::span<double> rx;     ///< (n_antennas, 3)
    std::span<double> points; ///< (n_points, 3)
};

template <class T>
void matched_filter_bwd_positions(std::span<const std::complex<T>> image_grad, // (n_points)
                                  std::span<const std::complex<T>> signal,
                                  const AntennaPositions& antennas, const PointSet& points,
                                  const Waveform& waveform, int num_threads,
                                  const PositionGradients& gradients);

/// Images of several signals of the same antennas at the same points, by the exact method: what
/// belongs to antenna and point is computed once for all of them. The result does not depend on
/// num_threads.
template <class T>
void point_images_fwd(
    std::span<const std::complex<T>> signals, // (n_signals, n_antennas, n_samples)
    index_t n_signals, const AntennaPositions& antennas,
    std::span<const double> points, // (n_points, 3) [m]
    const Waveform& waveform, int num_threads,
    std::span<std::complex<T>> images); // (n_signals, n_points)

/// Adjoint of point_images_fwd.
template <class T>
void point_images_bwd(std::span<const std::complex<T>> images, index_t n_signals,
                      const AntennaPositions& antennas, std::span<const double> points,
                      const Waveform& waveform, int num_threads,
                      std::span<std::complex<T>> signals);

} // namespace geraf2
