// SPDX-License-Identifier: Apache-2.0
// Matched filter: both methods, forward and adjoint, beside the naive loop, in one run.
#include "geraf2/matched_filter.hpp"

#include <benchmark/benchmark.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <random>
#include <vector>

#include "geraf2/simd.hpp"
#include "matched_filter_naive.hpp"

namespace {

using geraf2::index_t;
using geraf2::MatchedFilterMethod;

/// White noise from bistatic antennas on a plane 0.36 m away, and a cube of voxels.
template <class T>
struct Case {
    geraf2::Waveform waveform;
    std::vector<double> tx, rx;
    std::vector<std::complex<T>> signal;
    geraf2::VoxelGrid grid;
    std::vector<double> points;

    Case(index_t n_antennas, index_t n_samples, index_t n_side, double spacing = 1e-3) {
        waveform = {77.3704e9, 70.15e12, 10e6 * static_cast<double>(n_samples) / 512.0, n_samples,
                    0.15};
        std::mt19937_64 random(7);
        std::uniform_real_distribution<double> uniform(-1.0, 1.0);
        std::normal_distribution<double> normal;
        for (index_t i = 0; i < n_antennas; ++i) {
            const double y = 0.07 * uniform(random);
            const double z = 0.12 * uniform(random);
            tx.insert(tx.end(), {-0.36, y, z});
            rx.insert(rx.end(), {-0.36, y + 0.005, z});
        }
        for (index_t i = 0; i < n_antennas * n_samples; ++i) {
            signal.emplace_back(static_cast<T>(normal(random)), static_cast<T>(normal(random)));
        }
        const double half = 0.5 * spacing * static_cast<double>(n_side - 1);
        grid = {{-half, -half, -half}, spacing, {n_side, n_side, n_side}};
        for (index_t x = 0; x < n_side; ++x) {
            for (index_t y = 0; y < n_side; ++y) {
                for (index_t z = 0; z < n_side; ++z) {
                    for (const index_t i : {x, y, z}) {
                        points.push_back(-half + spacing * static_cast<double>(i));
                    }
                }
            }
        }
    }

