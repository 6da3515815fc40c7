// SPDX-License-Identifier: Apache-2.0
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <memory>

#include "arrays.hpp"
#include "geraf2/grid_energy.hpp"

namespace geraf2::bindings {

namespace {

template <class T>
void bind_energy(py::module_& m, const char* name) {
    using Energy = GridEnergy<T>;
    py::class_<Energy>(m, name)
        .def(py::init([](const std::array<index_t, 3>& shape, const std::array<double, 3>& spacing,
                         double bending, const Array<index_t>& rows, const Array<index_t>& starts,
                         const Array<std::int32_t>& columns, const Array<double>& values,
                         const Array<double>& diagonal) {
                 require_shape("starts", starts, {rows.size() + 1});
                 require_shape("values", values, {columns.size()});
                 require_shape("diagonal", diagonal,
                               {static_cast<py::ssize_t>(shape[0] * shape[1] * shape[2])});
                 const py::gil_scoped_release nogil;
                 return std::make_unique<Energy>(
                     EnergyGrid{shape, spacing}, bending,
                     SparseRows{view(rows), view(starts), view(columns), view(values)},
                     view(diagonal));
             }),
             py::arg("shape"), py::arg("spacing"), py::arg("bending"), py::arg("rows").noconvert(),
             py::arg("starts").noconvert(), py::arg("columns").noconvert(),
             py::arg("values").noconvert(), py::arg("diagonal").noconvert())
        .def(
            "apply",
            [](const Energy& energy, const Array<T>& field, int num_threads) {
                require_shape("field", field, {-1});
                auto product = make_array<T>({field.shape(0)});
                const auto out = mutable_view(product);
                {
                    const py::gil_scoped_release nogil;
                    energy.apply(view(field), out, num_threads);
                }
                return product;
            },
            py::arg("field").noconvert(), py::arg("num_threads"))
        .def(
            "diagonal",
            [](const Energy& energy, py::ssize_t n_voxels) {
                auto values = make_array<T>({n_voxels});
                energy.diagonal(mutable_view(values));
                return values;
            },
            py::arg("n_voxels"))
        .def(
            "smooth",
            [](const Energy& energy, const Array<T>& right, const Array<T>& field, int degree,
               double low, double high, int num_threads) {
                require_shape("right", right, {-1});
                require_shape("field", field, {right.shape(0)});
                auto moved = make_array<T>({right.shape(0)});
                const auto out = mutable_view(moved);
                {
                    const py::gil_scoped_release nogil;
                    const auto from = view(field);
                    std::copy(from.begin(), from.end(), out.begin());
                    energy.smooth(view(right), {degree, low, high}, num_threads, out);
                }
                return moved;
            },
            py::arg("right").noconvert(), py::arg("field").noconvert(), py::arg("degree"),
            py::arg("low"), py::arg("high"), py::arg("num_threads"));
}

} // namespace

void bind_grid_energy(py::module_& m) {
    bind_energy<float>(m, "GridEnergyFloat");
    bind_energy<double>(m, "GridEnergyDouble");
}

} // namespace geraf2::bindings
