// SPDX-License-Identifier: Apache-2.0
// Factorised matched filter beside the block method: a raster of 256 x 256 antennas.
#include <benchmark/benchmark.h>

#include <cmath>
#include <complex>
#include <cstdint>
#include <map>
#include <random>
#include <vector>

#include "geraf2/matched_filter.hpp"
#include "geraf2/simd.hpp"

namespace {

using geraf2::index_t;
using geraf2::MatchedFilterMethod;

constexpr index_t n_samples = 64;
constexpr index_t raster = 256;

/// White noise from a planar raster at 1 mm, 0.35 m from the middle of a cube of voxels at 1 mm;
/// receivers stand 5 mm beside their transmitters.
struct Scan {
    geraf2::Waveform waveform{77.3704e9, 70.15e12, 1.25e6, n_samples, 0.15};
    std::vector<double> tx, rx;
    std::vector<std::complex<float>> signal;

    Scan() {
        std::mt19937_64 random(7);
        std::normal_distribution<double> normal;
        for (index_t i = 0; i < raster * raster; ++i) {
            const double y = 1e-3 * (static_cast<double>(i / raster) - 0.5 * (raster - 1));
            const double z = 1e-3 * (static_cast<double>(i % raster) - 0.5 * (raster - 1));
            tx.insert(tx.end(), {-0.35, y, z});
            rx.insert(rx.end(), {-0.35, y + 0.005, z});
        }
        for (index_t i = 0; i < raster * raster * n_samples; ++i) {
            signal.emplace_back(static_cast<float>(normal(random)),
                                static_cast<float>(normal(random)));
        }
    }

