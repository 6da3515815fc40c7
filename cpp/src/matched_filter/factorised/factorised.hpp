// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>

#include "geraf2/matched_filter.hpp"
#include "matched_filter/factorised/plan.hpp"

namespace geraf2::detail {

/// The choice, and the plan of the factorised method where that was chosen, else null: it takes
/// half a second for a plane of the published size.
template <class T>
struct PlannedChoice {
    MatchedFilterChoice choice;
    std::unique_ptr<const FactorisedPlan<T>> plan;
};

/// choose_matched_filter, with its plan.
template <class T>
PlannedChoice<T> plan_choice(const AntennaPositions& antennas, const PointSet& points,
                             const Waveform& waveform, const MatchedFilterOptions& options);

/// matched_filter_fwd and matched_filter_bwd_signal by the factorised method.
template <class T>
void factorised_fwd(std::span<const std::complex<T>> signal, const FactorisedPlan<T>& plan,
                    const AntennaPositions& antennas, const VoxelGrid& grid,
                    const Waveform& waveform, const MatchedFilterOptions& options,
                    std::span<std::complex<T>> image);

template <class T>
void factorised_bwd(std::span<const std::complex<T>> image, const FactorisedPlan<T>& plan,
                    const AntennaPositions& antennas, const VoxelGrid& grid,
                    const Waveform& waveform, const MatchedFilterOptions& options,
                    std::span<std::complex<T>> signal);

} // namespace geraf2::detail
