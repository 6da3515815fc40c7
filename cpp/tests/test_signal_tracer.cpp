// SPDX-License-Identifier: Apache-2.0
// Signal tracer in both precisions: against the plain double sum, and its gradients against the
// slopes of that sum.
#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <random>
#include <vector>

#include "geraf2/signal_tracer.hpp"

using namespace geraf2;

namespace {

template <class T>
struct Case {
    Waveform waveform{77.3704e9, 70.15e12, 1.25e6, 16, 0.15};
    std::vector<double> tx, rx, points;
    std::vector<T> normals, amplitude;
    index_t rows;

    Case(index_t n_antennas, index_t n_points, double spread, bool per_antenna)
        : rows(per_antenna ? n_antennas : 1) {
        std::mt19937_64 random(3);
        std::uniform_real_distribution<double> uniform(-1.0, 1.0);
        for (index_t i = 0; i < n_antennas; ++i) {
            tx.insert(tx.end(), {-0.36, 0.07 * uniform(random), 0.1 * uniform(random)});
            rx.insert(rx.end(), {-0.35, 0.07 * uniform(random), 0.1 * uniform(random)});
        }
        for (index_t i = 0; i < n_points; ++i) {
            for (int axis = 0; axis < 3; ++axis) {
                points.push_back(spread * uniform(random));
                normals.push_back(static_cast<T>(uniform(random) - (axis == 0 ? 1.0 : 0.0)));
            }
        }
        for (index_t i = 0; i < 2 * rows * n_points; ++i) {
            amplitude.push_back(static_cast<T>(uniform(random)));
        }
    }

    [[nodiscard]] std::size_t n_antennas() const { return tx.size() / 3; }
    [[nodiscard]] std::size_t n_points() const { return points.size() / 3; }
    [[nodiscard]] AntennaPositions antennas() const { return {tx, rx}; }
    [[nodiscard]] Reflectors<T> reflectors() const { return {points, normals, amplitude, rows, 2}; }
};

std::array<double, 3> direction(const double* to, const double* from, double& length) {
    std::array<double, 3> v{to[0] - from[0], to[1] - from[1], to[2] - from[2]};
    length = std::hypot(v[0], v[1], v[2]);
    for (double& part : v) {
        part /= length;
    }
    return v;
}

template <class T>
std::vector<std::complex<double>> direct_sum(const Case<T>& c) {
    const auto n_samples = static_cast<std::size_t>(c.waveform.n_samples);
    std::vector<std::complex<double>> out(c.n_antennas() * n_samples);
    for (std::size_t i = 0; i < c.n_antennas(); ++i) {
        for (std::size_t p = 0; p < c.n_points(); ++p) {
            double from_tx = 0.0;
            double from_rx = 0.0;
            const double* x = c.points.data() + 3 * p;
            const auto a = direction(x, c.tx.data() + 3 * i, from_tx);
            const auto b = direction(x, c.rx.data() + 3 * i, from_rx);
            double along_a = 0.0;
            double cosine = 0.0;
            for (std::size_t k = 0; k < 3; ++k) {
                along_a += static_cast<double>(c.normals[3 * p + k]) * a[k];
            }
            for (std::size_t k = 0; k < 3; ++k) {
                const double outgoing =
                    a[k] - 2.0 * along_a * static_cast<double>(c.normals[3 * p + k]);
                cosine -= outgoing * b[k]; // w_r = -b points at the receiver
            }
            const std::size_t at = 2 * ((c.rows == 1 ? 0 : i) * c.n_points() + p);
            const std::complex<double> amplitude(static_cast<double>(c.amplitude[at]),
                                                 static_cast<double>(c.amplitude[at + 1]));
            const double path = from_tx + from_rx + c.waveform.path_bias_m;
            for (std::size_t t = 0; t < n_samples; ++t) {
                const double phase = phase_sign * 2.0 * 3.14159265358979323846 *
                                     c.waveform.frequency_hz(static_cast<index_t>(t)) * path /
                                     speed_of_light;
                out[i * n_samples + t] +=
                    amplitude * std::max(cosine, 0.0) * std::polar(1.0, phase);
            }
        }
    }
    return out;
}

template <class T>
std::vector<std::complex<T>> traced(const Case<T>& c, const SignalTracerOptions& options) {
    std::vector<std::complex<T>> out(c.n_antennas() *
                                     static_cast<std::size_t>(c.waveform.n_samples));
    signal_tracer_fwd<T>(c.reflectors(), c.antennas(), c.waveform, options, out);
    return out;
}

template <class T>
std::vector<std::complex<T>> noise(std::size_t n) {
    std::mt19937_64 random(4);
    std::normal_distribution<double> normal;
    std::vector<std::complex<T>> out;
    for (std::size_t i = 0; i < n; ++i) {
        out.emplace_back(static_cast<T>(normal(random)), static_cast<T>(normal(random)));
    }
    return out;
}

} // namespace

