// SPDX-License-Identifier: Apache-2.0
#include <pybind11/complex.h>

#include <complex>

#include "antennas.hpp"
#include "arrays.hpp"
#include "geraf2/signal_tracer.hpp"

namespace geraf2::bindings {

namespace {

/// amplitude: (1 or n_antennas, n_points, 1 or 2); normals: (n_points, 3) or (0, 3).
template <class T>
Reflectors<T> reflectors_of(const Array<T>& amplitude, const Doubles& points,
                            const Array<T>& normals, py::ssize_t n_antennas) {
    require_shape("points", points, {-1, 3});
    require_shape("amplitude", amplitude, {-1, points.shape(0), -1});
    require_shape("normals", normals, {-1, 3});
    const bool rows = amplitude.shape(0) == 1 || amplitude.shape(0) == n_antennas;
    const bool parts = amplitude.shape(2) == 1 || amplitude.shape(2) == 2;
    if (!rows || !parts) {
        throw py::value_error("amplitude has the wrong shape");
    }
    if (normals.shape(0) != 0 && normals.shape(0) != points.shape(0)) {
        throw py::value_error("normals has the wrong shape");
    }
    return {view(points), view(normals), view(amplitude), amplitude.shape(0), amplitude.shape(2)};
}

template <class T>
void bind_fwd(py::module_& m) {
    m.def(
        "signal_tracer_fwd",
        [](const Array<T>& amplitude, const Doubles& points, const Array<T>& normals,
           const Doubles& tx, const Doubles& rx, const Waveform& waveform, double rtol,
           int num_threads) {
            const AntennaPositions antennas = antennas_of(tx, rx);
            const Reflectors<T> reflectors = reflectors_of(amplitude, points, normals, tx.shape(0));
            auto signal = make_array<std::complex<T>>(
                {tx.shape(0), static_cast<py::ssize_t>(waveform.n_samples)});
            const auto out = mutable_view(signal);
            {
                const py::gil_scoped_release nogil;
                signal_tracer_fwd<T>(reflectors, antennas, waveform, {rtol, num_threads}, out);
            }
            return signal;
        },
        py::arg("amplitude").noconvert(), py::arg("points").noconvert(),
        py::arg("normals").noconvert(), py::arg("tx").noconvert(), py::arg("rx").noconvert(),
        py::arg("waveform"), py::arg("rtol"), py::arg("num_threads"));
}

/// Flags select the gradients; the others are returned empty.
template <class T>
void bind_bwd(py::module_& m) {
    m.def(
        "signal_tracer_bwd",
        [](const Array<std::complex<T>>& signal_grad, const Array<T>& amplitude,
           const Doubles& points, const Array<T>& normals, const Doubles& tx, const Doubles& rx,
           const Waveform& waveform, double rtol, int num_threads, bool want_amplitude,
           bool want_normals, bool want_points, bool want_antennas) {
            const AntennaPositions antennas = antennas_of(tx, rx);
            const Reflectors<T> reflectors = reflectors_of(amplitude, points, normals, tx.shape(0));
            require_shape("signal_grad", signal_grad, {tx.shape(0), waveform.n_samples});
            auto amplitude_grad = make_array<T>(
                {want_amplitude ? amplitude.shape(0) : 0, amplitude.shape(1), amplitude.shape(2)});
            auto normals_grad = make_array<double>({want_normals ? normals.shape(0) : 0, 3});
            auto points_grad = make_array<double>({want_points ? points.shape(0) : 0, 3});
            auto tx_grad = make_array<double>({want_antennas ? tx.shape(0) : 0, 3});
            auto rx_grad = make_array<double>({want_antennas ? rx.shape(0) : 0, 3});
            const SignalTracerGradients<T> gradients{
                mutable_view(amplitude_grad), mutable_view(normals_grad), mutable_view(points_grad),
                mutable_view(tx_grad), mutable_view(rx_grad)};
            {
                const py::gil_scoped_release nogil;
                signal_tracer_bwd<T>(view(signal_grad), reflectors, antennas, waveform,
                                     {rtol, num_threads}, gradients);
            }
            return py::make_tuple(amplitude_grad, normals_grad, points_grad, tx_grad, rx_grad);
        },
        py::arg("signal_grad").noconvert(), py::arg("amplitude").noconvert(),
        py::arg("points").noconvert(), py::arg("normals").noconvert(), py::arg("tx").noconvert(),
        py::arg("rx").noconvert(), py::arg("waveform"), py::arg("rtol"), py::arg("num_threads"),
        py::arg("want_amplitude"), py::arg("want_normals"), py::arg("want_points"),
        py::arg("want_antennas"));
}

} // namespace

void bind_signal_tracer(py::module_& m) {
    bind_fwd<float>(m);
    bind_fwd<double>(m);
    bind_bwd<float>(m);
    bind_bwd<double>(m);
}

} // namespace geraf2::bindings
