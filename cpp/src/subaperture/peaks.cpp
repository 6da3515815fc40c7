// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>
#include <type_traits>

#include "geraf2/subaperture.hpp"
#include "simd/dispatch.hpp"
#include "subaperture/kernels.hpp"
#include "subaperture/plan.hpp"

namespace geraf2 {
namespace {

using detail::kernels_for_cpu;
using detail::SubapertureKernels;

std::size_t at(index_t i) noexcept { return static_cast<std::size_t>(i); }

/// Root mean square of the noise in each range bin. Median power of complex Gaussian noise is ln 2
/// of the mean; a median of even count is the mean of its two middle values.
template <class T>
void noise_floors(const T* magnitudes, index_t stride, const SubapertureBins& bins,
                  std::vector<T>& columns, std::span<double> floor) {
    // A fixed subset of the directions is enough: the median of 400 values errs by 6 %.
    constexpr index_t every = 4;
    const auto& kernels = kernels_for_cpu<SubapertureKernels<T>>();
    const index_t n_directions = bins.horizontal.count * bins.vertical.count;
    const index_t n_used = (n_directions + every - 1) / every;
    const index_t width = (bins.ranges.count + kernels.lanes - 1) / kernels.lanes * kernels.lanes;
    columns.resize(at((n_used + 2) * width));
    for (index_t d = 0; d < n_used; ++d) {
        std::copy_n(magnitudes + d * every * stride, bins.ranges.count, columns.data() + d * width);
    }
    T* const middle = columns.data() + n_used * width;
    T* const before = middle + width;
    kernels.middle_values(columns.data(), n_used, width, middle, before);
    for (index_t r = 0; r < bins.ranges.count; ++r) {
        double power = static_cast<double>(middle[r]) * static_cast<double>(middle[r]);
        if (n_used % 2 == 0) {
            power = 0.5 * (power + static_cast<double>(before[r]) * static_cast<double>(before[r]));
        }
        floor[at(r)] = std::sqrt(power / std::numbers::ln2);
    }
}

/// Position of the maximum of a parabola through three log magnitudes, within one bin.
template <class T>
double vertex(T before, T middle, T after) noexcept {
    // Guards the logarithm of an exact zero.
    constexpr T tiny = std::numeric_limits<T>::min();
    const double low = std::log(static_cast<double>(std::max(before, tiny)));
    const double mid = std::log(static_cast<double>(std::max(middle, tiny)));
    const double high = std::log(static_cast<double>(std::max(after, tiny)));
    const double curvature = low - 2.0 * mid + high;
    return curvature < 0.0 ? std::clamp(0.5 * (low - high) / curvature, -1.0, 1.0) : 0.0;
}

/// One image, and its peaks.
template <class T>
struct PeakSearch {
    const T* magnitudes;
    index_t stride;
    const SubapertureBins& bins;

    [[nodiscard]] const T* row(index_t i, index_t j) const noexcept {
        return magnitudes + (i * bins.vertical.count + j) * stride;
    }

    /// Rows of the directions around one, that row in the middle.
    [[nodiscard]] std::array<const T*, 9> around(index_t i, index_t j) const noexcept {
        const auto wrapped = [](index_t k, index_t n) { return k < 0 ? n - 1 : k < n ? k : 0; };
        std::array<const T*, 9> rows{};
        for (index_t n = 0; n < 9; ++n) {
            rows[at(n)] = row(wrapped(i + n / 3 - 1, bins.horizontal.count),
                              wrapped(j + n % 3 - 1, bins.vertical.count));
        }
        return rows;
    }

    /// rows: from `around`.
    static bool is_maximum(const std::array<const T*, 9>& rows, index_t k) noexcept {
        const T value = rows[4][k];
        if (!(value >= rows[4][k - 1] && value >= rows[4][k + 1])) { // rejects most at once
            return false;
        }
        return std::ranges::all_of(rows, [&](const T* row) {
            return value >= row[k - 1] && value >= row[k] && value >= row[k + 1];
        });
    }

