// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <vector>

#include "geraf2/matched_filter.hpp"
#include "matched_filter/factorised/antenna_clusters.hpp"
#include "matched_filter/factorised/interpolation_nodes.hpp"
#include "matched_filter/plan.hpp"
#include "matched_filter/tiers.hpp"

namespace geraf2::detail {

/// Voxels [first, first + count) of a grid, and how their image is made.
struct BoxPlan {
    std::array<index_t, 3> first{};
    std::array<index_t, 3> count{};
    int tier = -1;                         ///< index into `tiers`; -1: by the block method
    std::array<index_t, 3> nodes{};        ///< for the clusters of antennas, over the whole box
    std::array<index_t, 3> parts{1, 1, 1}; ///< the box is cut into parts[0] x parts[1] x parts[2]
    std::array<index_t, 3> subnodes{};     ///< for the parents, in each part; 0 with one level
    double cost = 0.0;                     ///< slots of the multiply-add units

    [[nodiscard]] index_t n_voxels() const noexcept { return count[0] * count[1] * count[2]; }
    [[nodiscard]] std::array<index_t, 3> part_count() const noexcept {
        return {(count[0] + parts[0] - 1) / parts[0], (count[1] + parts[1] - 1) / parts[1],
                (count[2] + parts[2] - 1) / parts[2]};
    }
    [[nodiscard]] index_t n_nodes() const noexcept { return nodes[0] * nodes[1] * nodes[2]; }
    [[nodiscard]] index_t n_subnodes() const noexcept {
        return subnodes[0] * subnodes[1] * subnodes[2];
    }
};

/// First voxel of part i of n of an axis of `count` voxels.
inline index_t part_begin(index_t count, index_t n, index_t i) noexcept { return i * count / n; }

/// Clusters of the antennas, boxes of the grid, nodes and accuracies: everything that
/// geometry, waveform and rtol decide. The same for any number of threads.
template <class T>
class FactorisedPlan {
public:
    FactorisedPlan(const AntennaPositions& antennas, const VoxelGrid& grid,
                   const Waveform& waveform, const MatchedFilterOptions& options);

    [[nodiscard]] const AntennaClusters& clusters() const noexcept { return clusters_; }
    [[nodiscard]] bool two_levels() const noexcept { return clusters_.n_children() > 1; }
    [[nodiscard]] const std::vector<BoxPlan>& boxes() const noexcept { return boxes_; }
    [[nodiscard]] const MatchedFilterTables<T>& tables(int tier) const noexcept {
        return tier < 0 ? block_.tables()
                        : node_plans_[static_cast<std::size_t>(tier - first_tier_)].tables();
    }
    [[nodiscard]] const MatchedFilterTables<T>& carrier() const noexcept { return carrier_; }
    [[nodiscard]] double cost() const noexcept;

    /// Share of the voxels that the block method images.
    [[nodiscard]] double block_share() const noexcept;

private:
    void plan(const BoxPlan& box);
    [[nodiscard]] BoxPlan measured(const BoxPlan& box) const;
    [[nodiscard]] bool choose_nodes(BoxPlan& box, const ClusterRates& rates, index_t edge) const;
    [[nodiscard]] bool choose_tier(BoxPlan& box, double radius, double nearest) const;
    [[nodiscard]] double factorised_cost(const BoxPlan& box, double nearest) const;
    [[nodiscard]] double block_cost(const BoxPlan& box) const;
    [[nodiscard]] std::array<double, 3> half_sides(const std::array<index_t, 3>& count) const;

    VoxelGrid grid_;
    WavePhases wave_;
    index_t n_pairs_;
    double rtol_;
    int first_tier_;
    AntennaClusters clusters_;
    std::vector<ParentExtent> parents_;
    WaveformPlan<T> block_;
    std::vector<WaveformPlan<T>> node_plans_;
    MatchedFilterTables<T> carrier_;
    std::vector<BoxPlan> boxes_;
};

} // namespace geraf2::detail
