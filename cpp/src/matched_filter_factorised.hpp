// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "geraf2/matched_filter.hpp"

namespace geraf2::detail {

/// matched_filter_fwd and matched_filter_bwd_signal by the factorised method.
template <class T>
void factorised_fwd(std::span<const std::complex<T>> signal, const AntennaPositions& antennas,
                    const VoxelGrid& grid, const Waveform& waveform,
                    const MatchedFilterOptions& options, std::span<std::complex<T>> image);

template <class T>
void factorised_bwd(std::span<const std::complex<T>> image, const AntennaPositions& antennas,
                    const VoxelGrid& grid, const Waveform& waveform,
                    const MatchedFilterOptions& options, std::span<std::complex<T>> signal);

} // namespace geraf2::detail