    /// Appends the peak refined below one bin, unless its direction cosines exceed 1.
    void append(const std::array<const T*, 9>& rows, index_t i, index_t j, index_t k, double noise,
                index_t subaperture, SubaperturePeaks& peaks) const {
        const T value = rows[4][k];
        const double u =
            bins.horizontal.at(i) + bins.horizontal.pitch * vertex(rows[1][k], value, rows[7][k]);
        const double v =
            bins.vertical.at(j) + bins.vertical.pitch * vertex(rows[3][k], value, rows[5][k]);
        if (u * u + v * v >= 1.0) {
            return;
        }
        const double shift = vertex(rows[4][k - 1], value, rows[4][k + 1]);
        peaks.subapertures.push_back(subaperture);
        peaks.cosines.insert(peaks.cosines.end(), {u, v});
        peaks.ranges_m.push_back(bins.ranges.first_m +
                                 bins.ranges.pitch_m * (static_cast<double>(k) + shift));
        peaks.magnitudes.push_back(static_cast<double>(value));
        peaks.noise.push_back(noise);
    }
};

/// Largest magnitude; NaN if any is not a number. Without the sign, which NaN may have, numbers are
/// in the order of their bits, NaN above all; a maximum of integers is vectorised, one of floats is
/// not.
template <class T>
double top_of(const T* magnitudes, index_t stride, const SubapertureBins& bins) {
    using Bits = std::conditional_t<sizeof(T) == 4, std::uint32_t, std::uint64_t>;
    constexpr Bits magnitude_bits = std::numeric_limits<Bits>::max() >> 1U;
    Bits top = 0;
    for (index_t d = 0; d < bins.horizontal.count * bins.vertical.count; ++d) {
        const T* const row = magnitudes + d * stride;
        for (index_t r = 0; r < bins.ranges.count; ++r) {
            top = std::max(top, std::bit_cast<Bits>(row[r]) & magnitude_bits);
        }
    }
    return static_cast<double>(std::bit_cast<T>(top));
}

} // namespace

template <class T>
void detail::append_peaks(const T* magnitudes, index_t stride, const SubapertureBins& bins,
                          const PeakThresholds& thresholds, index_t subaperture,
                          std::vector<T>& columns, SubaperturePeaks& peaks) {
    const PeakSearch<T> search{magnitudes, stride, bins};
    const double top = top_of(magnitudes, stride, bins);
    peaks.tops.push_back(top);
    if (std::isnan(top)) {
        return;
    }
    std::vector<double> floor(at(bins.ranges.count));
    noise_floors<T>(magnitudes, stride, bins, columns, floor);
    std::vector<T> threshold;
    threshold.reserve(floor.size());
    for (const double noise : floor) {
        threshold.push_back(static_cast<T>(
            std::max(top * thresholds.dynamic_range, noise * thresholds.noise_margin)));
    }
    const index_t margin_h = bins.horizontal.wraps ? 0 : 1;
    const index_t margin_v = bins.vertical.wraps ? 0 : 1;
    const T* const limit = threshold.data();
    for (index_t i = margin_h; i < bins.horizontal.count - margin_h; ++i) {
        for (index_t j = margin_v; j < bins.vertical.count - margin_v; ++j) {
            const T* const row = search.row(i, j);
            int n_above = 0; // counted without a branch: most rows hold none
            for (index_t k = 1; k < bins.ranges.count - 1; ++k) {
                n_above += row[k] > limit[k] ? 1 : 0;
            }
            if (n_above == 0) {
                continue;
            }
            const auto rows = search.around(i, j);
            for (index_t k = 1; k < bins.ranges.count - 1; ++k) {
                if (row[k] > limit[k] && search.is_maximum(rows, k)) {
                    search.append(rows, i, j, k, floor[at(k)], subaperture, peaks);
                }
            }
        }
    }
}

template <class T>
SubaperturePeaks image_peaks(std::span<const T> magnitudes, const SubapertureBins& bins,
                             const PeakThresholds& thresholds) {
    SubaperturePeaks peaks;
    std::vector<T> columns;
    detail::append_peaks(magnitudes.data(), bins.ranges.count, bins, thresholds, 0, columns, peaks);
    return peaks;
}

template <class T>
void noise_floor(std::span<const T> magnitudes, const SubapertureBins& bins,
                 std::span<double> floor) {
    if (std::isnan(top_of(magnitudes.data(), bins.ranges.count, bins))) { // has no median
        std::fill(floor.begin(), floor.end(), std::numeric_limits<double>::quiet_NaN());
        return;
    }
    std::vector<T> columns;
    noise_floors(magnitudes.data(), bins.ranges.count, bins, columns, floor);
}

template void detail::append_peaks(const float*, index_t, const SubapertureBins&,
                                   const PeakThresholds&, index_t, std::vector<float>&,
                                   SubaperturePeaks&);
template void detail::append_peaks(const double*, index_t, const SubapertureBins&,
                                   const PeakThresholds&, index_t, std::vector<double>&,
                                   SubaperturePeaks&);
template SubaperturePeaks image_peaks(std::span<const float>, const SubapertureBins&,
                                      const PeakThresholds&);
template SubaperturePeaks image_peaks(std::span<const double>, const SubapertureBins&,
                                      const PeakThresholds&);
template void noise_floor(std::span<const float>, const SubapertureBins&, std::span<double>);
template void noise_floor(std::span<const double>, const SubapertureBins&, std::span<double>);

} // namespace geraf2
