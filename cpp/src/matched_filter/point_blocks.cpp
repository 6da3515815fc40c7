// SPDX-License-Identifier: Apache-2.0
#include "matched_filter/point_blocks.hpp"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>
#include <tuple>
#include <utility>

#include "matched_filter/kernels.hpp"

namespace geraf2::detail {
namespace {

/// Points of a chunk for the exact method: enough to serve one load of the signal many times.
constexpr index_t chunk_points = 64;

/// Voxels along the edge of a grid block: 10^3 stays below max_block_points.
constexpr index_t max_edge = 10;

index_t divide_up(index_t a, index_t b) noexcept { return (a + b - 1) / b; }

/// Cells of a list of points along one axis.
struct CellAxis {
    double low = 0.0;
    double per_m = 0.0; ///< cells; 0 where there is but one
    double last = 0.0;

    /// Cells from the first, not yet rounded down; NaN ends in the last cell.
    [[nodiscard]] double at(double x) const noexcept {
        const double place = (x - low) * per_m;
        return place < last ? place : last;
    }
};

/// Points in the order of their cells, and where each occupied cell begins, then their number.
struct CellOrder {
    std::vector<index_t> order;
    std::vector<index_t> starts;
};

/// Few cells for many points, the usual case: they are counted out, by each thread for a part of
/// the points.
CellOrder count_out(std::span<const double> xyz, const CellAxis* axes, std::size_t n_cells,
                    int num_threads) {
    const std::size_t n_points = xyz.size() / 3;
    std::vector<std::uint32_t> cell(n_points);
    std::uint32_t n[3];
    for (std::size_t axis = 0; axis < 3; ++axis) {
        n[axis] = static_cast<std::uint32_t>(axes[axis].last) + 1;
    }
    // Where a part has fewer points than there are cells, the sums below cost more than they spare.
    const auto n_parts = std::clamp<std::size_t>(n_points / std::max<std::size_t>(n_cells, 4096), 1,
                                                 static_cast<std::size_t>(num_threads));
    const auto threads = static_cast<int>(n_parts);
    std::vector<index_t> next(n_parts * n_cells, 0); // (part, cell)
#pragma omp parallel for num_threads(threads) schedule(static) if (threads > 1)
    for (std::size_t part = 0; part < n_parts; ++part) {
        index_t* const count = next.data() + part * n_cells;
        for (std::size_t i = part * n_points / n_parts; i < (part + 1) * n_points / n_parts; ++i) {
            std::uint32_t place = 0;
            for (std::size_t axis = 0; axis < 3; ++axis) {
                place =
                    place * n[axis] + static_cast<std::uint32_t>(axes[axis].at(xyz[3 * i + axis]));
            }
            cell[i] = place;
            ++count[place];
        }
    }
    CellOrder out;
    index_t total = 0;
    for (std::size_t place = 0; place < n_cells; ++place) {
        const index_t begin = total;
        for (std::size_t part = 0; part < n_parts; ++part) {
            total += std::exchange(next[part * n_cells + place], total);
        }
        if (total > begin) {
            out.starts.push_back(begin);
        }
    }
    out.starts.push_back(total);
    out.order.resize(n_points);
#pragma omp parallel for num_threads(threads) schedule(static) if (threads > 1)
    for (std::size_t part = 0; part < n_parts; ++part) {
        index_t* const to = next.data() + part * n_cells;
        for (std::size_t i = part * n_points / n_parts; i < (part + 1) * n_points / n_parts; ++i) {
            out.order[static_cast<std::size_t>(to[cell[i]]++)] = static_cast<index_t>(i);
        }
    }
    return out;
}

CellOrder sort_out(std::span<const double> xyz, const CellAxis* axes) {
    using Key = std::tuple<double, double, double, index_t>;
    std::vector<Key> keys;
    keys.reserve(xyz.size() / 3);
    for (std::size_t i = 0; i < xyz.size(); i += 3) {
        keys.emplace_back(std::floor(axes[0].at(xyz[i])), std::floor(axes[1].at(xyz[i + 1])),
                          std::floor(axes[2].at(xyz[i + 2])), static_cast<index_t>(i / 3));
    }
    std::sort(keys.begin(), keys.end());
    const auto cell_of = [](const Key& key) {
        return std::tie(std::get<0>(key), std::get<1>(key), std::get<2>(key));
    };
    CellOrder out;
    for (std::size_t i = 0; i < keys.size(); ++i) {
        if (i == 0 || cell_of(keys[i - 1]) != cell_of(keys[i])) {
            out.starts.push_back(static_cast<index_t>(i));
        }
        out.order.push_back(std::get<3>(keys[i]));
    }
    out.starts.push_back(static_cast<index_t>(keys.size()));
    return out;
}

} // namespace

BlockPoints::BlockPoints() {
    index.reserve(max_block_points);
    positions.reserve(3 * (max_block_points + point_quantum));
}

Extent extent_of(std::span<const double> points, int num_threads) noexcept {
    const std::size_t n_points = points.size() / 3;
    if (n_points == 0) {
        return {};
    }
    constexpr double inf = std::numeric_limits<double>::infinity();
    double low[3] = {inf, inf, inf};
    double high[3] = {-inf, -inf, -inf};
    const int threads = std::clamp(static_cast<int>(n_points / 4096), 1, num_threads);
#pragma omp parallel for num_threads(threads) schedule(static) if (threads > 1)                    \
    reduction(min : low) reduction(max : high)
    for (std::size_t i = 0; i < n_points; ++i) {
        for (std::size_t axis = 0; axis < 3; ++axis) {
            const double x = points[3 * i + axis];
            low[axis] = std::min(low[axis], x); // NaN compares false and is passed over
            high[axis] = std::max(high[axis], x);
        }
    }
    return {{low[0], low[1], low[2]}, {high[0], high[1], high[2]}};
}

PointBlocks::PointBlocks(const PointSet& points, const BlockRule& rule, int num_threads)
    : points_(points) {
    const bool is_grid = std::holds_alternative<VoxelGrid>(points);
    if (is_grid) {
        const auto& shape = std::get<VoxelGrid>(points).shape;
        n_points_ = shape[0] * shape[1] * shape[2];
    } else {
        n_points_ = static_cast<index_t>(std::get<std::span<const double>>(points).size() / 3);
    }
    if (rule.max_radius <= 0.0 || n_points_ == 0) {
        use_chunks();
    } else if (is_grid) {
        cut_grid(rule);
    } else {
        sort_into_cells(rule, num_threads);
    }
}

index_t PointBlocks::n_exact_points() const noexcept {
    if (kind_ != Kind::cells) {
        return kind_ == Kind::chunks ? n_points_ : 0;
    }
    index_t sum = 0;
    for (std::size_t i = 0; i < exact_.size(); ++i) {
        sum += exact_[i] ? starts_[i + 1] - starts_[i] : 0;
    }
    return sum;
}

void PointBlocks::use_chunks() noexcept {
    kind_ = Kind::chunks;
    n_blocks_ = divide_up(n_points_, chunk_points);
}

void PointBlocks::cut_grid(const BlockRule& rule) {
    const auto& grid = std::get<VoxelGrid>(points_);
    // n voxels span n - 1 spacings; the farthest is half a diagonal from the middle.
    const double reach = 2.0 * rule.max_radius / (std::numbers::sqrt3 * grid.spacing);
    edge_ = 1 + static_cast<index_t>(std::min(reach, static_cast<double>(max_edge - 1)));
    if (edge_ * edge_ * edge_ < rule.min_points) {
        use_chunks();
        return;
    }
    kind_ = Kind::grid_blocks;
    n_blocks_ = 1;
    for (const index_t length : grid.shape) {
        n_blocks_ *= divide_up(length, edge_);
    }
}

void PointBlocks::sort_into_cells(const BlockRule& rule, int num_threads) {
    kind_ = Kind::cells;
    const auto xyz = std::get<std::span<const double>>(points_);
    // A box within a cube whose half diagonal is the radius, a little less for rounding. Along each
    // axis the extent is cut evenly: no cell at a rim holds but a few points.
    const double edge = 2.0 * rule.max_radius / std::numbers::sqrt3 * (1.0 - 1e-9);
    const Extent extent = extent_of(xyz, num_threads);
    CellAxis axes[3];
    double n_cells = 1.0;
    for (std::size_t axis = 0; axis < 3; ++axis) {
        const double length = extent.high[axis] - extent.low[axis];
        const double n = std::max(1.0, std::ceil(length / edge));
        axes[axis] = {extent.low[axis], n > 1.0 ? n / length : 0.0, n - 1.0}; // may be denormal
        n_cells *= n;
    }
    // A NaN or an infinity compares false.
    const double most = std::min(4.0 * static_cast<double>(n_points_), 4e9);
    CellOrder cells = n_cells <= most
                          ? count_out(xyz, axes, static_cast<std::size_t>(n_cells), num_threads)
                          : sort_out(xyz, axes);
    order_ = std::move(cells.order);
    bool open_chunk = false; // the last block is a sparse one that may still grow
    for (std::size_t cell = 0; cell + 1 < cells.starts.size(); ++cell) {
        const index_t cell_end = cells.starts[cell + 1];
        for (index_t begin = cells.starts[cell]; begin < cell_end;) {
            const index_t end = std::min(begin + max_block_points, cell_end);
            const bool sparse = end - begin < rule.min_points;
            const bool grow = sparse && open_chunk && end - starts_.back() <= chunk_points;
            if (!grow) {
                starts_.push_back(begin);
                exact_.push_back(sparse);
            }
            open_chunk = sparse;
            begin = end;
        }
    }
    n_blocks_ = static_cast<index_t>(starts_.size());
    starts_.push_back(n_points_);
}

index_t PointBlocks::block_size(index_t block) const noexcept {
    assert(kind_ != Kind::grid_blocks);
    if (kind_ == Kind::cells) {
        const auto at = static_cast<std::size_t>(block);
        return starts_[at + 1] - starts_[at];
    }
    return std::min(chunk_points, n_points_ - block * chunk_points);
}

void PointBlocks::position(index_t index, double* to) const noexcept {
    if (const auto* grid = std::get_if<VoxelGrid>(&points_)) {
        const index_t z = index % grid->shape[2];
        const index_t y = index / grid->shape[2] % grid->shape[1];
        const index_t x = index / grid->shape[2] / grid->shape[1];
        to[0] = grid->origin[0] + static_cast<double>(x) * grid->spacing;
        to[1] = grid->origin[1] + static_cast<double>(y) * grid->spacing;
        to[2] = grid->origin[2] + static_cast<double>(z) * grid->spacing;
    } else {
        const auto& xyz = *std::get_if<std::span<const double>>(&points_);
        std::copy_n(xyz.begin() + 3 * index, 3, to);
    }
}

void PointBlocks::fetch_grid_block(index_t block, BlockPoints& out) const noexcept {
    const auto& grid = *std::get_if<VoxelGrid>(&points_);
    const index_t blocks_y = divide_up(grid.shape[1], edge_);
    const index_t blocks_z = divide_up(grid.shape[2], edge_);
    const index_t first[3] = {block / blocks_z / blocks_y * edge_,
                              block / blocks_z % blocks_y * edge_, block % blocks_z * edge_};
    index_t last[3];
    for (std::size_t axis = 0; axis < 3; ++axis) {
        last[axis] = std::min(first[axis] + edge_, grid.shape[axis]);
    }
    const index_t n = (last[0] - first[0]) * (last[1] - first[1]) * (last[2] - first[2]);
    out.index.resize(static_cast<std::size_t>(n));
    out.positions.resize(static_cast<std::size_t>(3 * n));
    index_t* index = out.index.data();
    double* to = out.positions.data();
    for (index_t x = first[0]; x < last[0]; ++x) {
        for (index_t y = first[1]; y < last[1]; ++y) {
            for (index_t z = first[2]; z < last[2]; ++z, to += 3) {
                *index++ = (x * grid.shape[1] + y) * grid.shape[2] + z;
                to[0] = grid.origin[0] + static_cast<double>(x) * grid.spacing;
                to[1] = grid.origin[1] + static_cast<double>(y) * grid.spacing;
                to[2] = grid.origin[2] + static_cast<double>(z) * grid.spacing;
            }
        }
    }
}

void PointBlocks::fetch(index_t block, BlockPoints& out) const noexcept {
    out.index.clear();
    out.positions.clear();
    out.exact = kind_ == Kind::chunks;
    if (kind_ == Kind::grid_blocks) {
        fetch_grid_block(block, out);
    } else if (kind_ == Kind::cells) {
        const auto at = static_cast<std::size_t>(block);
        out.exact = exact_[at];
        out.index.assign(order_.begin() + starts_[at], order_.begin() + starts_[at + 1]);
    } else {
        const index_t end = std::min((block + 1) * chunk_points, n_points_);
        for (index_t i = block * chunk_points; i < end; ++i) {
            out.index.push_back(i);
        }
    }
    const index_t padded = divide_up(out.n_points(), point_quantum) * point_quantum;
    out.positions.resize(static_cast<std::size_t>(3 * padded));
    if (kind_ != Kind::grid_blocks) {
        for (index_t i = 0; i < out.n_points(); ++i) {
            position(out.index[static_cast<std::size_t>(i)], out.positions.data() + 3 * i);
        }
    }
    double low[3];
    double high[3];
    for (index_t i = 0; i < out.n_points(); ++i) {
        const double* p = out.positions.data() + 3 * i;
        for (int axis = 0; axis < 3; ++axis) {
            low[axis] = i == 0 ? p[axis] : std::min(low[axis], p[axis]);
            high[axis] = i == 0 ? p[axis] : std::max(high[axis], p[axis]);
        }
    }
    double square = 0.0;
    for (int axis = 0; axis < 3; ++axis) {
        out.center[axis] = 0.5 * (low[axis] + high[axis]);
        square += 0.25 * (high[axis] - low[axis]) * (high[axis] - low[axis]);
    }
    out.radius = std::sqrt(square);
    for (index_t i = out.n_points(); i < padded; ++i) {
        std::copy_n(out.center, 3, out.positions.data() + 3 * i);
    }
}

} // namespace geraf2::detail
