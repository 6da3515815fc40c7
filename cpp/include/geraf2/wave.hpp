// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "geraf2/types.hpp"

namespace geraf2 {

/// Speed of light in vacuum [m/s]; exact by definition of the metre.
inline constexpr double speed_of_light = 299792458.0;

/// Sign of the received phase: s(t) = sum A exp(phase_sign j 2 pi (nu + k t) tau).
/// Only this line of the project chooses the sign (docs/conventions.md).
inline constexpr int phase_sign = -1;

/// A linear FMCW chirp as sampled by the receiver; SI units.
struct Waveform {
    double start_frequency_hz = 0.0;   ///< frequency at the first sample
    double chirp_slope_hz_per_s = 0.0; ///< k
    double sample_rate_hz = 0.0;       ///< complex ADC samples per second
    index_t n_samples = 0;
    double path_bias_m = 0.0; ///< instrument delay on the two-way path

    /// Frequency of ADC sample `t` [Hz].
    [[nodiscard]] double frequency_hz(index_t t) const noexcept {
        return start_frequency_hz + chirp_slope_hz_per_s * static_cast<double>(t) / sample_rate_hz;
    }
};

} // namespace geraf2
