// SPDX-License-Identifier: Apache-2.0
// Signal tracer, forward and forward + backward, beside the naive loop, in one run. Points lie
// anywhere in a cube of 0.2 m, the inside of a box.
#include "geraf2/signal_tracer.hpp"

#include <benchmark/benchmark.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <random>
#include <vector>

#include "geraf2/simd.hpp"
#include "signal_tracer_naive.hpp"

namespace {

using geraf2::index_t;

// Kinds of amplitude, to be or-ed.
constexpr unsigned shared = 0;
constexpr unsigned per_antenna = 1; // else the same for all antennas
constexpr unsigned specular = 2;    // times the specular factor

template <class T>
struct Case {
    geraf2::Waveform waveform{77.3704e9, 70.15e12, 1.25e6, 64, 0.15};
    std::vector<double> tx, rx, points;
    std::vector<T> normals, amplitude;
    std::vector<std::complex<T>> signal_grad;
    bool own_amplitudes, has_normals;

    Case(index_t n_antennas, index_t n_points, unsigned kind)
        : own_amplitudes((kind & per_antenna) != 0), has_normals((kind & specular) != 0) {
        std::mt19937_64 random(7);
        std::uniform_real_distribution<double> uniform(-1.0, 1.0);
        std::normal_distribution<double> normal;
        for (index_t i = 0; i < n_antennas; ++i) {
            const double y = 0.07 * uniform(random);
            const double z = 0.12 * uniform(random);
            tx.insert(tx.end(), {-0.36, y, z});
            rx.insert(rx.end(), {-0.36, y + 0.005, z});
        }
        for (index_t i = 0; i < 3 * n_points; ++i) {
            points.push_back(0.1 * uniform(random));
        }
        for (index_t i = 0; i < n_points && has_normals; ++i) {
            const double y = 0.3 * uniform(random);
            const double z = 0.3 * uniform(random);
            const double x = -std::sqrt(1.0 - y * y - z * z);
            normals.insert(normals.end(),
                           {static_cast<T>(x), static_cast<T>(y), static_cast<T>(z)});
        }
        for (index_t i = 0; i < n_points * (own_amplitudes ? n_antennas : 1); ++i) {
            amplitude.push_back(static_cast<T>(normal(random)));
        }
        for (index_t i = 0; i < n_antennas * waveform.n_samples; ++i) {
            signal_grad.emplace_back(static_cast<T>(normal(random)),
                                     static_cast<T>(normal(random)));
        }
    }

