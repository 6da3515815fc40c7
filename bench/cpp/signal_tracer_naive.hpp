// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <complex>
#include <span>

#include "geraf2/wave.hpp"

namespace geraf2::bench {

/// The signal tracer as one would first write it, in single precision: for each antenna and point
/// the path, for each sample a sine and a cosine.
void signal_tracer_naive(std::span<const float> amplitude, // (n_points)
                         std::span<const float> tx, std::span<const float> rx,
                         std::span<const float> points, const Waveform& waveform,
                         std::span<std::complex<float>> signal); // (n_antennas, n_samples)

/// Its gradient to the amplitude, in the same manner.
void signal_tracer_naive_bwd(std::span<const std::complex<float>> signal_grad,
                             std::span<const float> tx, std::span<const float> rx,
                             std::span<const float> points, const Waveform& waveform,
                             std::span<float> amplitude_grad);

} // namespace geraf2::bench
