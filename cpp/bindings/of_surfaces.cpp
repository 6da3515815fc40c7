// SPDX-License-Identifier: Apache-2.0
// Bindings that are compiled together, see cpp/CMakeLists.txt.
#include "bind_grid_energy.cpp"
#include "bind_pair_density.cpp"
#include "bind_sdf_grid.cpp"
#include "module.cpp"
