// SPDX-License-Identifier: Apache-2.0
// A table of contents: each family of functions binds itself in bind_<kernel>.cpp.
#include <pybind11/pybind11.h>

namespace py = pybind11;

namespace geraf2::bindings {
void bind_shared(py::module_& m);
void bind_mesh_scene(py::module_& m);
void bind_grid_energy(py::module_& m);
void bind_lensless(py::module_& m);
void bind_matched_filter(py::module_& m);
void bind_pair_density(py::module_& m);
void bind_physical_optics(py::module_& m);
void bind_subaperture(py::module_& m);
void bind_ray_march(py::module_& m);
void bind_sdf_grid(py::module_& m);
void bind_signal_tracer(py::module_& m);
} // namespace geraf2::bindings

PYBIND11_MODULE(_core, m) {
    m.doc() = "Native kernels of geraf2; private, use geraf2.ops.";
    geraf2::bindings::bind_shared(m);
    geraf2::bindings::bind_mesh_scene(m);
    geraf2::bindings::bind_grid_energy(m);
    geraf2::bindings::bind_lensless(m);
    geraf2::bindings::bind_matched_filter(m);
    geraf2::bindings::bind_pair_density(m);
    geraf2::bindings::bind_physical_optics(m);
    geraf2::bindings::bind_subaperture(m);
    geraf2::bindings::bind_ray_march(m);
    geraf2::bindings::bind_sdf_grid(m);
    geraf2::bindings::bind_signal_tracer(m);
}