    static const Scan& get() {
        static const Scan scan;
        return scan;
    }
};

geraf2::VoxelGrid cube(index_t side) {
    const double half = 0.5e-3 * static_cast<double>(side - 1);
    return {{-half, -half, -half}, 1e-3, {side, side, side}};
}

/// One voxel of the image by the float64 direct sum.
std::complex<double> direct_sum(const Scan& scan, const double* point) {
    std::complex<double> sum = 0.0;
    const auto samples = static_cast<std::size_t>(n_samples);
    for (std::size_t antenna = 0; antenna < scan.tx.size() / 3; ++antenna) {
        double path = scan.waveform.path_bias_m;
        for (const auto* from : {&scan.tx, &scan.rx}) {
            const double* p = from->data() + 3 * antenna;
            path += std::hypot(point[0] - p[0], point[1] - p[1], point[2] - p[2]);
        }
        const double pi = 3.14159265358979323846;
        const double turns = 2.0 * pi * path / geraf2::speed_of_light;
        const std::complex<double> step = std::polar(
            1.0, turns * (scan.waveform.frequency_hz(1) - scan.waveform.frequency_hz(0)));
        std::complex<double> z = std::polar(1.0, turns * scan.waveform.frequency_hz(0));
        for (std::size_t t = 0; t < samples; ++t) { // 64 steps in double lose nothing
            sum += std::complex<double>(scan.signal[antenna * samples + t]) * z;
            z *= step;
        }
    }
    return sum / static_cast<double>(scan.tx.size() / 3);
}

struct Sample {
    index_t index = 0;
    std::complex<double> value;
};

/// The direct sum at voxels drawn at random, once per grid.
const std::vector<Sample>& direct_sums(const geraf2::VoxelGrid& grid) {
    static std::map<index_t, std::vector<Sample>> known;
    auto [entry, missing] = known.try_emplace(grid.shape[0]);
    std::mt19937_64 random(11);
    for (int i = 0; i < 60 && missing; ++i) {
        double point[3];
        index_t index = 0;
        for (std::size_t axis = 0; axis < 3; ++axis) {
            const index_t n = grid.shape[axis];
            const auto at = static_cast<index_t>(random() % static_cast<std::uint64_t>(n));
            point[axis] = grid.origin[axis] + grid.spacing * static_cast<double>(at);
            index = index * n + at;
        }
        entry->second.push_back({index, direct_sum(Scan::get(), point)});
    }
    return entry->second;
}

/// Error relative to the norm.
double error_of(const geraf2::VoxelGrid& grid, const std::vector<std::complex<float>>& image) {
    double difference = 0.0;
    double norm = 0.0;
    for (const Sample& want : direct_sums(grid)) {
        const std::complex<double> got = image[static_cast<std::size_t>(want.index)];
        difference += std::norm(got - want.value);
        norm += std::norm(want.value);
    }
    return std::sqrt(difference / norm);
}

geraf2::MatchedFilterOptions options_of(const benchmark::State& state, MatchedFilterMethod method,
                                        int levels) {
    geraf2::MatchedFilterOptions out{method, std::pow(10.0, -static_cast<double>(state.range(1))),
                                     static_cast<int>(state.range(2))};
    out.levels = levels;
    return out;
}

void report(benchmark::State& state, const geraf2::VoxelGrid& grid) {
    const index_t pairs = raster * raster * grid.shape[0] * grid.shape[1] * grid.shape[2];
    state.SetItemsProcessed(state.iterations() * pairs);
    state.counters["per_pair"] = benchmark::Counter(static_cast<double>(pairs),
                                                    benchmark::Counter::kIsIterationInvariantRate |
                                                        benchmark::Counter::kInvert);
    state.SetLabel(geraf2::simd_level_name(geraf2::simd_level()));
}

/// rtol is 10^-digits. Block images a smaller cube: its cost per pair is the same.
template <MatchedFilterMethod Method, int Levels>
void BM_Plane(benchmark::State& state) {
    const Scan& scan = Scan::get();
    const geraf2::VoxelGrid grid = cube(state.range(0));
    const auto options = options_of(state, Method, Levels);
    std::vector<std::complex<float>> image(
        static_cast<std::size_t>(grid.shape[0] * grid.shape[1] * grid.shape[2]));
    for (auto _ : state) {
        geraf2::matched_filter_fwd<float>(scan.signal, {scan.tx, scan.rx}, grid, scan.waveform,
                                          options, image);
        benchmark::ClobberMemory();
    }
    report(state, grid);
    state.counters["rel_error"] = error_of(grid, image);
}

/// BM_Plane of a geometry that was planned before.
template <MatchedFilterMethod Method, int Levels>
void BM_PlannedPlane(benchmark::State& state) {
    const Scan& scan = Scan::get();
    const geraf2::VoxelGrid grid = cube(state.range(0));
    const geraf2::MatchedFilterPlan<float> plan({scan.tx, scan.rx}, grid, scan.waveform,
                                                options_of(state, Method, Levels));
    std::vector<std::complex<float>> image(static_cast<std::size_t>(plan.n_points()));
    for (auto _ : state) {
        plan.image(scan.signal, {}, image);
        benchmark::ClobberMemory();
    }
    report(state, grid);
}

template <MatchedFilterMethod Method, int Levels>
void BM_PlaneAdjoint(benchmark::State& state) {
    const Scan& scan = Scan::get();
    const geraf2::VoxelGrid grid = cube(state.range(0));
    const auto options = options_of(state, Method, Levels);
    const auto n_voxels = grid.shape[0] * grid.shape[1] * grid.shape[2];
    const std::vector<std::complex<float>> image(scan.signal.begin(),
                                                 scan.signal.begin() + n_voxels);
    std::vector<std::complex<float>> signal(scan.signal.size());
    for (auto _ : state) {
        geraf2::matched_filter_bwd_signal<float>(image, {scan.tx, scan.rx}, grid, scan.waveform,
                                                 options, signal);
        benchmark::ClobberMemory();
    }
    report(state, grid);
}

void arguments(benchmark::internal::Benchmark* b, int side) {
    b->ArgNames({"side", "digits", "threads"})->Unit(benchmark::kMillisecond);
    b->Args({side, 3, 1})->Args({side, 4, 1});
}

constexpr auto block = MatchedFilterMethod::block;
constexpr auto factorised = MatchedFilterMethod::factorised;

BENCHMARK(BM_Plane<block, 1>)->Apply([](auto* b) { arguments(b, 27); });
BENCHMARK(BM_Plane<factorised, 1>)->Apply([](auto* b) { arguments(b, 64); });
BENCHMARK(BM_Plane<factorised, 2>)->Apply([](auto* b) { arguments(b, 64); });
BENCHMARK(BM_PlannedPlane<factorised, 2>)->Apply([](auto* b) { arguments(b, 64); });
BENCHMARK(BM_PlaneAdjoint<block, 1>)->Apply([](auto* b) { arguments(b, 27); });
BENCHMARK(BM_PlaneAdjoint<factorised, 2>)->Apply([](auto* b) { arguments(b, 64); });

// Wall time with one and with two threads, for which the machine must be idle.
void threads(benchmark::internal::Benchmark* b) {
    b->ArgNames({"side", "digits", "threads"})->Unit(benchmark::kMillisecond)->UseRealTime();
    b->Args({128, 3, 1})->Args({128, 3, 2});
}

BENCHMARK(BM_Plane<factorised, 2>)->Apply(threads);
BENCHMARK(BM_PlaneAdjoint<factorised, 2>)->Apply(threads);

} // namespace
