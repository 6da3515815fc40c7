// SPDX-License-Identifier: Apache-2.0
#include <complex>
#include <utility>

#include "arrays.hpp"
#include "geraf2/subaperture.hpp"

namespace geraf2::bindings {

namespace {

/// Owner of the arrays that SubapertureMembers refers to.
struct Members {
    Indices offsets, antennas;
    Doubles weights, positions, focus, focus_range_m;

    Members(Indices offsets_in, Indices antennas_in, Doubles weights_in, Doubles positions_in,
            Doubles focus_in, Doubles focus_range_in)
        : offsets(std::move(offsets_in)), antennas(std::move(antennas_in)),
          weights(std::move(weights_in)), positions(std::move(positions_in)),
          focus(std::move(focus_in)), focus_range_m(std::move(focus_range_in)) {
        const py::ssize_t n_subapertures = focus_range_m.size();
        require_shape("offsets", offsets, {n_subapertures + 1});
        require_shape("weights", weights, {antennas.size()});
        require_shape("positions", positions, {antennas.size(), 2});
        require_shape("focus", focus, {n_subapertures, 3});
    }

    [[nodiscard]] SubapertureMembers view_all() const {
        return {view(offsets),   view(antennas), view(weights),
                view(positions), view(focus),    view(focus_range_m)};
    }
};

py::tuple as_tuple(const SubaperturePeaks& peaks) {
    const auto n = static_cast<py::ssize_t>(peaks.ranges_m.size());
    return py::make_tuple(copy_array(peaks.subapertures, {n}), copy_array(peaks.cosines, {n, 2}),
                          copy_array(peaks.ranges_m, {n}), copy_array(peaks.magnitudes, {n}),
                          copy_array(peaks.noise, {n}), copy_array(peaks.tops));
}

void require_antennas(py::ssize_t n_antennas, const Doubles& tx, const Doubles& rx) {
    require_shape("tx", tx, {n_antennas, 3});
    require_shape("rx", rx, {n_antennas, 3});
}

template <class T>
void bind_functions(py::module_& m) {
    m.def(
        "subaperture_images",
        [](const Array<std::complex<T>>& signal, const Doubles& tx, const Doubles& rx,
           const Waveform& waveform, const Members& members, const SubapertureLattice& lattice,
           const SubapertureBins& bins, int num_threads) {
            require_shape("signal", signal, {-1, waveform.n_samples});
            require_antennas(signal.shape(0), tx, rx);
            const SubapertureMembers viewed = members.view_all();
            auto magnitudes = make_array<T>({viewed.n_subapertures(), bins.horizontal.count,
                                             bins.vertical.count, bins.ranges.count});
            const auto out = mutable_view(magnitudes);
            {
                const py::gil_scoped_release nogil;
                subaperture_images<T>(view(signal), view(tx), view(rx), waveform, viewed, lattice,
                                      bins, num_threads, out);
            }
            return magnitudes;
        },
        py::arg("signal").noconvert(), py::arg("tx").noconvert(), py::arg("rx").noconvert(),
        py::arg("waveform"), py::arg("members"), py::arg("lattice"), py::arg("bins"),
        py::arg("num_threads"));
    m.def(
        "subaperture_peaks",
        [](const Array<std::complex<T>>& signal, const Doubles& tx, const Doubles& rx,
           const Waveform& waveform, const Members& members, const SubapertureLattice& lattice,
           const SubapertureBins& bins, const PeakThresholds& thresholds, int num_threads) {
            require_shape("signal", signal, {-1, waveform.n_samples});
            require_antennas(signal.shape(0), tx, rx);
            const SubapertureMembers viewed = members.view_all();
            SubaperturePeaks peaks;
            {
                const py::gil_scoped_release nogil;
                peaks = subaperture_peaks<T>(view(signal), view(tx), view(rx), waveform, viewed,
                                             lattice, bins, thresholds, num_threads);
            }
            return as_tuple(peaks);
        },
        py::arg("signal").noconvert(), py::arg("tx").noconvert(), py::arg("rx").noconvert(),
        py::arg("waveform"), py::arg("members"), py::arg("lattice"), py::arg("bins"),
        py::arg("thresholds"), py::arg("num_threads"));
    m.def(
        "image_peaks",
        [](const Array<T>& magnitudes, const SubapertureBins& bins,
           const PeakThresholds& thresholds) {
            require_shape("magnitudes", magnitudes,
                          {bins.horizontal.count, bins.vertical.count, bins.ranges.count});
            return as_tuple(image_peaks<T>(view(magnitudes), bins, thresholds));
        },
        py::arg("magnitudes").noconvert(), py::arg("bins"), py::arg("thresholds"));
    m.def(
        "noise_floor",
        [](const Array<T>& magnitudes, const SubapertureBins& bins) {
            require_shape("magnitudes", magnitudes,
                          {bins.horizontal.count, bins.vertical.count, bins.ranges.count});
            auto floor = make_array<double>({bins.ranges.count});
            noise_floor<T>(view(magnitudes), bins, mutable_view(floor));
            return floor;
        },
        py::arg("magnitudes").noconvert(), py::arg("bins"));
}

} // namespace

void bind_subaperture(py::module_& m) {
    py::class_<CosineAxis>(m, "CosineAxis")
        .def(py::init<index_t, double, double, bool>(), py::arg("count"), py::arg("first"),
             py::arg("pitch"), py::arg("wraps"));
    py::class_<RangeAxis>(m, "RangeAxis")
        .def(py::init<index_t, double, double>(), py::arg("count"), py::arg("first_m"),
             py::arg("pitch_m"));
    py::class_<SubapertureBins>(m, "SubapertureBins")
        .def(py::init<CosineAxis, CosineAxis, RangeAxis>(), py::arg("horizontal"),
             py::arg("vertical"), py::arg("ranges"));
    py::class_<SubapertureLattice>(m, "SubapertureLattice")
        .def(py::init<index_t, index_t, double, double, int, double>(), py::arg("n_horizontal"),
             py::arg("n_vertical"), py::arg("horizontal_spacing_m"), py::arg("vertical_spacing_m"),
             py::arg("spread_width"), py::arg("spread_exponent"));
    py::class_<PeakThresholds>(m, "PeakThresholds")
        .def(py::init<double, double>(), py::arg("dynamic_range"), py::arg("noise_margin"));
    py::class_<Members>(m, "SubapertureMembers")
        .def(py::init<Indices, Indices, Doubles, Doubles, Doubles, Doubles>(),
             py::arg("offsets").noconvert(), py::arg("antennas").noconvert(),
             py::arg("weights").noconvert(), py::arg("positions").noconvert(),
             py::arg("focus").noconvert(), py::arg("focus_range_m").noconvert());
    bind_functions<float>(m);
    bind_functions<double>(m);
}

} // namespace geraf2::bindings
