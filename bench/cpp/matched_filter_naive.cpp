// SPDX-License-Identifier: Apache-2.0
#include "matched_filter_naive.hpp"

#include <cmath>

namespace geraf2::bench {

void matched_filter_naive(std::span<const std::complex<float>> signal, std::span<const float> tx,
                          std::span<const float> rx, std::span<const float> points,
                          const Waveform& waveform, std::span<std::complex<float>> image) {
    const auto n_samples = static_cast<std::size_t>(waveform.n_samples);
    const std::size_t n_antennas = tx.size() / 3;
    const auto start = static_cast<float>(waveform.start_frequency_hz);
    const auto step = static_cast<float>(waveform.chirp_slope_hz_per_s / waveform.sample_rate_hz);
    const auto bias = static_cast<float>(waveform.path_bias_m);
    const auto per_metre = static_cast<float>(2.0 * 3.14159265358979323846 / speed_of_light);
    for (std::size_t point = 0; point < image.size(); ++point) {
        const float* x = points.data() + 3 * point;
        float re = 0.0F;
        float im = 0.0F;
        for (std::size_t antenna = 0; antenna < n_antennas; ++antenna) {
            const float* from = tx.data() + 3 * antenna;
            const float* to = rx.data() + 3 * antenna;
            const float path =
                std::sqrt((x[0] - from[0]) * (x[0] - from[0]) +
                          (x[1] - from[1]) * (x[1] - from[1]) +
                          (x[2] - from[2]) * (x[2] - from[2])) +
                std::sqrt((x[0] - to[0]) * (x[0] - to[0]) + (x[1] - to[1]) * (x[1] - to[1]) +
                          (x[2] - to[2]) * (x[2] - to[2])) +
                bias;
            const std::complex<float>* samples = signal.data() + antenna * n_samples;
            for (std::size_t t = 0; t < n_samples; ++t) {
                const float phase = per_metre * (start + step * static_cast<float>(t)) * path;
                const float c = std::cos(phase);
                const float s = std::sin(phase);
                re += samples[t].real() * c - samples[t].imag() * s;
                im += samples[t].real() * s + samples[t].imag() * c;
            }
        }
        image[point] = {re / static_cast<float>(n_antennas), im / static_cast<float>(n_antennas)};
    }
}

} // namespace geraf2::bench
