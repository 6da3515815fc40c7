// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <vector>

#include "common/aligned_buffer.hpp"
#include "geraf2/matched_filter.hpp"
#include "geraf2/types.hpp"
#include "matched_filter/plan.hpp"

namespace geraf2::detail {

/// Parents come in multiples of this, the lanes of the widest vector, so that clusters do not
/// depend on the instruction set.
inline constexpr index_t parent_quantum = 16;

/// Transmitters and receivers of a cluster: (tx x, y, z, rx x, y, z) [m].
struct ClusterExtent {
    std::array<double, 6> center{}; ///< middle of the bounding box
    std::array<double, 6> half{};   ///< half its sides

    /// Half the longer of the two diagonals [m].
    [[nodiscard]] double radius() const noexcept;
};

/// Antennas in n_parents clusters, each of n_children clusters, of equal numbers as nearly as can
/// be, cut across the longest side of the bounding box of (tx, rx) again and again.
class AntennaClusters {
public:
    AntennaClusters(const AntennaPositions& antennas, index_t n_parents, index_t n_children);

    [[nodiscard]] index_t n_parents() const noexcept { return n_parents_; }
    [[nodiscard]] index_t n_children() const noexcept { return n_children_; }

    /// Antennas of the largest child.
    [[nodiscard]] index_t capacity() const noexcept { return capacity_; }

    [[nodiscard]] const ClusterExtent& parent(index_t i) const noexcept {
        return parents_[static_cast<std::size_t>(i)];
    }
    [[nodiscard]] const ClusterExtent& child(index_t i, index_t j) const noexcept {
        return children_[static_cast<std::size_t>(i * n_children_ + j)];
    }

    /// Slots of AntennaPack for parents [begin, end): the groups of one child of `lanes` parents
    /// follow each other, lane l holding antennas of the l-th parent's child.
    [[nodiscard]] std::vector<index_t> slots(index_t begin, index_t end, int lanes) const;

    /// Centres of the parents [begin, end), (n_groups, 6, lanes); of their children, (n_groups,
    /// n_children, 6, lanes).
    [[nodiscard]] AlignedBuffer<double> parent_centers(index_t begin, index_t end, int lanes) const;
    [[nodiscard]] AlignedBuffer<double> child_centers(index_t begin, index_t end, int lanes) const;

private:
    void split(const AntennaPositions& antennas, index_t begin, index_t end, index_t n_parts,
               std::vector<index_t>& ends);
    [[nodiscard]] ClusterExtent extent(const AntennaPositions& antennas, index_t begin,
                                       index_t end) const;

    index_t n_parents_;
    index_t n_children_;
    index_t capacity_ = 0;
    std::vector<index_t> order_;      ///< antennas, child by child
    std::vector<index_t> child_ends_; ///< into order_
    std::vector<ClusterExtent> parents_;
    std::vector<ClusterExtent> children_;
};

} // namespace geraf2::detail
