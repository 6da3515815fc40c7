// SPDX-License-Identifier: Apache-2.0
#include <array>
#include <complex>
#include <vector>

#include <pybind11/stl.h>

#include "arrays.hpp"
#include "geraf2/physical_optics.hpp"

namespace geraf2::bindings {

namespace {

// Row of a wall: center (3), half sides (3), thickness, permittivity.
std::vector<DielectricBox> read_walls(const Array<double>& walls) {
    std::vector<DielectricBox> boxes;
    for (py::ssize_t i = 0; i < walls.shape(0); ++i) {
        const double* w = walls.data(i, 0);
        boxes.push_back({{w[0], w[1], w[2]}, {w[3], w[4], w[5]}, w[6], w[7]});
    }
    return boxes;
}

template <class T>
void bind_waves(py::module_& m) {
    m.def(
        "physical_optics",
        [](const Doubles& points, const Doubles& normals, const Doubles& edges,
           const Array<std::complex<T>>& weights, const Doubles& tx, const Doubles& rx,
           const Array<index_t>& block_offsets, const Doubles& walls, const EchoParams& params,
           int num_threads) {
            require_shape("points", points, {-1, 3});
            require_shape("normals", normals, {-1, 3});
            require_shape("edges", edges, {-1, 2, 3});
            require_shape("block_offsets", block_offsets, {-1});
            require_shape("weights", weights, {block_offsets.shape(0) - 1, points.shape(0)});
            require_shape("tx", tx, {-1, 3});
            require_shape("rx", rx, {tx.shape(0), 3});
            require_shape("walls", walls, {-1, 8});
            auto signal = make_array<std::complex<T>>(
                {tx.shape(0), static_cast<py::ssize_t>(params.waveform.n_samples)});
            const auto signal_view = mutable_view(signal);
            const std::vector<DielectricBox> boxes = read_walls(walls);
            {
                const py::gil_scoped_release nogil;
                physical_optics<T>(view(points), view(normals), view(edges), view(weights),
                                   view(tx), view(rx), view(block_offsets), boxes, params,
                                   signal_view, num_threads);
            }
            return signal;
        },
        py::arg("points").noconvert(), py::arg("normals").noconvert(), py::arg("edges").noconvert(),
        py::arg("weights").noconvert(), py::arg("tx").noconvert(), py::arg("rx").noconvert(),
        py::arg("block_offsets").noconvert(), py::arg("walls").noconvert(), py::arg("params"),
        py::arg("num_threads"));
}

} // namespace

void bind_physical_optics(py::module_& m) {
    py::enum_<ElementShape>(m, "ElementShape")
        .value("point", ElementShape::point)
        .value("triangle", ElementShape::triangle)
        .value("rectangle", ElementShape::rectangle);
    py::enum_<Reflector>(m, "Reflector")
        .value("conductor", Reflector::conductor)
        .value("slab", Reflector::slab);
    py::class_<EchoParams>(m, "EchoParams")
        .def(py::init([](const Waveform& waveform) {
                 EchoParams params;
                 params.waveform = waveform;
                 return params;
             }),
             py::arg("waveform"))
        .def_readwrite("shape", &EchoParams::shape)
        .def_readwrite("reflector", &EchoParams::reflector)
        .def_readwrite("slab_permittivity", &EchoParams::slab_permittivity)
        .def_readwrite("slab_crossing", &EchoParams::slab_crossing)
        .def_readwrite("slab_thickness_m", &EchoParams::slab_thickness_m)
        .def_readwrite("pattern_exponent", &EchoParams::pattern_exponent)
        .def_property(
            "boresight",
            [](const EchoParams& p) {
                return py::make_tuple(p.boresight.x, p.boresight.y, p.boresight.z);
            },
            [](EchoParams& p, const std::array<double, 3>& v) {
                p.boresight = {v[0], v[1], v[2]};
            });
    bind_waves<float>(m);
    bind_waves<double>(m);
}

} // namespace geraf2::bindings
