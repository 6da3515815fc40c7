// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>

#include "geraf2/voxel_grid.hpp"

namespace geraf2 {

enum class GridInterpolation {
    linear, ///< trilinear: continuous
    cubic,  ///< tricubic, Catmull-Rom: through the grid's values, gradient continuous (C1)
};

/// Interpolates a grid's values, (shape) in C order, and their derivatives at points, (n_points,
/// 3) [m]. Beyond the grid the value of the nearest point on its rim counts. Empty outputs are not
/// wanted. T: float or double.
template <class T>
struct GridSamples {
    std::span<T> value;    ///< (n_points)
    std::span<T> gradient; ///< (n_points, 3) [1/m]
    std::span<T> hessian;  ///< (n_points, 6): xx, xy, xz, yy, yz, zz [1/m^2]
};

template <class T>
void sdf_grid_fwd(std::span<const T> values, const VoxelGrid& grid, std::span<const double> points,
                  GridInterpolation interpolation, int num_threads, const GridSamples<T>& out);

/// The adjoint of value and gradient: adds to values_grad, (shape). Either input may be empty. The
/// result does not depend on num_threads, not even in its last bit.
template <class T>
void sdf_grid_bwd(std::span<const T> value_grad,    // (n_points)
                  std::span<const T> gradient_grad, // (n_points, 3)
                  const VoxelGrid& grid, std::span<const double> points,
                  GridInterpolation interpolation, int num_threads, std::span<T> values_grad);

} // namespace geraf2