    [[nodiscard]] index_t n_antennas() const { return static_cast<index_t>(tx.size() / 3); }
    [[nodiscard]] index_t n_points() const { return static_cast<index_t>(points.size() / 3); }
};

/// One voxel of the image, in double precision with the library's sine and cosine.
template <class T>
std::complex<double> direct_sum(const Case<T>& c, index_t point) {
    std::complex<double> sum = 0.0;
    const auto n_samples = static_cast<std::size_t>(c.waveform.n_samples);
    for (std::size_t antenna = 0; antenna < c.tx.size() / 3; ++antenna) {
        double path = c.waveform.path_bias_m;
        for (const auto* from : {&c.tx, &c.rx}) {
            double square = 0.0;
            for (std::size_t axis = 0; axis < 3; ++axis) {
                const double d = c.points[3 * static_cast<std::size_t>(point) + axis] -
                                 (*from)[3 * antenna + axis];
                square += d * d;
            }
            path += std::sqrt(square);
        }
        for (std::size_t t = 0; t < n_samples; ++t) {
            const double phase = 2.0 * 3.14159265358979323846 *
                                 c.waveform.frequency_hz(static_cast<index_t>(t)) * path /
                                 geraf2::speed_of_light;
            sum += std::complex<double>(c.signal[antenna * n_samples + t]) * std::polar(1.0, phase);
        }
    }
    return sum / static_cast<double>(c.n_antennas());
}

/// Error of `image`, relative to its norm, on about 300 voxels.
template <class T>
double error_of(const Case<T>& c, const std::vector<std::complex<T>>& image) {
    double difference = 0.0;
    double norm = 0.0;
    for (index_t i = 0; i < c.n_points(); i += std::max<index_t>(1, c.n_points() / 300)) {
        const std::complex<double> want = direct_sum(c, i);
        difference += std::norm(std::complex<double>(image[static_cast<std::size_t>(i)]) - want);
        norm += std::norm(want);
    }
    return std::sqrt(difference / norm);
}

/// Multiply-adds (or bare products) of one pair, 64 samples. exact: 2.5 a sample; then, those in
/// double precision counted twice, for both paths, three phases, their sines and cosines, the
/// phasors made of them and the carrier 36 + 16 + 30 + 20 + 4. block: for both ranges, sine and
/// cosine, profile and sum 12 + 7 + 6 + 4 at rtol 1e-3, 14 + 9 + 10 + 4 at 1e-4.
constexpr int multiply_adds(MatchedFilterMethod method, int digits) {
    return method == MatchedFilterMethod::exact ? 266 : digits == 3 ? 29 : 37;
}

void report_multiply_adds(benchmark::State& state, int count) {
    state.counters["multiply_adds"] = count;
    state.counters["flops"] = benchmark::Counter(
        2.0 * count * static_cast<double>(state.items_processed()), benchmark::Counter::kIsRate);
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

template <class T, MatchedFilterMethod Method, int Digits = 3>
void BM_MatchedFilter(benchmark::State& state) {
    const Case<T> c(state.range(0), state.range(1), state.range(2));
    const auto threads = static_cast<int>(state.range(3));
    const double rtol = Digits == 3 ? 1e-3 : 1e-4;
    std::vector<std::complex<T>> image(static_cast<std::size_t>(c.n_points()));
    for (auto _ : state) {
        geraf2::matched_filter_fwd<T>(c.signal, {c.tx, c.rx}, c.grid, c.waveform,
                                      {Method, rtol, threads}, image);
        benchmark::ClobberMemory();
    }
    report(state, c);
    if constexpr (sizeof(T) == 4) {
        report_multiply_adds(state, multiply_adds(Method, Digits));
    }
    state.counters["rel_error"] = error_of(c, image);
}

/// Coarser grids: fewer points share the set-up of a block.
template <MatchedFilterMethod Method>
void BM_MatchedFilterSpacing(benchmark::State& state) {
    const Case<float> c(512, state.range(0), 12, 1e-6 * static_cast<double>(state.range(1)));
    std::vector<std::complex<float>> image(static_cast<std::size_t>(c.n_points()));
    for (auto _ : state) {
        geraf2::matched_filter_fwd<float>(c.signal, {c.tx, c.rx}, c.grid, c.waveform,
                                          {Method, 1e-3, 1}, image);
        benchmark::ClobberMemory();
    }
    report(state, c);
}

template <class T, MatchedFilterMethod Method>
void BM_MatchedFilterAdjoint(benchmark::State& state) {
    const Case<T> c(state.range(0), state.range(1), state.range(2));
    const auto threads = static_cast<int>(state.range(3));
    std::mt19937_64 random(8);
    std::normal_distribution<double> normal;
    std::vector<std::complex<T>> image;
    for (index_t i = 0; i < c.n_points(); ++i) {
        image.emplace_back(static_cast<T>(normal(random)), static_cast<T>(normal(random)));
    }
    std::vector<std::complex<T>> signal(c.signal.size());
    for (auto _ : state) {
        geraf2::matched_filter_bwd_signal<T>(image, {c.tx, c.rx}, c.grid, c.waveform,
                                             {Method, 1e-3, threads}, signal);
        benchmark::ClobberMemory();
    }
    report(state, c);
    if constexpr (sizeof(T) == 4) {
        report_multiply_adds(state, multiply_adds(Method, 3));
    }
}

void BM_MatchedFilterNaive(benchmark::State& state) {
    const Case<float> c(state.range(0), state.range(1), state.range(2));
    const std::vector<float> tx(c.tx.begin(), c.tx.end());
    const std::vector<float> rx(c.rx.begin(), c.rx.end());
    const std::vector<float> points(c.points.begin(), c.points.end());
    std::vector<std::complex<float>> image(static_cast<std::size_t>(c.n_points()));
    for (auto _ : state) {
        geraf2::bench::matched_filter_naive(c.signal, tx, rx, points, c.waveform, image);
        benchmark::ClobberMemory();
    }
    report(state, c);
    state.counters["rel_error"] = error_of(c, image);
    state.SetLabel("plain loops");
}

/// One thread, 512 antennas, 64 samples.
void side(benchmark::internal::Benchmark* b, int voxels) {
    b->ArgNames({"antennas", "samples", "side", "threads"})->Unit(benchmark::kMillisecond);
    b->Args({512, 64, voxels, 1});
}

/// Two threads against one: compare real times, on an idle machine.
void thread_counts(benchmark::internal::Benchmark* b, int voxels) {
    b->ArgNames({"antennas", "samples", "side", "threads"})->Unit(benchmark::kMillisecond);
    b->ArgsProduct({{512}, {64}, {voxels}, {1, 2}})->UseRealTime();
}

constexpr auto exact = MatchedFilterMethod::exact;
constexpr auto block = MatchedFilterMethod::block;

BENCHMARK(BM_MatchedFilterNaive)->Apply([](auto* b) { side(b, 6); });
BENCHMARK(BM_MatchedFilter<float, exact>)->Apply([](auto* b) { side(b, 16); });
BENCHMARK(BM_MatchedFilter<float, block>)->Apply([](auto* b) { side(b, 36); });
BENCHMARK(BM_MatchedFilter<float, block, 4>)->Apply([](auto* b) { side(b, 36); });
BENCHMARK(BM_MatchedFilter<double, exact>)->Apply([](auto* b) { side(b, 16); });
BENCHMARK(BM_MatchedFilter<double, block>)->Apply([](auto* b) { side(b, 27); });
BENCHMARK(BM_MatchedFilterAdjoint<float, exact>)->Apply([](auto* b) { side(b, 16); });
BENCHMARK(BM_MatchedFilterAdjoint<float, block>)->Apply([](auto* b) { side(b, 36); });

BENCHMARK(BM_MatchedFilter<float, exact>)->Apply([](auto* b) { thread_counts(b, 32); });
BENCHMARK(BM_MatchedFilter<float, block>)->Apply([](auto* b) { thread_counts(b, 54); });
BENCHMARK(BM_MatchedFilterAdjoint<float, exact>)->Apply([](auto* b) { thread_counts(b, 32); });
BENCHMARK(BM_MatchedFilterAdjoint<float, block>)->Apply([](auto* b) { thread_counts(b, 54); });

void spacings(benchmark::internal::Benchmark* b) {
    b->ArgNames({"samples", "spacing_um"})->ArgsProduct({{32, 64}, {2500, 5000}});
    b->Unit(benchmark::kMillisecond);
}

BENCHMARK(BM_MatchedFilterSpacing<block>)->Apply(spacings);
BENCHMARK(BM_MatchedFilterSpacing<exact>)->Apply(spacings);

} // namespace
