// SPDX-License-Identifier: Apache-2.0
// Nodes, voxels and weights of one box of the factorised method.
#pragma once

#include <array>
#include <vector>

#include "matched_filter/factorised/plan.hpp"

namespace geraf2::detail {

/// Interpolation along one axis, and its transpose.
template <class T>
struct AxisWeights {
    index_t n_from = 0;
    index_t n_to = 0;
    std::vector<T> forward;   ///< (n_to, n_from)
    std::vector<T> transpose; ///< (n_from, n_to)

    AxisWeights() = default;

    /// From Chebyshev nodes on [-1, 1] to `places`.
    AxisWeights(index_t n_nodes, const std::vector<double>& places);
};

/// One of the parts of a box along one axis.
template <class T>
struct PartAxis {
    index_t first = 0; ///< voxel of the grid
    index_t count = 0;
    double center = 0.0;            ///< [m]
    double half = 0.0;              ///< [m]
    std::vector<T> voxel_offsets;   ///< from the centre [m]
    std::vector<T> subnode_offsets; ///< two levels only [m]
    AxisWeights<T> to_subnodes;     ///< from the box's nodes, two levels only
    AxisWeights<T> to_voxels;       ///< from the part's nodes, or the box's with one level
};

template <class T>
struct BoxGeometry {
    BoxPlan plan;
    std::array<double, 3> center{};             ///< [m]
    double radius = 0.0;                        ///< [m]
    std::array<std::vector<T>, 3> node_offsets; ///< [m]
    std::array<std::vector<PartAxis<T>>, 3> parts;
    std::vector<T> point_offsets; ///< of all nodes, or of all voxels in a box for the block
                                  ///< method: (padded count, 4), as PointBlock::offsets

    BoxGeometry(const VoxelGrid& grid, const BoxPlan& plan);

    [[nodiscard]] index_t n_padded() const noexcept {
        return static_cast<index_t>(point_offsets.size() / 4);
    }
    [[nodiscard]] PointBlock<T> block() const noexcept;
    [[nodiscard]] PointTensor<T> nodes() const noexcept;

    /// Voxels or nodes of part (i, j, k).
    [[nodiscard]] PointTensor<T> part(const std::array<index_t, 3>& at, bool voxels) const noexcept;
};

} // namespace geraf2::detail