    [[nodiscard]] index_t n_antennas() const { return static_cast<index_t>(tx.size() / 3); }
    [[nodiscard]] index_t n_points() const { return static_cast<index_t>(points.size() / 3); }
    [[nodiscard]] geraf2::Reflectors<T> reflectors() const {
        return {points, normals, amplitude, own_amplitudes ? n_antennas() : 1, 1};
    }
};

double unit_and_length(const double* x, const double* antenna, double* unit) {
    double square = 0.0;
    for (int axis = 0; axis < 3; ++axis) {
        unit[axis] = x[axis] - antenna[axis];
        square += unit[axis] * unit[axis];
    }
    for (int axis = 0; axis < 3; ++axis) {
        unit[axis] /= std::sqrt(square);
    }
    return std::sqrt(square);
}

/// One antenna's signal in double precision with the library's sine and cosine.
template <class T>
std::vector<std::complex<double>> direct_sum(const Case<T>& c, index_t antenna) {
    std::vector<std::complex<double>> out(static_cast<std::size_t>(c.waveform.n_samples));
    const auto at = static_cast<std::size_t>(antenna);
    const auto n = static_cast<std::size_t>(c.n_points());
    for (std::size_t point = 0; point < n; ++point) {
        double a[3];
        double b[3];
        const double path = unit_and_length(c.points.data() + 3 * point, c.tx.data() + 3 * at, a) +
                            unit_and_length(c.points.data() + 3 * point, c.rx.data() + 3 * at, b) +
                            c.waveform.path_bias_m;
        double amplitude =
            static_cast<double>(c.amplitude[c.own_amplitudes ? at * n + point : point]);
        if (c.has_normals) {
            double na = 0.0;
            double nb = 0.0;
            double ab = 0.0;
            for (std::size_t axis = 0; axis < 3; ++axis) {
                const auto normal = static_cast<double>(c.normals[3 * point + axis]);
                na += normal * a[axis];
                nb += normal * b[axis];
                ab += a[axis] * b[axis];
            }
            amplitude *= std::max(0.0, 2.0 * na * nb - ab);
        }
        for (index_t t = 0; t < c.waveform.n_samples; ++t) {
            const double phase = -2.0 * 3.14159265358979323846 * c.waveform.frequency_hz(t) * path /
                                 geraf2::speed_of_light;
            out[static_cast<std::size_t>(t)] += std::polar(1.0, phase) * amplitude;
        }
    }
    return out;
}

/// Error of a signal, relative to its norm, on four antennas.
template <class T>
double error_of(const Case<T>& c, const std::vector<std::complex<T>>& signal) {
    double difference = 0.0;
    double norm = 0.0;
    const index_t n_samples = c.waveform.n_samples;
    for (index_t i = 0; i < c.n_antennas(); i += std::max<index_t>(1, c.n_antennas() / 4)) {
        const auto want = direct_sum(c, i);
        for (index_t t = 0; t < n_samples; ++t) {
            const std::complex<double> w = want[static_cast<std::size_t>(t)];
            const std::complex<double> s{signal[static_cast<std::size_t>(i * n_samples + t)]};
            difference += std::norm(s - w);
            norm += std::norm(w);
        }
    }
    return std::sqrt(difference / norm);
}

template <class T>
void report(benchmark::State& state, const Case<T>& c) {
    const index_t pairs = c.n_antennas() * c.n_points();
    state.SetItemsProcessed(state.iterations() * pairs);
    state.counters["per_pair"] = benchmark::Counter(static_cast<double>(pairs),
                                                    benchmark::Counter::kIsIterationInvariantRate |
                                                        benchmark::Counter::kInvert);
    state.SetLabel(geraf2::simd_level_name(geraf2::simd_level()));
}

template <class T, unsigned Kind>
void BM_SignalTracer(benchmark::State& state) {
    const Case<T> c(state.range(0), state.range(1), Kind);
    std::vector<std::complex<T>> signal(c.signal_grad.size());
    const geraf2::SignalTracerOptions options{1e-3, static_cast<int>(state.range(2))};
    for (auto _ : state) {
        geraf2::signal_tracer_fwd<T>(c.reflectors(), {c.tx, c.rx}, c.waveform, options, signal);
        benchmark::ClobberMemory();
    }
    report(state, c);
    state.counters["rel_error"] = error_of(c, signal);
}

/// Gradients to amplitude and, where there are any, to normals.
template <class T, unsigned Kind>
void BM_SignalTracerForwardBackward(benchmark::State& state) {
    const Case<T> c(state.range(0), state.range(1), Kind);
    std::vector<std::complex<T>> signal(c.signal_grad.size());
    std::vector<T> amplitude_grad(c.amplitude.size());
    std::vector<double> normals_grad(c.normals.size());
    const geraf2::SignalTracerOptions options{1e-3, static_cast<int>(state.range(2))};
    for (auto _ : state) {
        geraf2::signal_tracer_fwd<T>(c.reflectors(), {c.tx, c.rx}, c.waveform, options, signal);
        geraf2::signal_tracer_bwd<T>(c.signal_grad, c.reflectors(), {c.tx, c.rx}, c.waveform,
                                     options, {amplitude_grad, normals_grad, {}, {}, {}});
        benchmark::ClobberMemory();
    }
    report(state, c);
}

template <bool Backward>
void BM_SignalTracerNaive(benchmark::State& state) {
    const Case<float> c(state.range(0), state.range(1), shared);
    const std::vector<float> tx(c.tx.begin(), c.tx.end());
    const std::vector<float> rx(c.rx.begin(), c.rx.end());
    const std::vector<float> points(c.points.begin(), c.points.end());
    std::vector<std::complex<float>> signal(c.signal_grad.size());
    std::vector<float> amplitude_grad(c.amplitude.size());
    for (auto _ : state) {
        geraf2::bench::signal_tracer_naive(c.amplitude, tx, rx, points, c.waveform, signal);
        if constexpr (Backward) {
            geraf2::bench::signal_tracer_naive_bwd(c.signal_grad, tx, rx, points, c.waveform,
                                                   amplitude_grad);
        }
        benchmark::ClobberMemory();
    }
    report(state, c);
    state.counters["rel_error"] = error_of(c, signal);
    state.SetLabel("plain loops");
}

void size(benchmark::internal::Benchmark* b, int antennas, int points, int threads = 1) {
    b->ArgNames({"antennas", "points", "threads"})->Unit(benchmark::kMillisecond);
    b->Args({antennas, points, threads});
}

void full(benchmark::internal::Benchmark* b) { size(b, 512, 25000); }

// The naive loop's time is proportional to the pairs: fewer of them will do.
void few(benchmark::internal::Benchmark* b) { size(b, 16, 4000); }

BENCHMARK(BM_SignalTracerNaive<false>)->Apply(few);
BENCHMARK(BM_SignalTracerNaive<true>)->Apply(few);
BENCHMARK(BM_SignalTracer<float, shared>)->Apply(full);
BENCHMARK(BM_SignalTracer<float, per_antenna>)->Apply(full);
BENCHMARK(BM_SignalTracer<float, specular>)->Apply(full);
BENCHMARK(BM_SignalTracer<float, per_antenna | specular>)->Apply(full);
BENCHMARK(BM_SignalTracer<double, shared>)->Apply(full);
BENCHMARK(BM_SignalTracerForwardBackward<float, shared>)->Apply(full);
BENCHMARK(BM_SignalTracerForwardBackward<float, per_antenna>)->Apply(full);
BENCHMARK(BM_SignalTracerForwardBackward<float, specular>)->Apply(full);
BENCHMARK(BM_SignalTracerForwardBackward<float, per_antenna | specular>)->Apply(full);

/// Two threads against one: compare real times on an idle machine.
void thread_counts(benchmark::internal::Benchmark* b) {
    b->ArgNames({"antennas", "points", "threads"})->Unit(benchmark::kMillisecond);
    b->ArgsProduct({{512}, {25000}, {1, 2}})->UseRealTime();
}

BENCHMARK(BM_SignalTracer<float, shared>)->Apply(thread_counts);
BENCHMARK(BM_SignalTracer<float, specular>)->Apply(thread_counts);
BENCHMARK(BM_SignalTracerForwardBackward<float, shared>)->Apply(thread_counts);
BENCHMARK(BM_SignalTracerForwardBackward<float, specular>)->Apply(thread_counts);

} // namespace
