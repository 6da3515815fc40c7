// SPDX-License-Identifier: Apache-2.0
#include <pybind11/complex.h>

#include <algorithm>
#include <complex>

#include "antennas.hpp"
#include "arrays.hpp"
#include "geraf2/lensless.hpp"
#include "geraf2/signal_tracer.hpp"

namespace geraf2::bindings {

namespace {

template <class T>
VolumeSamples<T> samples_of(const Array<T>& alpha, const Array<T>& transmittance,
                            const Array<T>& gradient, const Doubles& points) {
    require_shape("alpha", alpha, {-1});
    require_shape("transmittance", transmittance, {alpha.shape(0)});
    require_shape("gradient", gradient, {alpha.shape(0), 3});
    require_shape("points", points, {alpha.shape(0), 3});
    return {view(alpha), view(transmittance), view(gradient), view(points)};
}

EchoForm form_of(const Doubles& centers, const Doubles& references, double lobe_power,
                 int two_way_power) {
    require_shape("centers", centers, {-1, 3});
    require_shape("references", references, {references.shape(0) == 0 ? 0 : centers.shape(0)});
    return {view(centers), view(references), lobe_power, two_way_power};
}

/// Offsets of parts into something of `size`.
void require_offsets(const char* name, const Indices& offsets, py::ssize_t size) {
    require_shape(name, offsets, {-1});
    const auto values = view(offsets);
    if (values.empty() || values.front() != 0 || values.back() != size ||
        !std::is_sorted(values.begin(), values.end())) {
        throw py::value_error(std::string(name) + " must rise from 0 to the number of entries");
    }
}

/// Indices below `size`.
void require_indices(const char* name, const Indices& indices, py::ssize_t size) {
    require_shape(name, indices, {-1});
    for (const index_t index : view(indices)) {
        if (index < 0 || index >= size) {
            throw py::value_error(std::string(name) + " must be indices");
        }
    }
}

PairsView pairs_of(const Indices& sample, const Indices& offsets, index_t n_looks,
                   py::ssize_t n_samples, const EchoForm& form) {
    require_indices("sample", sample, n_samples);
    require_offsets("offsets", offsets, sample.shape(0));
    if (3 * (offsets.shape(0) - 1) != static_cast<py::ssize_t>(form.centers.size()) * n_looks) {
        throw py::value_error("offsets must have a part for each group and look");
    }
    return {view(sample), view(offsets), n_looks};
}

template <class T>
void bind_intervals(py::module_& m, const char* name) {
    m.def(
        name,
        [](const Doubles& origins, const Doubles& direction, const Doubles& near,
           const Doubles& far, const Doubles& jitter, int num_threads) {
            require_shape("near", near, {-1});
            const py::ssize_t n_rays = near.shape(0);
            require_shape("origins", origins, {n_rays, 3});
            require_shape("direction", direction, {3});
            require_shape("far", far, {n_rays});
            require_shape("jitter", jitter, {n_rays, -1});
            const py::ssize_t n = jitter.shape(1) - 1;
            auto starts = make_array<T>({n_rays, 3});
            auto points = make_array<T>({n_rays, n, 3});
            auto step = make_array<T>({n_rays, n});
            auto offset = make_array<T>({n_rays});
            const RayIntervals<T> out{mutable_view(starts), mutable_view(points),
                                      mutable_view(step), mutable_view(offset)};
            {
                const py::gil_scoped_release nogil;
                const double* along = direction.data();
                ray_intervals<T>(view(origins), {along[0], along[1], along[2]}, view(near),
                                 view(far), view(jitter), num_threads, out);
            }
            return py::make_tuple(starts, points, step, offset);
        },
        py::arg("origins").noconvert(), py::arg("direction").noconvert(),
        py::arg("near").noconvert(), py::arg("far").noconvert(), py::arg("jitter").noconvert(),
        py::arg("num_threads"));
}

template <class T>
void bind_length_defect(py::module_& m) {
    m.def(
        "length_defect",
        [](const Array<T>& gradients, int num_threads) {
            require_shape("gradients", gradients, {-1, 3});
            auto slope = make_array<T>({gradients.shape(0), 3});
            const auto out = mutable_view(slope);
            double mean = 0.0;
            {
                const py::gil_scoped_release nogil;
                mean = length_defect<T>(view(gradients), num_threads, out);
            }
            return py::make_tuple(mean, slope);
        },
        py::arg("gradients").noconvert(), py::arg("num_threads"));
}

template <class T>
void bind_amplitudes(py::module_& m) {
    m.def(
        "facing_samples",
        [](const Array<T>& alpha, const Array<T>& gradient, const Doubles& points,
           const Doubles& centers, bool has_lobe, index_t samples_per_ray, index_t n_looks,
           int num_threads) {
            const VolumeSamples<T> samples = samples_of(alpha, alpha, gradient, points);
            const EchoForm form =
                form_of(centers, make_array<double>({0}), has_lobe ? 2.0 : 1.0, 1);
            SamplePairs found;
            {
                const py::gil_scoped_release nogil;
                found = facing_samples<T>(samples, form, samples_per_ray, n_looks, num_threads);
            }
            return py::make_tuple(copy_array(found.sample), copy_array(found.offsets));
        },
        py::arg("alpha").noconvert(), py::arg("gradient").noconvert(),
        py::arg("points").noconvert(), py::arg("centers").noconvert(), py::arg("has_lobe"),
        py::arg("samples_per_ray"), py::arg("n_looks"), py::arg("num_threads"));
    m.def(
        "echo_amplitudes_fwd",
        [](const Array<T>& alpha, const Array<T>& transmittance, const Array<T>& gradient,
           const Doubles& points, const Indices& sample, const Indices& offsets, index_t n_looks,
           const Array<T>& shift, const Doubles& centers, const Doubles& references,
           double lobe_power, int two_way_power, int num_threads) {
            const VolumeSamples<T> samples = samples_of(alpha, transmittance, gradient, points);
            const EchoForm form = form_of(centers, references, lobe_power, two_way_power);
            const PairsView pairs = pairs_of(sample, offsets, n_looks, alpha.shape(0), form);
            require_shape("shift", shift, {sample.shape(0)});
            auto amplitude = make_array<T>({sample.shape(0)});
            auto factor = make_array<T>({sample.shape(0)});
            auto normals = make_array<T>({sample.shape(0), 3});
            const auto to_amplitude = mutable_view(amplitude);
            const auto to_factor = mutable_view(factor);
            const auto to_normals = mutable_view(normals);
            {
                const py::gil_scoped_release nogil;
                echo_amplitudes_fwd<T>(samples, pairs, view(shift), form, num_threads, to_amplitude,
                                       to_factor, to_normals);
            }
            return py::make_tuple(amplitude, factor, normals);
        },
        py::arg("alpha").noconvert(), py::arg("transmittance").noconvert(),
        py::arg("gradient").noconvert(), py::arg("points").noconvert(),
        py::arg("sample").noconvert(), py::arg("offsets").noconvert(), py::arg("n_looks"),
        py::arg("shift").noconvert(), py::arg("centers").noconvert(),
        py::arg("references").noconvert(), py::arg("lobe_power"), py::arg("two_way_power"),
        py::arg("num_threads"));
    m.def(
        "echo_amplitudes_bwd",
        [](const Array<T>& alpha, const Array<T>& transmittance, const Array<T>& gradient,
           const Doubles& points, const Indices& sample, const Indices& offsets, index_t n_looks,
           const Array<T>& shift, const Doubles& centers, const Doubles& references,
           double lobe_power, int two_way_power, const Array<T>& factor,
           const Array<T>& amplitude_grad, const Array<T>& normals_grad, bool want_gradient) {
            const VolumeSamples<T> samples = samples_of(alpha, transmittance, gradient, points);
            const EchoForm form = form_of(centers, references, lobe_power, two_way_power);
            const PairsView pairs = pairs_of(sample, offsets, n_looks, alpha.shape(0), form);
            for (const auto* array : {&shift, &factor, &amplitude_grad}) {
                require_shape("gradients and outputs", *array, {sample.shape(0)});
            }
            require_shape("normals_grad", normals_grad, {sample.shape(0), 3});
            auto alpha_grad = make_array<T>({alpha.shape(0)});
            auto transmittance_grad = make_array<T>({alpha.shape(0)});
            auto gradient_grad = make_array<T>({want_gradient ? alpha.shape(0) : 0, 3});
            const SampleGradients<T> out{mutable_view(alpha_grad), mutable_view(transmittance_grad),
                                         mutable_view(gradient_grad)};
            {
                const py::gil_scoped_release nogil;
                for (const auto to : {out.alpha, out.transmittance, out.gradient}) {
                    std::fill(to.begin(), to.end(), T{});
                }
                echo_amplitudes_bwd<T>(samples, pairs, view(shift), form, view(factor),
                                       view(amplitude_grad), view(normals_grad), out);
            }
            return py::make_tuple(alpha_grad, transmittance_grad, gradient_grad);
        },
        py::arg("alpha").noconvert(), py::arg("transmittance").noconvert(),
        py::arg("gradient").noconvert(), py::arg("points").noconvert(),
        py::arg("sample").noconvert(), py::arg("offsets").noconvert(), py::arg("n_looks"),
        py::arg("shift").noconvert(), py::arg("centers").noconvert(),
        py::arg("references").noconvert(), py::arg("lobe_power"), py::arg("two_way_power"),
        py::arg("factor").noconvert(), py::arg("amplitude_grad").noconvert(),
        py::arg("normals_grad").noconvert(), py::arg("want_gradient"));
}

template <class T>
Reflectors<T> reflectors_of(const Array<T>& amplitude, const Doubles& points,
                            const Array<T>& normals) {
    require_shape("amplitude", amplitude, {-1});
    require_shape("points", points, {amplitude.shape(0), 3});
    require_shape("normals", normals, {amplitude.shape(0), 3});
    return {view(points), view(normals), view(amplitude), 1, 1};
}

TracerParts parts_of(const Indices& offsets, const Indices& order, const Indices& groups,
                     py::ssize_t n_points, py::ssize_t n_antennas) {
    require_offsets("offsets", offsets, n_points);
    require_indices("order", order, n_antennas);
    require_shape("order", order, {n_antennas});
    require_offsets("groups", groups, n_antennas);
    const py::ssize_t n_groups = groups.shape(0) - 1;
    const py::ssize_t n_parts = offsets.shape(0) - 1;
    if (n_groups == 0 || n_parts == 0 || n_parts % n_groups != 0) {
        throw py::value_error("offsets must have a part for each group and look");
    }
    return {view(offsets), view(order), view(groups), n_parts / n_groups};
}

template <class T>
void bind_parts(py::module_& m) {
    m.def(
        "trace_parts_fwd",
        [](const Array<T>& amplitude, const Doubles& points, const Array<T>& normals,
           const Doubles& tx, const Doubles& rx, const Indices& offsets, const Indices& order,
           const Indices& groups, const Waveform& waveform, double rtol, int num_threads) {
            const AntennaPositions antennas = antennas_of(tx, rx);
            const Reflectors<T> reflectors = reflectors_of(amplitude, points, normals);
            const TracerParts parts =
                parts_of(offsets, order, groups, amplitude.shape(0), tx.shape(0));
            auto signal = make_array<std::complex<T>>(
                {parts.n_looks, tx.shape(0), static_cast<py::ssize_t>(waveform.n_samples)});
            const auto out = mutable_view(signal);
            {
                const py::gil_scoped_release nogil;
                trace_parts_fwd<T>(reflectors, antennas, parts, waveform, {rtol, num_threads}, out);
            }
            return signal;
        },
        py::arg("amplitude").noconvert(), py::arg("points").noconvert(),
        py::arg("normals").noconvert(), py::arg("tx").noconvert(), py::arg("rx").noconvert(),
        py::arg("offsets").noconvert(), py::arg("order").noconvert(), py::arg("groups").noconvert(),
        py::arg("waveform"), py::arg("rtol"), py::arg("num_threads"));
    m.def(
        "trace_parts_bwd",
        [](const Array<std::complex<T>>& signal_grad, const Array<T>& amplitude,
           const Doubles& points, const Array<T>& normals, const Doubles& tx, const Doubles& rx,
           const Indices& offsets, const Indices& order, const Indices& groups,
           const Waveform& waveform, double rtol, int num_threads, bool want_amplitude,
           bool want_normals) {
            const AntennaPositions antennas = antennas_of(tx, rx);
            const Reflectors<T> reflectors = reflectors_of(amplitude, points, normals);
            const TracerParts parts =
                parts_of(offsets, order, groups, amplitude.shape(0), tx.shape(0));
            require_shape("signal_grad", signal_grad,
                          {parts.n_looks, tx.shape(0), waveform.n_samples});
            auto amplitude_grad = make_array<T>({want_amplitude ? amplitude.shape(0) : 0});
            auto normals_grad = make_array<double>({want_normals ? amplitude.shape(0) : 0, 3});
            const auto to_amplitude = mutable_view(amplitude_grad);
            const auto to_normals = mutable_view(normals_grad);
            {
                const py::gil_scoped_release nogil;
                trace_parts_bwd<T>(view(signal_grad), reflectors, antennas, parts, waveform,
                                   {rtol, num_threads}, to_amplitude, to_normals);
            }
            return py::make_tuple(amplitude_grad, normals_grad);
        },
        py::arg("signal_grad").noconvert(), py::arg("amplitude").noconvert(),
        py::arg("points").noconvert(), py::arg("normals").noconvert(), py::arg("tx").noconvert(),
        py::arg("rx").noconvert(), py::arg("offsets").noconvert(), py::arg("order").noconvert(),
        py::arg("groups").noconvert(), py::arg("waveform"), py::arg("rtol"), py::arg("num_threads"),
        py::arg("want_amplitude"), py::arg("want_normals"));
}

} // namespace

void bind_lensless(py::module_& m) {
    bind_intervals<float>(m, "ray_intervals_float32");
    bind_intervals<double>(m, "ray_intervals_float64");
    bind_length_defect<float>(m);
    bind_length_defect<double>(m);
    bind_amplitudes<float>(m);
    bind_amplitudes<double>(m);
    bind_parts<float>(m);
    bind_parts<double>(m);
}

} // namespace geraf2::bindings
