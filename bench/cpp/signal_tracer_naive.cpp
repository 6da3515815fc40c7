// SPDX-License-Identifier: Apache-2.0
#include "signal_tracer_naive.hpp"

#include <algorithm>
#include <cmath>

namespace geraf2::bench {
namespace {

float distance(const float* a, const float* b) {
    return std::sqrt((a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1]) +
                     (a[2] - b[2]) * (a[2] - b[2]));
}

/// 2 pi f(t) / c = start + step t [rad/m].
struct WaveNumbers {
    float start, step, bias;

    explicit WaveNumbers(const Waveform& waveform) {
        const double per_hz = 2.0 * 3.14159265358979323846 / speed_of_light;
        start = static_cast<float>(per_hz * waveform.start_frequency_hz);
        step = static_cast<float>(per_hz * waveform.chirp_slope_hz_per_s / waveform.sample_rate_hz);
        bias = static_cast<float>(waveform.path_bias_m);
    }
};

} // namespace

void signal_tracer_naive(std::span<const float> amplitude, std::span<const float> tx,
                         std::span<const float> rx, std::span<const float> points,
                         const Waveform& waveform, std::span<std::complex<float>> signal) {
    const auto n_samples = static_cast<std::size_t>(waveform.n_samples);
    const WaveNumbers k(waveform);
    std::fill(signal.begin(), signal.end(), std::complex<float>{});
    for (std::size_t antenna = 0; antenna < tx.size() / 3; ++antenna) {
        std::complex<float>* s = signal.data() + antenna * n_samples;
        for (std::size_t point = 0; point < amplitude.size(); ++point) {
            const float* x = points.data() + 3 * point;
            const float path = distance(x, tx.data() + 3 * antenna) +
                               distance(x, rx.data() + 3 * antenna) + k.bias;
            for (std::size_t t = 0; t < n_samples; ++t) {
                const float phase = -(k.start + k.step * static_cast<float>(t)) * path;
                s[t] += std::complex<float>(amplitude[point] * std::cos(phase),
                                            amplitude[point] * std::sin(phase));
            }
        }
    }
}

void signal_tracer_naive_bwd(std::span<const std::complex<float>> signal_grad,
                             std::span<const float> tx, std::span<const float> rx,
                             std::span<const float> points, const Waveform& waveform,
                             std::span<float> amplitude_grad) {
    const auto n_samples = static_cast<std::size_t>(waveform.n_samples);
    const WaveNumbers k(waveform);
    std::fill(amplitude_grad.begin(), amplitude_grad.end(), 0.0F);
    for (std::size_t antenna = 0; antenna < tx.size() / 3; ++antenna) {
        const std::complex<float>* g = signal_grad.data() + antenna * n_samples;
        for (std::size_t point = 0; point < amplitude_grad.size(); ++point) {
            const float* x = points.data() + 3 * point;
            const float path = distance(x, tx.data() + 3 * antenna) +
                               distance(x, rx.data() + 3 * antenna) + k.bias;
            float sum = 0.0F;
            for (std::size_t t = 0; t < n_samples; ++t) {
                const float phase = -(k.start + k.step * static_cast<float>(t)) * path;
                sum += g[t].real() * std::cos(phase) + g[t].imag() * std::sin(phase);
            }
            amplitude_grad[point] += sum;
        }
    }
}

} // namespace geraf2::bench