TEST_CASE_TEMPLATE("signal is the direct sum", T, float, double) {
    for (const double spread : {0.015, 0.3}) { // blocks, then points far apart
        for (const bool per_antenna : {false, true}) {
            const Case<T> c(21, 90, spread, per_antenna);
            const auto got = traced(c, {1e-3, 2});
            const auto want = direct_sum(c);
            double difference = 0.0;
            double norm = 0.0;
            for (std::size_t i = 0; i < want.size(); ++i) {
                difference += std::norm(std::complex<double>(got[i]) - want[i]);
                norm += std::norm(want[i]);
            }
            CHECK(std::sqrt(difference / norm) < 5e-4);
        }
    }
}

TEST_CASE_TEMPLATE("signal does not depend on the number of threads", T, float, double) {
    const Case<T> c(70, 300, 0.02, true);
    const auto want = traced(c, {1e-3, 1});
    CHECK(traced(c, {1e-3, 2}) == want);
    CHECK(traced(c, {1e-3, 3}) == want);
}

TEST_CASE("gradients are the slopes of the direct sum") {
    for (const double spread : {0.0005, 0.3}) {
        const Case<double> c(5, 8, spread, true);
        const auto g = noise<double>(5 * 16);
        std::vector<double> amplitude(c.amplitude.size());
        std::vector<double> normals(c.normals.size());
        std::vector<double> points(c.points.size());
        std::vector<double> tx(c.tx.size());
        std::vector<double> rx(c.rx.size());
        signal_tracer_bwd<double>(g, c.reflectors(), c.antennas(), c.waveform, {1e-11, 1},
                                  {amplitude, normals, points, tx, rx});
        const auto check = [&](std::vector<double> Case<double>::* which,
                               const std::vector<double>& found, std::size_t at) {
            double side[2];
            for (const int sign : {0, 1}) {
                Case<double> moved = c;
                (moved.*which)[at] += sign == 0 ? -1e-7 : 1e-7;
                const auto signal = direct_sum(moved);
                side[sign] = 0.0;
                for (std::size_t i = 0; i < g.size(); ++i) {
                    side[sign] += (std::conj(g[i]) * signal[i]).real();
                }
            }
            CHECK(found[at] == doctest::Approx((side[1] - side[0]) / 2e-7).epsilon(1e-5));
        };
        for (const std::size_t at : {0U, 4U, 11U}) {
            check(&Case<double>::amplitude, amplitude, at);
            check(&Case<double>::normals, normals, at);
            check(&Case<double>::points, points, at);
            check(&Case<double>::tx, tx, at);
            check(&Case<double>::rx, rx, at);
        }
    }
}

TEST_CASE_TEMPLATE("no points give silence", T, float, double) {
    const Case<T> c(3, 0, 0.1, false);
    for (const auto& sample : traced(c, {1e-3, 2})) {
        CHECK(sample == std::complex<T>{});
    }
}
