// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <complex>
#include <span>
#include <vector>

#include "common/aligned_buffer.hpp"
#include "geraf2/subaperture.hpp"
#include "subaperture/kernels.hpp"

namespace geraf2::detail {

/// Tables of one lattice axis.
template <class T>
class AxisTables {
public:
    /// radians_per_m: phase of a unit cosine. Spread lattices are divided by the transform of
    /// their kernel, with `width` and `exponent` as in SubapertureLattice.
    AxisTables(const CosineAxis& cosines, index_t n_rows, double spacing_m, double radians_per_m,
               int width, double exponent, int cosines_per_block);

    [[nodiscard]] const AxisSum<T>& view() const noexcept { return view_; }

private:
    AlignedBuffer<T> cosine_, sine_, middle_;
    AxisSum<T> view_;
};

/// What all sub-apertures of a pose share.
template <class T>
class SubaperturePlan {
public:
    SubaperturePlan(const Waveform& waveform, const SubapertureLattice& lattice,
                    const SubapertureBins& bins, const SubapertureKernels<T>& kernels);

    [[nodiscard]] const RangeTables<T>& ranges() const noexcept { return ranges_; }
    [[nodiscard]] const AxisSum<T>& horizontal() const noexcept { return horizontal_.view(); }
    [[nodiscard]] const AxisSum<T>& vertical() const noexcept { return vertical_.view(); }
    [[nodiscard]] double half_turns_per_m() const noexcept { return half_turns_per_m_; }
    [[nodiscard]] double step_half_turns_per_m() const noexcept { return step_half_turns_per_m_; }

    /// Sums and differences of sample pairs, (n_antennas, 4, n_pairs).
    [[nodiscard]] AlignedBuffer<T> pack(std::span<const std::complex<T>> signal) const;

private:
    index_t n_samples_;
    double half_turns_per_m_;      ///< at mid-band, of a path
    double step_half_turns_per_m_; ///< from sample to sample
    RangeTables<T> ranges_;
    AlignedBuffer<T> range_cosine_, range_sine_;
    AxisTables<T> horizontal_, vertical_;
};

/// exp(exponent (sqrt(1 - x^2) - 1)) at x in [-1, 1], 0 beyond.
double spread_kernel(double x, double exponent) noexcept;

/// Appends the peaks of one image to `peaks`; `columns` is scratch. magnitudes: rows of
/// `stride` values.
template <class T>
void append_peaks(const T* magnitudes, index_t stride, const SubapertureBins& bins,
                  const PeakThresholds& thresholds, index_t subaperture, std::vector<T>& columns,
                  SubaperturePeaks& peaks);

} // namespace geraf2::detail
