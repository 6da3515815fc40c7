// SPDX-License-Identifier: Apache-2.0
// Types of several kernels, and information on build and machine.
#include <omp.h>
#include <pybind11/stl.h>

#include <array>
#include <string>

#include "arrays.hpp"
#include "geraf2/error.hpp"
#include "geraf2/simd.hpp"
#include "geraf2/version.hpp"
#include "geraf2/voxel_grid.hpp"
#include "geraf2/wave.hpp"

namespace geraf2::bindings {

void bind_shared(py::module_& m) {
    py::register_exception<EmbreeError>(m, "EmbreeError", PyExc_RuntimeError);
    m.def("embree_major", &embree_major);
    m.def("simd_level", [] { return std::string(simd_level_name(simd_level())); });
    m.def("max_threads", &omp_get_max_threads);
    py::class_<Waveform>(m, "Waveform")
        .def(py::init<double, double, double, index_t, double>(), py::arg("start_frequency_hz"),
             py::arg("chirp_slope_hz_per_s"), py::arg("sample_rate_hz"), py::arg("n_samples"),
             py::arg("path_bias_m"));
    py::class_<VoxelGrid>(m, "VoxelGrid")
        .def(py::init<std::array<double, 3>, double, std::array<index_t, 3>>(), py::arg("origin"),
             py::arg("spacing"), py::arg("shape"));
}

} // namespace geraf2::bindings
