// SPDX-License-Identifier: Apache-2.0
// Factorised matched filter beside the block method: a raster of 256 x 256 antennas.
#include <benchmark/benchmark.h>

#include <cmath>
#include <complex>
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

/// Error relative to the norm, on voxels drawn at random.
double error_of(const geraf2::VoxelGrid& grid, const std::vector<std::complex<float>>& image) {
    std::mt19937_64 random(11);
    double difference = 0.0;
    double norm = 0.0;
    for (int i = 0; i < 60; ++i) {
        double point[3];
        index_t index = 0;
        for (std::size_t axis = 0; axis < 3; ++axis) {
            const auto at =
                static_cast<index_t>(random() % static_cast<std::uint64_t>(grid.shape[axis]));
            point[axis] = grid.origin[axis] + grid.spacing * static_cast<double>(at);
            index = index * grid.shape[axis] + at;
        }
        const std::complex<double> want = direct_sum(Scan::get(), point);
        difference +=
            std::norm(std::complex<double>(image[static_cast<std::size_t>(index)]) - want);
        norm += std::norm(want);
    }
    return std::sqrt(difference / norm);
}

/// rtol is 10^-digits. Block images a smaller cube: its cost per pair is the same.
template <MatchedFilterMethod Method, int Levels>
void BM_Plane(benchmark::State& state) {
    const Scan& scan = Scan::get();
    const geraf2::VoxelGrid grid = cube(state.range(0));
    geraf2::MatchedFilterOptions options{Method,
                                         std::pow(10.0, -static_cast<double>(state.range(1))),
                                         static_cast<int>(state.range(2))};
    options.levels = Levels;
    const index_t n_voxels = grid.shape[0] * grid.shape[1] * grid.shape[2];
    std::vector<std::complex<float>> image(static_cast<std::size_t>(n_voxels));
    for (auto _ : state) {
        geraf2::matched_filter_fwd<float>(scan.signal, {scan.tx, scan.rx}, grid, scan.waveform,
                                          options, image);
        benchmark::ClobberMemory();
    }
    const index_t pairs = raster * raster * n_voxels;
    state.SetItemsProcessed(state.iterations() * pairs);
    state.counters["per_pair"] = benchmark::Counter(static_cast<double>(pairs),
                                                    benchmark::Counter::kIsIterationInvariantRate |
                                                        benchmark::Counter::kInvert);
    state.counters["rel_error"] = error_of(grid, image);
    state.SetLabel(geraf2::simd_level_name(geraf2::simd_level()));
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

} // namespace
