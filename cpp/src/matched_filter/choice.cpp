// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <limits>
#include <memory>
#include <utility>

#include "geraf2/matched_filter.hpp"
#include "matched_filter/factorised/factorised.hpp"
#include "matched_filter/factorised/plan.hpp"
#include "matched_filter/plan.hpp"
#include "matched_filter/point_blocks.hpp"

namespace geraf2 {
namespace {

/// With fewer (antenna, point) pairs the plan itself, a millisecond, would dominate.
constexpr double min_factorised_pairs = 1e7;

/// Error factor of the cost model within which the simpler method is chosen.
constexpr double margin = 1.2;

} // namespace

namespace detail {

template <class T>
PlannedChoice<T> plan_choice(const AntennaPositions& antennas, const PointSet& points,
                             const Waveform& waveform, const MatchedFilterOptions& options) {
    MatchedFilterOptions automatic = options;
    automatic.method = MatchedFilterMethod::automatic;
    MatchedFilterOptions by_block = options;
    by_block.method = MatchedFilterMethod::block;
    const WaveformPlan<T> plan(waveform, automatic);
    const PointBlocks mixed(points, plan.rule());
    const PointBlocks blocks(points, WaveformPlan<T>(waveform, by_block).rule());
    const index_t n_pairs = plan.tables().n_pairs;
    const int tier = plan.tables().tier;
    const auto n_antennas = static_cast<double>(antennas.count());
    const auto n_points = static_cast<double>(mixed.n_points());
    PlannedChoice<T> planned;
    MatchedFilterChoice& out = planned.choice;
    out.exact_cost = n_antennas * n_points * exact_point_cost(n_pairs);
    out.block_cost =
        n_antennas * (static_cast<double>(blocks.n_blocks()) * block_set_up_cost(tier, n_pairs) +
                      n_points * block_point_cost(tier));
    out.factorised_cost = std::numeric_limits<double>::infinity();
    if (n_points > 0.0) {
        out.exact_share = static_cast<double>(mixed.n_exact_points()) / n_points;
    }
    out.method = out.exact_share > 0.5 ? MatchedFilterMethod::exact : MatchedFilterMethod::block;
    if (std::holds_alternative<VoxelGrid>(points) &&
        n_antennas * n_points >= min_factorised_pairs) {
        auto factorised = std::make_unique<const FactorisedPlan<T>>(
            antennas, std::get<VoxelGrid>(points), waveform, options);
        out.factorised_cost = factorised->cost();
        out.block_share = factorised->block_share();
        if (margin * out.factorised_cost < std::min(out.exact_cost, out.block_cost)) {
            out.method = MatchedFilterMethod::factorised;
            planned.plan = std::move(factorised);
        }
    }
    return planned;
}

template PlannedChoice<float> plan_choice<float>(const AntennaPositions&, const PointSet&,
                                                 const Waveform&, const MatchedFilterOptions&);
template PlannedChoice<double> plan_choice<double>(const AntennaPositions&, const PointSet&,
                                                   const Waveform&, const MatchedFilterOptions&);

} // namespace detail

template <class T>
MatchedFilterChoice choose_matched_filter(const AntennaPositions& antennas, const PointSet& points,
                                          const Waveform& waveform,
                                          const MatchedFilterOptions& options) {
    return detail::plan_choice<T>(antennas, points, waveform, options).choice;
}

template MatchedFilterChoice choose_matched_filter<float>(const AntennaPositions&, const PointSet&,
                                                          const Waveform&,
                                                          const MatchedFilterOptions&);
template MatchedFilterChoice choose_matched_filter<double>(const AntennaPositions&, const PointSet&,
                                                           const Waveform&,
                                                           const MatchedFilterOptions&);

} // namespace geraf2
