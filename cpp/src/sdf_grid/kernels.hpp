// SPDX-License-Identifier: Apache-2.0
// Interface between sdf_grid.cpp (portable code) and the kernels (one copy per instruction set).
#pragma once

#include "geraf2/types.hpp"

namespace geraf2::detail {

/// VoxelGrid as plain arrays, with what follows from it.
struct GridAxes {
    double origin[3] = {};    ///< [m]
    double spacing = 0.0;     ///< [m]
    double last[3] = {};      ///< index of the last voxel
    double last_cell[3] = {}; ///< index of the last cell, 0 if there is none
    index_t shape[3] = {};
};

/// Outputs of sampling, or inputs of spreading; null where unused. Shapes as in GridSamples.
template <class T>
struct GridPointers {
    T* value = nullptr;
    T* gradient = nullptr;
    T* hessian = nullptr;
};

template <class T>
struct SdfGridKernels {
    using Sample = void (*)(const T* values, const GridAxes& axes, const double* points,
                            index_t begin, index_t end, const GridPointers<T>& out);
    using Spread = void (*)(const GridPointers<const T>& from, const GridAxes& axes,
                            const double* points, index_t n_points, index_t first_x, index_t last_x,
                            T* values_grad);

    /// Points begin to end; by linear or cubic and by the highest derivative wanted, 0 to 2.
    Sample sample[2][3];
    /// Adds the contributions of points to the part of values_grad with first_x <= index along x <
    /// last_x, in their order; linear or cubic.
    Spread spread[2];
};

} // namespace geraf2::detail
