// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <complex>
#include <span>

#include "geraf2/matched_filter.hpp"

namespace geraf2::bench {

/// The matched filter as three plain loops with sine and cosine, float32, one thread.
void matched_filter_naive(std::span<const std::complex<float>> signal, // (n_antennas, n_samples)
                          std::span<const float> tx,                   // (n_antennas, 3) [m]
                          std::span<const float> rx,                   // (n_antennas, 3) [m]
                          std::span<const float> points,               // (n_points, 3) [m]
                          const Waveform& waveform, std::span<std::complex<float>> image);

} // namespace geraf2::bench
