// SPDX-License-Identifier: Apache-2.0
#include "matched_filter/factorised/plan.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "matched_filter/point_blocks.hpp"

namespace geraf2::detail {
namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();

/// Voxels along the edge of the largest box, and of its parts at most.
constexpr index_t max_edge = 64;
constexpr std::array<index_t, 3> part_edges = {16, 8, 4};

/// A box is not cut below this many voxels along an edge for cheapness' sake.
constexpr index_t min_edge = 8;

// Shares of rtol. Range series and sine and cosine come in three times: at the nodes, and with the
// carrier from clusters to parents and from parents to voxels; 3 x 6.8e-5 are
// 0.26 of the smallest rtol of the first tier, so that all together stay below 1.
constexpr double interpolation_share = 0.38;
constexpr double profile_share = 0.15;
constexpr double node_range_share = 0.1;
constexpr double carrier_range_share = 0.05;
constexpr double first_tier_rtol = 8e-4;

/// Antennas of a cluster, as fastest in BM_Plane: with one level; with two, and in a parent.
constexpr double one_level_antennas = 256.0;
constexpr double child_antennas = 64.0;
constexpr double parent_antennas = 1024.0;

/// A square root and a division cost this many slots more than the range series, both legs.
constexpr double square_root_cost = 140.0;

index_t parents_of(double n_antennas, double each) {
    const double quanta = n_antennas / (each * static_cast<double>(parent_quantum));
    return parent_quantum * std::max<index_t>(1, std::lround(quanta));
}

AntennaClusters make_clusters(const AntennaPositions& antennas, int levels) {
    const auto n = static_cast<double>(antennas.count());
    const index_t n_parents = parents_of(n, parent_antennas);
    const index_t n_children = std::lround(n / static_cast<double>(n_parents) / child_antennas);
    if (levels == 1 || n_children < 2) {
        return {antennas, parents_of(n, one_level_antennas), 1};
    }
    return {antennas, n_parents, n_children};
}

template <class T>
int node_tier(double rtol) noexcept {
    if (rtol >= first_tier_rtol) {
        return nodes_coarse_low;
    }
    return sizeof(T) == 4 || rtol >= 1e-5 ? nodes_fine_low : nodes_double;
}

index_t divide_up(index_t a, index_t b) noexcept { return (a + b - 1) / b; }

index_t product(const std::array<index_t, 3>& v) noexcept { return v[0] * v[1] * v[2]; }

/// Whether the range series of both legs stays within its limit at this distance: the guard of
/// range_series in matched_filter/block.hpp.
template <class T>
bool series_serves(const MatchedFilterTables<T>& tables, int order, double range,
                   double radius) noexcept {
    const double q = (2.0 * range + radius) * radius;
    const double ratio = q / (range * range);
    double term = std::abs(tables.half_turns_per_m) * range;
    for (int k = 0; k <= order; ++k) {
        term *= std::abs(0.5 - k) / (k + 1.0) * ratio;
    }
    const double residual = std::numbers::pi * tables.range_residual + 3.2 * ratio;
    return range > 0.0 && ratio < 0.5 &&
           2.0 * residual * term / (1.0 - ratio) <= tables.range_limit;
}

/// Multiply-adds of the two outer axes of interpolation from n to p points, complex.
double pass_cost(const std::array<index_t, 3>& n, const std::array<index_t, 3>& p, double share0,
                 double share1) noexcept {
    return 2.0 * (static_cast<double>(p[0] * n[0] * n[1] * n[2]) * share0 +
                  static_cast<double>(p[0] * p[1] * n[1] * n[2]) * share1);
}

} // namespace

