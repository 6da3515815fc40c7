// SPDX-License-Identifier: Apache-2.0
#include <algorithm>

#include "arrays.hpp"
#include "geraf2/sdf_grid.hpp"

namespace geraf2::bindings {

namespace {

GridInterpolation interpolation_of(bool cubic) {
    return cubic ? GridInterpolation::cubic : GridInterpolation::linear;
}

template <class T>
void bind_interpolation(py::module_& m) {
    m.def(
        "sdf_grid_fwd",
        [](const Array<T>& values, const VoxelGrid& grid, const Array<double>& points, bool cubic,
           bool want_hessian, int num_threads) {
            require_shape("values", values, {grid.shape[0], grid.shape[1], grid.shape[2]});
            require_shape("points", points, {-1, 3});
            auto value = make_array<T>({points.shape(0)});
            auto gradient = make_array<T>({points.shape(0), 3});
            auto hessian = make_array<T>({want_hessian ? points.shape(0) : 0, 6});
            const GridSamples<T> out{mutable_view(value), mutable_view(gradient),
                                     mutable_view(hessian)};
            {
                const py::gil_scoped_release nogil;
                sdf_grid_fwd<T>(view(values), grid, view(points), interpolation_of(cubic),
                                num_threads, out);
            }
            return py::make_tuple(value, gradient, hessian);
        },
        py::arg("values").noconvert(), py::arg("grid"), py::arg("points").noconvert(),
        py::arg("cubic"), py::arg("want_hessian"), py::arg("num_threads"));
    m.def(
        "sdf_grid_bwd",
        [](const Array<T>& value_grad, const Array<T>& gradient_grad, const VoxelGrid& grid,
           const Array<double>& points, bool cubic, int num_threads) {
            require_shape("points", points, {-1, 3});
            require_shape("value_grad", value_grad, {points.shape(0)});
            require_shape("gradient_grad", gradient_grad, {points.shape(0), 3});
            auto values_grad = make_array<T>({grid.shape[0], grid.shape[1], grid.shape[2]});
            const auto out = mutable_view(values_grad);
            {
                const py::gil_scoped_release nogil;
                std::fill(out.begin(), out.end(), T{});
                sdf_grid_bwd<T>(view(value_grad), view(gradient_grad), grid, view(points),
                                interpolation_of(cubic), num_threads, out);
            }
            return values_grad;
        },
        py::arg("value_grad").noconvert(), py::arg("gradient_grad").noconvert(), py::arg("grid"),
        py::arg("points").noconvert(), py::arg("cubic"), py::arg("num_threads"));
}

} // namespace

void bind_sdf_grid(py::module_& m) {
    bind_interpolation<float>(m);
    bind_interpolation<double>(m);
}

} // namespace geraf2::bindings
