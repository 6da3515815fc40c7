// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>

#include "geraf2/types.hpp"

namespace geraf2 {

/// Regular voxel centres at origin + index * spacing; the last axis runs fastest.
struct VoxelGrid {
    std::array<double, 3> origin{}; ///< [m]
    double spacing = 0.0;           ///< [m]
    std::array<index_t, 3> shape{};
};

} // namespace geraf2
