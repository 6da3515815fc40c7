// SPDX-License-Identifier: Apache-2.0
#include "geraf2/sdf_grid.hpp"

#include <algorithm>
#include <cstdint>
#include <limits>
#include <memory>
#include <vector>

#include "geraf2/simd.hpp"
#include "sdf_grid_kernels.hpp"

namespace geraf2 {
namespace {

using detail::GridAxes;
using detail::GridPointers;
using detail::PointRange;
using detail::SdfGridKernels;

template <class T>
const SdfGridKernels<T>& grid_kernels() {
    switch (simd_level()) {
#if defined(__x86_64__)
    case SimdLevel::avx512:
        return detail::sdf_grid_kernels_avx512<T>();
    case SimdLevel::avx2:
        return detail::sdf_grid_kernels_avx2<T>();
#endif
    default:
        return detail::sdf_grid_kernels_baseline<T>();
    }
}

/// Points that are worth another thread: some 20 us of work, beside some 5 us to start it.
constexpr index_t points_per_thread = 2048;

int useful_threads(index_t n_points, int num_threads) noexcept {
    return static_cast<int>(std::clamp<index_t>(n_points / points_per_thread, 1, num_threads));
}

GridAxes axes_of(const VoxelGrid& grid) noexcept {
    GridAxes out;
    out.spacing = grid.spacing;
    for (std::size_t axis = 0; axis < 3; ++axis) {
        out.origin[axis] = grid.origin[axis];
        out.last[axis] = static_cast<double>(grid.shape[axis] - 1);
        out.last_cell[axis] = static_cast<double>(std::max<index_t>(grid.shape[axis] - 2, 0));
        out.shape[axis] = grid.shape[axis];
    }
    return out;
}

template <class T>
T* data_or_null(std::span<T> of) noexcept {
    return of.empty() ? nullptr : of.data();
}

/// Points by the slabs of the grid that they touch, in their order. Parts of the points are sorted
/// by a thread each; a slab has a list of every part.
class PointsBySlab {
public:
    /// reach: rows of the grid that a point touches beyond those of its cell.
    PointsBySlab(const GridAxes& axes, std::span<const double> points, index_t reach, int slabs)
        : axes_(axes), slabs_(static_cast<std::size_t>(slabs)), n_points_(points.size() / 3),
          ends_(slabs_ * slabs_),
          order_(std::make_unique_for_overwrite<std::uint32_t[]>(slabs_ * n_points_)) {
        std::vector<std::size_t> slab_of; // by row along x
        for (std::size_t slab = 0; slab < slabs_; ++slab) {
            slab_of.resize(static_cast<std::size_t>(first_row(slab + 1)), slab);
        }
        const double per_m = 1.0 / axes.spacing;
        const double last_row = axes.last[0];
        const double below = static_cast<double>(reach) + 1e-6;
#pragma omp parallel for num_threads(slabs) schedule(static)
        for (std::size_t part = 0; part < slabs_; ++part) {
            std::vector<std::uint32_t*> next(slabs_);
            for (std::size_t slab = 0; slab < slabs_; ++slab) {
                next[slab] = list(part, slab);
            }
            for (std::size_t i = first_point(part); i < first_point(part + 1); ++i) {
                // A product where the kernel divides, and so somewhat more rows: it leaves out what
                // is not the slab's.
                const double place = clamped((points[3 * i] - axes_.origin[0]) * per_m, last_row);
                const std::size_t slab = slab_of[row_at(place - below, last_row)];
                const std::size_t last = slab_of[row_at(place + below + 1.0, last_row)];
                // Which slab is looked up, not branched on: of random points half would be foreseen
                // wrongly. That there is another is rare.
                *next[slab]++ = static_cast<std::uint32_t>(i);
                for (std::size_t other = slab + 1; other <= last; ++other) {
                    *next[other]++ = static_cast<std::uint32_t>(i);
                }
            }
            for (std::size_t slab = 0; slab < slabs_; ++slab) {
                ends_[part * slabs_ + slab] = next[slab] - list(part, slab);
            }
        }
    }

    /// Where a slab begins along x.
    [[nodiscard]] index_t first_row(std::size_t slab) const noexcept {
        return static_cast<index_t>(slab) * axes_.shape[0] / static_cast<index_t>(slabs_);
    }

    /// The points of one part that touch a slab.
    [[nodiscard]] PointRange range(std::size_t part, std::size_t slab) const noexcept {
        return {list(part, slab), 0, ends_[part * slabs_ + slab]};
    }

private:
    [[nodiscard]] std::size_t first_point(std::size_t part) const noexcept {
        return part * n_points_ / slabs_;
    }