template <class T>
FactorisedPlan<T>::FactorisedPlan(const AntennaPositions& antennas, const VoxelGrid& grid,
                                  const Waveform& waveform, const MatchedFilterOptions& options)
    : grid_(grid), wave_(waveform), n_pairs_((waveform.n_samples + 1) / 2),
      rtol_(attainable_rtol<T>(options.rtol)), first_tier_(node_tier<T>(rtol_)),
      clusters_(make_clusters(antennas, options.levels)),
      block_(waveform, {MatchedFilterMethod::block, options.rtol, 1}),
      carrier_(carrier_tables<T>(waveform, (first_tier_ - first_node_tier) / 2,
                                 carrier_range_share * rtol_)) {
    for (index_t i = 0; i < clusters_.n_parents(); ++i) {
        ParentExtent parent{clusters_.parent(i), {}};
        for (index_t j = 0; j < clusters_.n_children(); ++j) {
            for (std::size_t axis = 0; axis < 6; ++axis) {
                parent.child_half[axis] =
                    std::max(parent.child_half[axis], clusters_.child(i, j).half[axis]);
            }
        }
        parents_.push_back(parent);
    }
    for (int tier = first_tier_; tier < std::min<int>(first_tier_ + 2, n_tiers); ++tier) {
        node_plans_.emplace_back(waveform, tier,
                                 BlockErrors{profile_share * rtol_, node_range_share * rtol_});
    }
    // Boxes of equal size as nearly as can be, none larger than max_edge or the profile's reach.
    const double widest = 2.0 * node_plans_.back().max_radius() / std::numbers::sqrt3;
    const auto edge = std::clamp<index_t>(
        static_cast<index_t>(std::min(widest / grid.spacing, 1e6)) + 1, 1, max_edge);
    std::array<index_t, 3> n{};
    for (std::size_t a = 0; a < 3; ++a) {
        n[a] = divide_up(grid.shape[a], edge);
    }
    BoxPlan box;
    for (index_t i = 0; i < product(n); ++i) {
        const std::array<index_t, 3> at = {i / n[2] / n[1], i / n[2] % n[1], i % n[2]};
        for (std::size_t a = 0; a < 3; ++a) {
            box.first[a] = part_begin(grid.shape[a], n[a], at[a]);
            box.count[a] = part_begin(grid.shape[a], n[a], at[a] + 1) - box.first[a];
        }
        plan(measured(box));
    }
}

template <class T>
void FactorisedPlan<T>::plan(const BoxPlan& box) {
    // Cut while the halves together are cheaper, or as long as nothing else is possible.
    const bool stuck = !(box.cost < infinity);
    const bool large = *std::max_element(box.count.begin(), box.count.end()) > min_edge;
    if (!large && !stuck) {
        boxes_.push_back(box);
        return;
    }
    std::vector<BoxPlan> halves;
    const index_t longest = *std::max_element(box.count.begin(), box.count.end());
    std::array<index_t, 3> n{};
    for (std::size_t a = 0; a < 3; ++a) {
        n[a] = 2 * box.count[a] > longest && box.count[a] > 1 ? 2 : 1;
    }
    double cost = 0.0;
    for (index_t i = 0; i < product(n); ++i) {
        const std::array<index_t, 3> at = {i / n[2] / n[1], i / n[2] % n[1], i % n[2]};
        BoxPlan half;
        for (std::size_t a = 0; a < 3; ++a) {
            const index_t begin = part_begin(box.count[a], n[a], at[a]);
            half.first[a] = box.first[a] + begin;
            half.count[a] = part_begin(box.count[a], n[a], at[a] + 1) - begin;
        }
        halves.push_back(measured(half));
        cost += halves.back().cost;
    }
    if (!stuck && !(cost < box.cost)) {
        boxes_.push_back(box);
        return;
    }
    for (const BoxPlan& half : halves) {
        plan(half);
    }
}

template <class T>
std::array<double, 3> FactorisedPlan<T>::half_sides(const std::array<index_t, 3>& count) const {
    std::array<double, 3> out{};
    for (std::size_t a = 0; a < 3; ++a) {
        out[a] = 0.5 * grid_.spacing * static_cast<double>(count[a] - 1);
    }
    return out;
}

template <class T>
BoxPlan FactorisedPlan<T>::measured(const BoxPlan& box) const {
    BoxPlan out = box;
    out.tier = -1;
    out.cost = block_cost(box);
    const std::array<double, 3> half = half_sides(box.count);
    std::array<double, 3> center{};
    for (std::size_t a = 0; a < 3; ++a) {
        center[a] = grid_.origin[a] + grid_.spacing * static_cast<double>(box.first[a]) + half[a];
    }
    const double radius = std::hypot(half[0], half[1], half[2]);
    if (radius > node_plans_.back().max_radius()) {
        return out;
    }
    ClusterRates rates;
    double nearest = infinity;
    for (const ParentExtent& parent : parents_) {
        const ClusterRates one = phase_rates(parent, wave_, center, half);
        if (!one.parent.finite()) {
            return out;
        }
        rates.parent.include(one.parent);
        rates.child.include(one.child);
        for (std::size_t leg = 0; leg < 2; ++leg) {
            const double* from = parent.extent.center.data() + 3 * leg;
            nearest = std::min(
                nearest, std::hypot(center[0] - from[0], center[1] - from[1], center[2] - from[2]) -
                             parent.extent.radius());
        }
    }
    for (const index_t edge : part_edges) {
        BoxPlan candidate = box;
        if (choose_nodes(candidate, rates, edge) && choose_tier(candidate, radius, nearest)) {
            candidate.cost = factorised_cost(candidate, nearest);
            if (candidate.cost < out.cost) {
                out = candidate;
            }
        }
    }
    return out;
}

