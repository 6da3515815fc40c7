// SPDX-License-Identifier: Apache-2.0

#include "arrays.hpp"
#include "geraf2/pair_density.hpp"

namespace geraf2::bindings {

namespace {

PeakPoints points_of(const Doubles& positions, const Doubles& normals, const Indices& planes,
                     const Indices& subapertures) {
    require_shape("planes", planes, {-1});
    require_shape("positions", positions, {planes.shape(0), 3});
    require_shape("normals", normals, {planes.shape(0), 3});
    require_shape("subapertures", subapertures, {planes.shape(0)});
    return {view(positions), view(normals), view(planes), view(subapertures)};
}

} // namespace

void bind_pair_density(py::module_& m) {
    py::class_<PairModel>(m, "PairModel")
        .def(py::init<double, double, double, double, double, double, double, double>(),
             py::kw_only(), py::arg("reach"), py::arg("least_cosine"), py::arg("spread"),
             py::arg("offset_variance"), py::arg("bend"), py::arg("turn_variance"),
             py::arg("curvature"), py::arg("least_density"));
    m.def(
        "pair_densities",
        [](const Doubles& positions, const Doubles& normals, const Indices& planes,
           const Indices& subapertures, const Doubles& other_positions,
           const Doubles& other_normals, const Indices& other_planes,
           const Indices& other_subapertures, const PairModel& model) {
            const auto points = points_of(positions, normals, planes, subapertures);
            const auto others =
                points_of(other_positions, other_normals, other_planes, other_subapertures);
            PairRows rows;
            {
                const py::gil_scoped_release nogil;
                rows = pair_densities(points, others, model);
            }
            return py::make_tuple(copy_array(rows.densities), copy_array(rows.columns),
                                  copy_array(rows.starts));
        },
        py::arg("positions").noconvert(), py::arg("normals").noconvert(),
        py::arg("planes").noconvert(), py::arg("subapertures").noconvert(),
        py::arg("other_positions").noconvert(), py::arg("other_normals").noconvert(),
        py::arg("other_planes").noconvert(), py::arg("other_subapertures").noconvert(),
        py::arg("model"));
}

} // namespace geraf2::bindings
