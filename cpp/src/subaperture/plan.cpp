// SPDX-License-Identifier: Apache-2.0
#include "subaperture/plan.hpp"

#include <array>
#include <cmath>
#include <numbers>

namespace geraf2::detail {
namespace {

index_t padded(index_t n, index_t quantum) noexcept {
    return (n + quantum - 1) / quantum * quantum;
}

/// Hann weight of sample t of n, without zero ends; they sum to (n + 1) / 2.
double hann(double t, index_t n) noexcept {
    const double s = std::sin(std::numbers::pi * (t + 1.0) / (static_cast<double>(n) + 1.0));
    return s * s;
}

/// Integral of spread_kernel(2 x / width) cos(phase x) over x, as a function of the phase; the
/// integrand ends with a kink of exp(-exponent), which is below the resolution of float.
class KernelTransform {
public:
    KernelTransform(int width, double exponent) : width_(width) {
        for (int i = 0; i < n; ++i) {
            values_[static_cast<std::size_t>(i)] = spread_kernel(place(i), exponent);
        }
    }

    [[nodiscard]] double operator()(double phase) const noexcept {
        double sum = 0.0;
        for (int i = 0; i < n; ++i) {
            sum += values_[static_cast<std::size_t>(i)] * std::cos(0.5 * phase * width_ * place(i));
        }
        return sum * width_ / n;
    }

private:
    static constexpr int n = 512;
    static double place(int i) noexcept { return (i + 0.5) / n; } // half of an even function

    int width_;
    std::array<double, n> values_{};
};

} // namespace

double spread_kernel(double x, double exponent) noexcept {
    const double square = 1.0 - x * x;
    return square > 0.0 ? std::exp(exponent * (std::sqrt(square) - 1.0)) : 0.0;
}

template <class T>
AxisTables<T>::AxisTables(const CosineAxis& cosines, index_t n_rows, double spacing_m,
                          double radians_per_m, int width, double exponent, int cosines_per_block)
    : cosine_(padded(cosines.mirror_sum() / 2 + 1, cosines_per_block) * (n_rows / 2)),
      sine_(cosine_.size()), middle_(padded(cosines.mirror_sum() / 2 + 1, cosines_per_block)) {
    view_.n_rows = n_rows;
    view_.n_cosines = cosines.mirror_sum() / 2 + 1;
    view_.count = cosines.count;
    view_.mirror_sum = cosines.mirror_sum();
    view_.cosine = cosine_.data();
    view_.sine = sine_.data();
    view_.middle = middle_.data();
    const index_t n_pairs = n_rows / 2;
    const KernelTransform transform(width, exponent);
    for (index_t u = 0; u < view_.n_cosines; ++u) {
        const double per_row = -cosines.at(u) * spacing_m * radians_per_m;
        const double gain = width > 1 ? 1.0 / transform(per_row) : 1.0;
        const index_t block = u / cosines_per_block;
        for (index_t p = 0; p < n_pairs; ++p) {
            const double x = 0.5 * static_cast<double>(n_rows - 1) - static_cast<double>(p);
            const index_t to = (block * n_pairs + p) * cosines_per_block + u % cosines_per_block;
            cosine_.data()[to] = static_cast<T>(gain * std::cos(per_row * x));
            sine_.data()[to] = static_cast<T>(gain * std::sin(per_row * x));
        }
        middle_.data()[u] = static_cast<T>(gain);
    }
}

template <class T>
SubaperturePlan<T>::SubaperturePlan(const Waveform& waveform, const SubapertureLattice& lattice,
                                    const SubapertureBins& bins,
                                    const SubapertureKernels<T>& kernels)
    : n_samples_(waveform.n_samples),
      half_turns_per_m_((waveform.frequency_hz(0) + waveform.frequency_hz(n_samples_ - 1)) /
                        speed_of_light),
      step_half_turns_per_m_(2.0 * waveform.chirp_slope_hz_per_s / waveform.sample_rate_hz /
                             speed_of_light),
      ranges_{padded((n_samples_ + 1) / 2, kernels.lanes), padded(bins.ranges.count, kernels.lanes),
              n_samples_ % 2 == 0 ? T(0.5) : T(0), nullptr, nullptr},
      range_cosine_(ranges_.n_pairs * ranges_.n_ranges), range_sine_(range_cosine_.size()),
      horizontal_(bins.horizontal, lattice.n_horizontal, lattice.horizontal_spacing_m,
                  2.0 * std::numbers::pi * half_turns_per_m_, lattice.spread_width,
                  lattice.spread_exponent, kernels.cosines_per_block),
      vertical_(bins.vertical, lattice.n_vertical, lattice.vertical_spacing_m,
                2.0 * std::numbers::pi * half_turns_per_m_, lattice.spread_width,
                lattice.spread_exponent, kernels.cosines_per_block) {
    ranges_.cosine = range_cosine_.data();
    ranges_.sine = range_sine_.data();
    const double first = n_samples_ % 2 == 0 ? 0.5 : 0.0;
    const double middle = 0.5 * static_cast<double>(n_samples_ - 1);
    for (index_t p = 0; p < (n_samples_ + 1) / 2; ++p) {
        const double m = first + static_cast<double>(p);
        const double weight =
            hann(middle + m, n_samples_) / (0.5 * (static_cast<double>(n_samples_) + 1.0));
        for (index_t r = 0; r < bins.ranges.count; ++r) {
            const double path =
                2.0 * (bins.ranges.first_m + static_cast<double>(r) * bins.ranges.pitch_m);
            // The phase at mid-band is the same for all antennas: the magnitude does without it.
            const double phase = std::numbers::pi * m * step_half_turns_per_m_ * path;
            range_cosine_.data()[p * ranges_.n_ranges + r] =
                static_cast<T>(weight * std::cos(phase));
            range_sine_.data()[p * ranges_.n_ranges + r] = static_cast<T>(weight * std::sin(phase));
        }
    }
}

template <class T>
AlignedBuffer<T> SubaperturePlan<T>::pack(std::span<const std::complex<T>> signal) const {
    const index_t n_antennas = static_cast<index_t>(signal.size()) / n_samples_;
    const index_t n = ranges_.n_pairs;
    AlignedBuffer<T> out(n_antennas * 4 * n);
    for (index_t a = 0; a < n_antennas; ++a) {
        const std::complex<T>* from = signal.data() + a * n_samples_;
        T* to = out.data() + a * 4 * n;
        for (index_t p = 0; p < (n_samples_ + 1) / 2; ++p) {
            const std::complex<T> high = from[n_samples_ / 2 + p];
            const index_t below = (n_samples_ - 1) / 2 - p;
            // The middle sample of an odd count has no partner.
            const std::complex<T> low =
                below == n_samples_ / 2 + p ? std::complex<T>{} : from[below];
            to[p] = high.real() + low.real();
            to[n + p] = high.imag() + low.imag();
            to[2 * n + p] = high.real() - low.real();
            to[3 * n + p] = high.imag() - low.imag();
        }
    }
    return out;
}

template class AxisTables<float>;
template class AxisTables<double>;
template class SubaperturePlan<float>;
template class SubaperturePlan<double>;

} // namespace geraf2::detail