template <class T>
bool FactorisedPlan<T>::choose_nodes(BoxPlan& box, const ClusterRates& rates, index_t edge) const {
    const double limit = interpolation_share * rtol_ / (two_levels() ? 6.0 : 3.0);
    for (std::size_t a = 0; a < 3; ++a) {
        box.parts[a] = divide_up(box.count[a], edge);
    }
    const std::array<double, 3> half = half_sides(box.count);
    const std::array<double, 3> part_half = half_sides(box.part_count());
    for (std::size_t a = 0; a < 3; ++a) {
        box.nodes[a] = nodes_needed(rates.child.slope[a], rates.child.bend[a], half[a], limit);
        if (two_levels()) {
            box.subnodes[a] =
                nodes_needed(rates.parent.slope[a], rates.parent.bend[a], part_half[a], limit);
        }
    }
    return box.n_nodes() > 0 && (box.n_subnodes() > 0 || !two_levels());
}

template <class T>
bool FactorisedPlan<T>::choose_tier(BoxPlan& box, double radius, double nearest) const {
    // The cheapest tier whose profile and range series both reach.
    for (std::size_t i = 0; i < node_plans_.size(); ++i) {
        const int tier = first_tier_ + static_cast<int>(i);
        if (radius <= node_plans_[i].max_radius() &&
            series_serves(node_plans_[i].tables(), tiers[tier].range_order, nearest, radius)) {
            box.tier = tier;
            return true;
        }
    }
    return false;
}

template <class T>
double FactorisedPlan<T>::block_cost(const BoxPlan& box) const {
    const std::array<double, 3> half = half_sides(box.count);
    if (std::hypot(half[0], half[1], half[2]) > block_.max_radius() ||
        box.n_voxels() > max_block_points) {
        return infinity;
    }
    const int tier = block_.tables().tier;
    const auto n_slots =
        static_cast<double>(clusters_.n_parents() * clusters_.n_children() * clusters_.capacity());
    return n_slots * (block_set_up_cost(tier, n_pairs_) +
                      static_cast<double>(box.n_voxels()) * block_point_cost(tier));
}

template <class T>
double FactorisedPlan<T>::factorised_cost(const BoxPlan& box, double nearest) const {
    const std::array<index_t, 3> part = box.part_count();
    const std::array<double, 3> part_half = half_sides(part);
    const int order = carrier_tiers[carrier_.tier].range_order;
    const bool series = series_serves(carrier_, order, nearest,
                                      std::hypot(part_half[0], part_half[1], part_half[2]));
    const auto n_parents = static_cast<double>(clusters_.n_parents());
    const double n_clusters = n_parents * static_cast<double>(clusters_.n_children());
    const double point = 1.4 * (2 * (2 + order) + 15) + (series ? 0.0 : square_root_cost);
    double cost = n_clusters * static_cast<double>(clusters_.capacity()) *
                  (block_set_up_cost(box.tier, n_pairs_) +
                   static_cast<double>(box.n_nodes()) * block_point_cost(box.tier));
    const auto n_parts = static_cast<double>(product(box.parts));
    const auto& last = two_levels() ? box.subnodes : box.nodes;
    cost += n_parents * n_parts * 1.4 * pass_cost(last, part, 1.0, 1.0);
    cost += n_parents * static_cast<double>(box.n_voxels()) *
            (point + 2.8 * static_cast<double>(last[2]));
    if (two_levels()) {
        const double share1 = 1.0 / static_cast<double>(box.parts[2]);
        cost += n_clusters * n_parts *
                (1.4 * pass_cost(box.nodes, box.subnodes,
                                 share1 / static_cast<double>(box.parts[1]), share1) +
                 static_cast<double>(box.n_subnodes()) *
                     (point + 2.8 * static_cast<double>(box.nodes[2])));
    }
    return cost;
}

template <class T>
double FactorisedPlan<T>::cost() const noexcept {
    double sum = 0.0;
    for (const BoxPlan& box : boxes_) {
        sum += box.cost;
    }
    return sum;
}

template <class T>
double FactorisedPlan<T>::block_share() const noexcept {
    double voxels = 0.0;
    double by_block = 0.0;
    for (const BoxPlan& box : boxes_) {
        voxels += static_cast<double>(box.n_voxels());
        by_block += box.tier < 0 ? static_cast<double>(box.n_voxels()) : 0.0;
    }
    return voxels > 0.0 ? by_block / voxels : 0.0;
}

template class FactorisedPlan<float>;
template class FactorisedPlan<double>;

} // namespace geraf2::detail
