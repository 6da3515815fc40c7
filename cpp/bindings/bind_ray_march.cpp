// SPDX-License-Identifier: Apache-2.0
#include "arrays.hpp"
#include "geraf2/ray_march.hpp"

namespace geraf2::bindings {

namespace {

template <class T>
RaySamples<T> samples_of(const Array<T>& sdf, const Array<T>& cos, const Array<T>& step,
                         double inv_s, int power) {
    require_shape("sdf", sdf, {-1, -1});
    require_shape("cos", cos, {sdf.shape(0), sdf.shape(1)});
    require_shape("step", step, {sdf.shape(0), sdf.shape(1)});
    return {view(sdf), view(cos), view(step), inv_s, sdf.shape(1), power};
}

template <class T>
void bind(py::module_& m) {
    m.def(
        "ray_march_fwd",
        [](const Array<T>& sdf, const Array<T>& cos, const Array<T>& step, double inv_s, int power,
           int num_threads) {
            const RaySamples<T> samples = samples_of(sdf, cos, step, inv_s, power);
            auto alpha = make_array<T>({sdf.shape(0), sdf.shape(1)});
            auto transmittance = make_array<T>({sdf.shape(0), sdf.shape(1)});
            auto weight = make_array<T>({sdf.shape(0), sdf.shape(1)});
            auto depth = make_array<T>({sdf.shape(0)});
            const RayWeights<T> out{mutable_view(alpha), mutable_view(transmittance),
                                    mutable_view(weight), mutable_view(depth)};
            {
                const py::gil_scoped_release nogil;
                ray_march_fwd<T>(samples, out, num_threads);
            }
            return py::make_tuple(alpha, transmittance, weight, depth);
        },
        py::arg("sdf").noconvert(), py::arg("cos").noconvert(), py::arg("step").noconvert(),
        py::arg("inv_s"), py::arg("power"), py::arg("num_threads"));
    m.def(
        "ray_march_bwd",
        [](const Array<T>& sdf, const Array<T>& cos, const Array<T>& step, double inv_s, int power,
           const Array<T>& alpha, const Array<T>& transmittance, const Array<T>& alpha_grad,
           const Array<T>& transmittance_grad, const Array<T>& weight_grad,
           const Array<T>& depth_grad, int num_threads) {
            const RaySamples<T> samples = samples_of(sdf, cos, step, inv_s, power);
            for (const auto* array :
                 {&alpha, &transmittance, &alpha_grad, &transmittance_grad, &weight_grad}) {
                require_shape("gradients and outputs", *array, {sdf.shape(0), sdf.shape(1)});
            }
            require_shape("depth_grad", depth_grad, {sdf.shape(0)});
            const RayWeights<const T> grad{view(alpha_grad), view(transmittance_grad),
                                           view(weight_grad), view(depth_grad)};
            auto sdf_grad = make_array<T>({sdf.shape(0), sdf.shape(1)});
            auto cos_grad = make_array<T>({sdf.shape(0), sdf.shape(1)});
            const auto to_sdf = mutable_view(sdf_grad);
            const auto to_cos = mutable_view(cos_grad);
            double inv_s_grad = 0.0;
            {
                const py::gil_scoped_release nogil;
                inv_s_grad = ray_march_bwd<T>(samples, view(alpha), view(transmittance), grad,
                                              num_threads, to_sdf, to_cos);
            }
            return py::make_tuple(sdf_grad, cos_grad, inv_s_grad);
        },
        py::arg("sdf").noconvert(), py::arg("cos").noconvert(), py::arg("step").noconvert(),
        py::arg("inv_s"), py::arg("power"), py::arg("alpha").noconvert(),
        py::arg("transmittance").noconvert(), py::arg("alpha_grad").noconvert(),
        py::arg("transmittance_grad").noconvert(), py::arg("weight_grad").noconvert(),
        py::arg("depth_grad").noconvert(), py::arg("num_threads"));
}

} // namespace

void bind_ray_march(py::module_& m) {
    bind<float>(m);
    bind<double>(m);
}

} // namespace geraf2::bindings
