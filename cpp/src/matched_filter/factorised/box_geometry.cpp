// SPDX-License-Identifier: Apache-2.0
#include "matched_filter/factorised/box_geometry.hpp"

#include <algorithm>
#include <cmath>

#include "matched_filter/factorised/interpolation_nodes.hpp"

namespace geraf2::detail {
namespace {

/// Offsets of n voxels from the middle of them.
std::vector<double> voxel_offsets(index_t n, double spacing) {
    std::vector<double> out(static_cast<std::size_t>(n));
    for (index_t i = 0; i < n; ++i) {
        out[static_cast<std::size_t>(i)] =
            spacing * (static_cast<double>(i) - 0.5 * static_cast<double>(n - 1));
    }
    return out;
}

std::vector<double> scaled(const std::vector<double>& offsets, double shift, double half) {
    std::vector<double> out(offsets.size(), 0.0);
    for (std::size_t i = 0; i < offsets.size() && half > 0.0; ++i) {
        out[i] = std::clamp((offsets[i] + shift) / half, -1.0, 1.0);
    }
    return out;
}

std::vector<double> node_offsets(index_t n, double half) {
    std::vector<double> out(static_cast<std::size_t>(n));
    for (index_t k = 0; k < n; ++k) {
        out[static_cast<std::size_t>(k)] = half * chebyshev_node(k, n);
    }
    return out;
}

template <class T>
std::vector<T> rounded(const std::vector<double>& values) {
    std::vector<T> out;
    std::transform(values.begin(), values.end(), std::back_inserter(out),
                   [](double x) { return static_cast<T>(x); });
    return out;
}

/// All combinations of three offsets, padded with the centre.
template <class T>
std::vector<T> combined(const std::array<std::vector<double>, 3>& offsets) {
    const std::size_t n = offsets[0].size() * offsets[1].size() * offsets[2].size();
    std::vector<T> out;
    out.reserve(4 * (n + point_quantum));
    for (const double x : offsets[0]) {
        for (const double y : offsets[1]) {
            for (const double z : offsets[2]) {
                for (const double value : {x, y, z, x * x + y * y + z * z}) {
                    out.push_back(static_cast<T>(value));
                }
            }
        }
    }
    const auto quantum = static_cast<std::size_t>(point_quantum);
    out.resize(4 * ((n + quantum - 1) / quantum * quantum));
    return out;
}

} // namespace

template <class T>
AxisWeights<T>::AxisWeights(index_t n_nodes, const std::vector<double>& places)
    : n_from(n_nodes), n_to(static_cast<index_t>(places.size())) {
    const auto n = static_cast<std::size_t>(n_nodes);
    std::vector<double> row(n);
    transpose.resize(n * places.size());
    for (std::size_t p = 0; p < places.size(); ++p) {
        lagrange_weights(n_nodes, places[p], row.data());
        for (std::size_t k = 0; k < n; ++k) {
            forward.push_back(static_cast<T>(row[k]));
            transpose[k * places.size() + p] = static_cast<T>(row[k]);
        }
    }
}

template <class T>
BoxGeometry<T>::BoxGeometry(const VoxelGrid& grid, const BoxPlan& box) : plan(box) {
    std::array<double, 3> half{};
    std::array<std::vector<double>, 3> points;
    for (std::size_t a = 0; a < 3; ++a) {
        half[a] = 0.5 * grid.spacing * static_cast<double>(box.count[a] - 1);
        center[a] = grid.origin[a] + grid.spacing * static_cast<double>(box.first[a]) + half[a];
        if (box.tier < 0) {
            points[a] = detail::voxel_offsets(box.count[a], grid.spacing);
            continue;
        }
        points[a] = detail::node_offsets(box.nodes[a], half[a]);
        node_offsets[a] = rounded<T>(points[a]);
        for (index_t i = 0; i < box.parts[a]; ++i) {
            PartAxis<T> part;
            const index_t begin = part_begin(box.count[a], box.parts[a], i);
            part.first = box.first[a] + begin;
            part.count = part_begin(box.count[a], box.parts[a], i + 1) - begin;
            part.half = 0.5 * grid.spacing * static_cast<double>(part.count - 1);
            const double shift = grid.spacing * static_cast<double>(begin) + part.half - half[a];
            part.center = center[a] + shift;
            const auto voxels = detail::voxel_offsets(part.count, grid.spacing);
            part.voxel_offsets = rounded<T>(voxels);
            if (box.subnodes[a] > 0) {
                const auto subnodes = detail::node_offsets(box.subnodes[a], part.half);
                part.subnode_offsets = rounded<T>(subnodes);
                part.to_subnodes = {box.nodes[a], scaled(subnodes, shift, half[a])};
                part.to_voxels = {box.subnodes[a], scaled(voxels, 0.0, part.half)};
            } else {
                part.to_voxels = {box.nodes[a], scaled(voxels, shift, half[a])};
            }
            parts[a].push_back(std::move(part));
        }
    }
    radius = std::hypot(half[0], half[1], half[2]);
    point_offsets = combined<T>(points);
}

template <class T>
PointBlock<T> BoxGeometry<T>::block() const noexcept {
    PointBlock<T> out;
    std::copy_n(center.data(), 3, out.center);
    out.radius = radius;
    out.n_points = n_padded();
    out.offsets = point_offsets.data();
    return out;
}

template <class T>
PointTensor<T> BoxGeometry<T>::nodes() const noexcept {
    PointTensor<T> out;
    out.radius = radius;
    for (std::size_t a = 0; a < 3; ++a) {
        out.center[a] = center[a];
        out.count[a] = plan.nodes[a];
        out.offsets[a] = node_offsets[a].data();
    }
    return out;
}

template <class T>
PointTensor<T> BoxGeometry<T>::part(const std::array<index_t, 3>& at, bool voxels) const noexcept {
    PointTensor<T> out;
    double square = 0.0;
    for (std::size_t a = 0; a < 3; ++a) {
        const PartAxis<T>& axis = parts[a][static_cast<std::size_t>(at[a])];
        const std::vector<T>& offsets = voxels ? axis.voxel_offsets : axis.subnode_offsets;
        out.center[a] = axis.center;
        out.count[a] = static_cast<index_t>(offsets.size());
        out.offsets[a] = offsets.data();
        square += axis.half * axis.half;
    }
    out.radius = std::sqrt(square);
    return out;
}

template struct AxisWeights<float>;
template struct AxisWeights<double>;
template struct BoxGeometry<float>;
template struct BoxGeometry<double>;

} // namespace geraf2::detail
