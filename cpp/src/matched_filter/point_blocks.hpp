// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

#include "geraf2/matched_filter.hpp"
#include "geraf2/types.hpp"

namespace geraf2::detail {

/// How points are to be gathered into blocks.
struct BlockRule {
    double max_radius = 0.0; ///< of a block for the block method [m]; 0: no such blocks
    index_t min_points = 1;  ///< with fewer, the exact method is cheaper
};

/// The points of one block. Padded to point_quantum by repeating the centre.
struct BlockPoints {
    std::vector<index_t> index;    ///< index of each point in the point set
    std::vector<double> positions; ///< (padded length, 3) [m]
    double center[3] = {};
    double radius = 0.0;
    bool exact = false;

    BlockPoints();
    [[nodiscard]] index_t n_points() const noexcept { return static_cast<index_t>(index.size()); }
    [[nodiscard]] index_t n_padded() const noexcept {
        return static_cast<index_t>(positions.size() / 3);
    }
};

/// Most points in one block: their accumulators, 128 bytes each, stay in the second-level cache.
inline constexpr index_t max_block_points = 1024;

/// The box around points, empty if there are none.
struct Extent {
    double low[3] = {};
    double high[3] = {};
};

/// points: (n_points, 3), those that are not NaN
Extent extent_of(std::span<const double> points, int num_threads) noexcept;

/// A partition of a point set. The same whatever the number of threads.
class PointBlocks {
public:
    PointBlocks(const PointSet& points, const BlockRule& rule, int num_threads = 1);

    [[nodiscard]] index_t n_points() const noexcept { return n_points_; }
    [[nodiscard]] index_t n_blocks() const noexcept { return n_blocks_; }

    /// Points in chunks for the exact method.
    [[nodiscard]] index_t n_exact_points() const noexcept;

    /// Points of a block; of a list, not of a grid.
    [[nodiscard]] index_t block_size(index_t block) const noexcept;

    /// Fills `out`, which never grows beyond its reserved memory: safe in a parallel region.
    void fetch(index_t block, BlockPoints& out) const noexcept;

private:
    void use_chunks() noexcept;
    void cut_grid(const BlockRule& rule);
    void sort_into_cells(const BlockRule& rule, int num_threads);
    void fetch_grid_block(index_t block, BlockPoints& out) const noexcept;
    void position(index_t index, double* to) const noexcept;

    enum class Kind { chunks, grid_blocks, cells };

    PointSet points_;
    Kind kind_ = Kind::chunks;
    index_t n_points_ = 0;
    index_t n_blocks_ = 0;
    index_t edge_ = 1;            ///< voxels along the edge of a grid block
    std::vector<index_t> order_;  ///< cells: points sorted by cell
    std::vector<index_t> starts_; ///< cells: first point of each block, then n_points
    std::vector<bool> exact_;     ///< cells: too few points for the block method
};

} // namespace geraf2::detail