    /// Room for all points of a part.
    [[nodiscard]] std::uint32_t* list(std::size_t part, std::size_t slab) const noexcept {
        const std::size_t first = first_point(part);
        return order_.get() + slabs_ * first + slab * (first_point(part + 1) - first);
    }

    /// NaN counts as 0, as it does in the kernel.
    [[nodiscard]] static double clamped(double place, double last_row) noexcept {
        return std::min(place > 0.0 ? place : 0.0, last_row);
    }

    [[nodiscard]] static std::size_t row_at(double place, double last_row) noexcept {
        return static_cast<std::size_t>(static_cast<index_t>(clamped(place, last_row)));
    }

    const GridAxes& axes_;
    std::size_t slabs_, n_points_;
    std::vector<index_t> ends_; // of the lists, (part, slab)
    std::unique_ptr<std::uint32_t[]> order_;
};

} // namespace

template <class T>
void sdf_grid_fwd(std::span<const T> values, const VoxelGrid& grid, std::span<const double> points,
                  GridInterpolation interpolation, int num_threads, const GridSamples<T>& out) {
    const auto n_points = static_cast<index_t>(points.size() / 3);
    const GridAxes axes = axes_of(grid);
    const GridPointers<T> to{data_or_null(out.value), data_or_null(out.gradient),
                             data_or_null(out.hessian)};
    const std::size_t order = to.hessian != nullptr ? 2 : (to.gradient != nullptr ? 1 : 0);
    const auto sample =
        grid_kernels<T>().sample[interpolation == GridInterpolation::cubic ? 1 : 0][order];
    const int threads = useful_threads(n_points, num_threads);
#pragma omp parallel for num_threads(threads) schedule(static) if (threads > 1)
    for (index_t part = 0; part < threads; ++part) {
        sample(values.data(), axes, points.data(), part * n_points / threads,
               (part + 1) * n_points / threads, to);
    }
}

template <class T>
void sdf_grid_bwd(std::span<const T> value_grad, std::span<const T> gradient_grad,
                  const VoxelGrid& grid, std::span<const double> points,
                  GridInterpolation interpolation, int num_threads, std::span<T> values_grad) {
    const auto n_points = static_cast<index_t>(points.size() / 3);
    const GridAxes axes = axes_of(grid);
    const GridPointers<const T> from{data_or_null(value_grad), data_or_null(gradient_grad),
                                     nullptr};
    const bool cubic = interpolation == GridInterpolation::cubic;
    const auto spread = grid_kernels<T>().spread[cubic ? 1 : 0];
    const auto slabs = static_cast<int>(
        std::clamp<index_t>(grid.shape[0], 1, useful_threads(n_points, num_threads)));
    if (slabs == 1 || n_points > std::numeric_limits<std::uint32_t>::max()) {
        spread(from, axes, points.data(), {nullptr, 0, n_points}, 0, grid.shape[0],
               values_grad.data());
        return;
    }
    // Each thread owns a slab of the grid and sees its points in their order: every voxel is summed
    // in that order, whatever the number of threads.
    const PointsBySlab lists(axes, points, cubic ? 1 : 0, slabs);
#pragma omp parallel for num_threads(slabs) schedule(static)
    for (std::size_t slab = 0; slab < static_cast<std::size_t>(slabs); ++slab) {
        for (std::size_t part = 0; part < static_cast<std::size_t>(slabs); ++part) {
            spread(from, axes, points.data(), lists.range(part, slab), lists.first_row(slab),
                   lists.first_row(slab + 1), values_grad.data());
        }
    }
}

template void sdf_grid_fwd<float>(std::span<const float>, const VoxelGrid&, std::span<const double>,
                                  GridInterpolation, int, const GridSamples<float>&);
template void sdf_grid_fwd<double>(std::span<const double>, const VoxelGrid&,
                                   std::span<const double>, GridInterpolation, int,
                                   const GridSamples<double>&);
template void sdf_grid_bwd<float>(std::span<const float>, std::span<const float>, const VoxelGrid&,
                                  std::span<const double>, GridInterpolation, int,
                                  std::span<float>);
template void sdf_grid_bwd<double>(std::span<const double>, std::span<const double>,
                                   const VoxelGrid&, std::span<const double>, GridInterpolation,
                                   int, std::span<double>);

} // namespace geraf2
