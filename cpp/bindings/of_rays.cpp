// SPDX-License-Identifier: Apache-2.0
// Bindings that are compiled together, see cpp/CMakeLists.txt.
#include "bind_lensless.cpp"
#include "bind_mesh_scene.cpp"
#include "bind_ray_march.cpp"
#include "bind_shared.cpp"
