// SPDX-License-Identifier: Apache-2.0
#include <pybind11/complex.h>
#include <pybind11/functional.h>
#include <pybind11/stl.h>

#include <complex>
#include <functional>
#include <memory>

#include "antennas.hpp"
#include "arrays.hpp"
#include "geraf2/matched_filter.hpp"

namespace geraf2::bindings {

namespace {

PointSet points_of(const Doubles& points) {
    require_shape("points", points, {-1, 3});
    return view(points);
}

PointSet points_of(const VoxelGrid& grid) { return grid; }

py::ssize_t count(const PointSet& points) {
    if (const auto* grid = std::get_if<VoxelGrid>(&points)) {
        return static_cast<py::ssize_t>(grid->shape[0] * grid->shape[1] * grid->shape[2]);
    }
    return static_cast<py::ssize_t>(std::get<std::span<const double>>(points).size() / 3);
}

template <class T, class Points, class Class>
void bind_init(Class& plan) {
    plan.def(py::init([](const Doubles& tx, const Doubles& rx, const Points& points,
                         const Waveform& waveform, const MatchedFilterOptions& options) {
                 const AntennaPositions antennas = antennas_of(tx, rx);
                 const PointSet set = points_of(points);
                 const py::gil_scoped_release nogil;
                 return std::make_unique<MatchedFilterPlan<T>>(antennas, set, waveform, options);
             }),
             py::arg("tx").noconvert(), py::arg("rx").noconvert(), py::arg("points").noconvert(),
             py::arg("waveform"), py::arg("options"));
}

template <class T>
void bind_plan(py::module_& m, const char* name) {
    using Plan = MatchedFilterPlan<T>;
    py::class_<Plan> bound(m, name);
    bind_init<T, Doubles>(bound);
    bind_init<T, VoxelGrid>(bound);
    bound
        .def(
            "image",
            [](const Plan& plan, const Array<std::complex<T>>& signal,
               const std::function<void(double)>& progress) {
                require_shape("signal", signal, {plan.n_antennas(), plan.n_samples()});
                auto image = make_array<std::complex<T>>({plan.n_points()});
                const auto out = mutable_view(image);
                {
                    const py::gil_scoped_release nogil;
                    plan.image(view(signal), progress, out);
                }
                return image;
            },
            py::arg("signal").noconvert(), py::arg("progress"))
        .def(
            "adjoint",
            [](const Plan& plan, const Array<std::complex<T>>& image) {
                require_shape("image", image, {plan.n_points()});
                auto signal = make_array<std::complex<T>>({plan.n_antennas(), plan.n_samples()});
                const auto out = mutable_view(signal);
                {
                    const py::gil_scoped_release nogil;
                    plan.adjoint(view(image), out);
                }
                return signal;
            },
            py::arg("image").noconvert());
}

template <class T, class Points>
void bind_choose(py::module_& m, const char* name) {
    m.def(
        name,
        [](const Doubles& tx, const Doubles& rx, const Points& points, const Waveform& waveform,
           const MatchedFilterOptions& options) {
            const AntennaPositions antennas = antennas_of(tx, rx);
            const PointSet set = points_of(points);
            const py::gil_scoped_release nogil;
            return choose_matched_filter<T>(antennas, set, waveform, options);
        },
        py::arg("tx").noconvert(), py::arg("rx").noconvert(), py::arg("points").noconvert(),
        py::arg("waveform"), py::arg("options"));
}

template <class T, class Points>
void bind_bwd_positions(py::module_& m) {
    m.def(
        "matched_filter_bwd_positions",
        [](const Array<std::complex<T>>& image_grad, const Array<std::complex<T>>& signal,
           const Doubles& tx, const Doubles& rx, const Points& points, const Waveform& waveform,
           int num_threads, bool want_antennas, bool want_points) {
            const AntennaPositions antennas = antennas_of(tx, rx);
            require_shape("signal", signal, {tx.shape(0), waveform.n_samples});
            const PointSet set = points_of(points);
            require_shape("image_grad", image_grad, {count(set)});
            const py::ssize_t n_antennas = want_antennas ? tx.shape(0) : 0;
            auto tx_grad = make_array<double>({n_antennas, 3});
            auto rx_grad = make_array<double>({n_antennas, 3});
            auto points_grad = make_array<double>({want_points ? count(set) : 0, 3});
            const PositionGradients gradients{mutable_view(tx_grad), mutable_view(rx_grad),
                                              mutable_view(points_grad)};
            {
                const py::gil_scoped_release nogil;
                matched_filter_bwd_positions<T>(view(image_grad), view(signal), antennas, set,
                                                waveform, num_threads, gradients);
            }
            return py::make_tuple(tx_grad, rx_grad, points_grad);
        },
        py::arg("image_grad").noconvert(), py::arg("signal").noconvert(), py::arg("tx").noconvert(),
        py::arg("rx").noconvert(), py::arg("points").noconvert(), py::arg("waveform"),
        py::arg("num_threads"), py::arg("want_antennas"), py::arg("want_points"));
}

template <class T>
void bind_point_images(py::module_& m) {
    m.def(
        "point_images_fwd",
        [](const Array<std::complex<T>>& signals, const Doubles& tx, const Doubles& rx,
           const Doubles& points, const Waveform& waveform, int num_threads) {
            const AntennaPositions antennas = antennas_of(tx, rx);
            require_shape("signals", signals, {-1, tx.shape(0), waveform.n_samples});
            require_shape("points", points, {-1, 3});
            auto images = make_array<std::complex<T>>({signals.shape(0), points.shape(0)});
            const auto out = mutable_view(images);
            {
                const py::gil_scoped_release nogil;
                point_images_fwd<T>(view(signals), signals.shape(0), antennas, view(points),
                                    waveform, num_threads, out);
            }
            return images;
        },
        py::arg("signals").noconvert(), py::arg("tx").noconvert(), py::arg("rx").noconvert(),
        py::arg("points").noconvert(), py::arg("waveform"), py::arg("num_threads"));
    m.def(
        "point_images_bwd",
        [](const Array<std::complex<T>>& images, const Doubles& tx, const Doubles& rx,
           const Doubles& points, const Waveform& waveform, int num_threads) {
            const AntennaPositions antennas = antennas_of(tx, rx);
            require_shape("points", points, {-1, 3});
            require_shape("images", images, {-1, points.shape(0)});
            auto signals = make_array<std::complex<T>>(
                {images.shape(0), tx.shape(0), static_cast<py::ssize_t>(waveform.n_samples)});
            const auto out = mutable_view(signals);
            {
                const py::gil_scoped_release nogil;
                point_images_bwd<T>(view(images), images.shape(0), antennas, view(points), waveform,
                                    num_threads, out);
            }
            return signals;
        },
        py::arg("images").noconvert(), py::arg("tx").noconvert(), py::arg("rx").noconvert(),
        py::arg("points").noconvert(), py::arg("waveform"), py::arg("num_threads"));
}

} // namespace

void bind_matched_filter(py::module_& m) {
    py::enum_<MatchedFilterMethod>(m, "MatchedFilterMethod")
        .value("automatic", MatchedFilterMethod::automatic)
        .value("exact", MatchedFilterMethod::exact)
        .value("block", MatchedFilterMethod::block)
        .value("factorised", MatchedFilterMethod::factorised);
    py::class_<MatchedFilterOptions>(m, "MatchedFilterOptions")
        .def(py::init([](MatchedFilterMethod method, double rtol, int num_threads,
                         double max_memory_bytes) {
                 return MatchedFilterOptions{method, rtol, num_threads, max_memory_bytes};
             }),
             py::arg("method"), py::arg("rtol"), py::arg("num_threads"),
             py::arg("max_memory_bytes"));
    py::class_<MatchedFilterChoice>(m, "MatchedFilterChoice")
        .def_readonly("method", &MatchedFilterChoice::method)
        .def_readonly("exact_cost", &MatchedFilterChoice::exact_cost)
        .def_readonly("block_cost", &MatchedFilterChoice::block_cost)
        .def_readonly("factorised_cost", &MatchedFilterChoice::factorised_cost)
        .def_readonly("exact_share", &MatchedFilterChoice::exact_share)
        .def_readonly("block_share", &MatchedFilterChoice::block_share);
    bind_choose<float, Doubles>(m, "choose_matched_filter_float32");
    bind_choose<double, Doubles>(m, "choose_matched_filter_float64");
    bind_choose<float, VoxelGrid>(m, "choose_matched_filter_float32");
    bind_choose<double, VoxelGrid>(m, "choose_matched_filter_float64");
    bind_plan<float>(m, "MatchedFilterPlanFloat");
    bind_plan<double>(m, "MatchedFilterPlanDouble");
    bind_bwd_positions<float, Doubles>(m);
    bind_bwd_positions<double, Doubles>(m);
    bind_bwd_positions<float, VoxelGrid>(m);
    bind_bwd_positions<double, VoxelGrid>(m);
    bind_point_images<float>(m);
    bind_point_images<double>(m);
}

} // namespace geraf2::bindings
