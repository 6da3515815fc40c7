// SPDX-License-Identifier: Apache-2.0
#include "geraf2/sdf_grid.hpp"

#include <algorithm>

#include "sdf_grid/kernels.hpp"
#include "simd/dispatch.hpp"

namespace geraf2 {
namespace {

using detail::GridAxes;
using detail::GridPointers;
using detail::SdfGridKernels;

/// Points that justify another thread: some 20 us of work, beside some 5 us to start it.
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

} // namespace

template <class T>
void sdf_grid_fwd(std::span<const T> values, const VoxelGrid& grid, std::span<const double> points,
                  GridInterpolation interpolation, int num_threads, const GridSamples<T>& out) {
    const auto n_points = static_cast<index_t>(points.size() / 3);
    const GridAxes axes = axes_of(grid);
    const GridPointers<T> to{data_or_null(out.value), data_or_null(out.gradient),
                             data_or_null(out.hessian)};
    const std::size_t order = to.hessian != nullptr ? 2 : (to.gradient != nullptr ? 1 : 0);
    const auto sample = detail::kernels_for_cpu<SdfGridKernels<T>>()
                            .sample[interpolation == GridInterpolation::cubic ? 1 : 0][order];
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
    const auto spread = detail::kernels_for_cpu<SdfGridKernels<T>>().spread[cubic ? 1 : 0];
    const index_t slabs =
        std::clamp<index_t>(grid.shape[0], 1, useful_threads(n_points, num_threads));
    // Each thread owns a slab of the grid, searches all points for those that touch it and sees
    // them in their order: every voxel is summed in that order, whatever the number of threads.
    // Lists of each slab's points would have to be written, and read by another thread.
#pragma omp parallel for num_threads(slabs) schedule(static) if (slabs > 1)
    for (index_t slab = 0; slab < slabs; ++slab) {
        spread(from, axes, points.data(), n_points, slab * grid.shape[0] / slabs,
               (slab + 1) * grid.shape[0] / slabs, values_grad.data());
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
