// SPDX-License-Identifier: Apache-2.0
// Items are sub-apertures of 27 x 27 antennas and 32 samples (729 where they lie anywhere). The
// peer is the sum as it stands: ranges first, then for each pair of directions the sum over
// antennas.
#include <benchmark/benchmark.h>

#include <cmath>
#include <complex>
#include <numbers>
#include <random>
#include <vector>

#include "geraf2/subaperture.hpp"

namespace {

using geraf2::index_t;

constexpr index_t n_side = 27;
constexpr index_t n_antennas = n_side * n_side;
constexpr index_t n_samples = 32;
constexpr double spacing_m = 0.003;
/// What a plane of 0.14 x 0.25 m gives: 4 x 9 squares of 8 cm in steps of 2 cm.
constexpr index_t n_subapertures = 36;

struct Setup {
    geraf2::Waveform waveform{77.3704e9, 70.15e12, 625e3, n_samples, 0.15};
    geraf2::SubapertureBins bins;
    geraf2::SubapertureLattice lattice;
    std::vector<double> positions, weights, places;
    std::vector<index_t> offsets{0}, antennas;
    std::vector<double> focus, focus_range;
    std::vector<std::complex<float>> signal;

    Setup(bool scattered, index_t n_parts) {
        // What SubapertureConfig makes of 8 cm at 3 mm, and of any places.
        if (scattered) {
            bins = {
                {77, -0.6088, 0.01602, false}, {77, -0.6088, 0.01602, false}, {23, 0.3, 0.0209}};
            lattice = {89, 89, 0.00105, 0.00105, 8, 0.976 * std::numbers::pi * 8.0 * 2.0 / 3.0};
        } else {
            bins = {{40, -0.3204, 0.01602, true}, {40, -0.3204, 0.01602, true}, {23, 0.3, 0.0209}};
            lattice = {n_side, n_side, spacing_m, spacing_m, 1, 0.0};
        }
        std::mt19937_64 random(1);
        std::normal_distribution<float> normal;
        std::uniform_real_distribution<double> uniform(-1e-3, 1e-3);
        for (index_t i = 0; i < n_antennas; ++i) {
            const double jitter = scattered ? 1.0 : 0.0;
            const double y =
                spacing_m * (static_cast<double>(i / n_side) - 13.0) + jitter * uniform(random);
            const double z =
                spacing_m * (static_cast<double>(i % n_side) - 13.0) + jitter * uniform(random);
            positions.insert(positions.end(), {0.0, y, z});
            for (index_t t = 0; t < n_samples; ++t) {
                signal.emplace_back(normal(random), normal(random));
            }
        }
        for (index_t s = 0; s < n_parts; ++s) {
            for (index_t i = 0; i < n_antennas; ++i) {
                antennas.push_back(i);
                weights.push_back(1.0 / static_cast<double>(n_antennas));
                places.insert(places.end(), {positions[static_cast<std::size_t>(3 * i + 1)],
                                             positions[static_cast<std::size_t>(3 * i + 2)]});
            }
            offsets.push_back(static_cast<index_t>(antennas.size()));
            focus.insert(focus.end(), {0.4, 0.0, 0.0});
            focus_range.push_back(0.4);
        }
    }

    [[nodiscard]] geraf2::SubapertureMembers members() const {
        return {offsets, antennas, weights, places, focus, focus_range};
    }
};

void BM_SubaperturePeaks(benchmark::State& state) {
    const Setup setup(state.range(0) != 0, n_subapertures);
    for (auto _ : state) {
        const auto peaks = geraf2::subaperture_peaks<float>(
            setup.signal, setup.positions, setup.positions, setup.waveform, setup.members(),
            setup.lattice, setup.bins, {0.05, 5.6}, static_cast<int>(state.range(1)));
        benchmark::DoNotOptimize(peaks.tops.data());
    }
    state.SetItemsProcessed(state.iterations() * n_subapertures);
    state.SetLabel(setup.bins.horizontal.count == 40 ? "raster" : "anywhere");
}

void BM_SubapertureImages(benchmark::State& state) {
    const Setup setup(state.range(0) != 0, n_subapertures);
    std::vector<float> images(static_cast<std::size_t>(n_subapertures * setup.bins.size()));
    for (auto _ : state) {
        geraf2::subaperture_images<float>(setup.signal, setup.positions, setup.positions,
                                          setup.waveform, setup.members(), setup.lattice,
                                          setup.bins, static_cast<int>(state.range(1)), images);
        benchmark::DoNotOptimize(images.data());
    }
    state.SetItemsProcessed(state.iterations() * n_subapertures);
}

void BM_NaiveSubapertureImage(benchmark::State& state) {
    const Setup setup(state.range(0) != 0, 1);
    const auto& bins = setup.bins;
    const auto n_ranges = static_cast<std::size_t>(bins.ranges.count);
    std::vector<float> image(static_cast<std::size_t>(bins.size()));
    const double wavenumber = 2.0 * std::numbers::pi / geraf2::speed_of_light;
    for (auto _ : state) {
        std::vector<std::complex<float>> profiles(n_antennas * n_ranges);
        for (std::size_t a = 0; a < n_antennas; ++a) {
            const double path =
                2.0 * std::hypot(0.4, setup.places[2 * a], setup.places[2 * a + 1]) - 0.8 +
                setup.waveform.path_bias_m;
            for (std::size_t r = 0; r < n_ranges; ++r) {
                const double range =
                    bins.ranges.first_m + bins.ranges.pitch_m * static_cast<double>(r);
                std::complex<float> sum{};
                for (index_t t = 0; t < n_samples; ++t) {
                    const double phase =
                        wavenumber * setup.waveform.frequency_hz(t) * (2.0 * range + path);
                    sum += setup.signal[a * n_samples + static_cast<std::size_t>(t)] *
                           std::complex<float>(std::polar(1.0, phase));
                }
                profiles[a * n_ranges + r] = sum;
            }
        }
        std::vector<std::complex<float>> sums(n_ranges);
        for (index_t d = 0; d < bins.horizontal.count * bins.vertical.count; ++d) {
            const double u = bins.horizontal.at(d / bins.vertical.count);
            const double v = bins.vertical.at(d % bins.vertical.count);
            sums.assign(n_ranges, {});
            for (std::size_t a = 0; a < n_antennas; ++a) {
                const double phase = -2.0 * wavenumber *
                                     setup.waveform.frequency_hz(n_samples / 2) *
                                     (u * setup.places[2 * a] + v * setup.places[2 * a + 1]);
                const std::complex<float> turn(std::polar(1.0, phase));
                for (std::size_t r = 0; r < n_ranges; ++r) {
                    sums[r] += turn * profiles[a * n_ranges + r];
                }
            }
            for (std::size_t r = 0; r < n_ranges; ++r) {
                image[static_cast<std::size_t>(d) * n_ranges + r] = std::abs(sums[r]);
            }
        }
        benchmark::DoNotOptimize(image.data());
    }
    state.SetItemsProcessed(state.iterations());
}

void one_thread(benchmark::internal::Benchmark* b) {
    b->ArgNames({"anywhere", "threads"})->ArgsProduct({{0, 1}, {1}});
    b->Unit(benchmark::kMillisecond);
}

/// Two threads against one: compare real times, on an idle machine.
void thread_counts(benchmark::internal::Benchmark* b) {
    b->ArgNames({"anywhere", "threads"})->ArgsProduct({{0, 1}, {1, 2}});
    b->Unit(benchmark::kMillisecond)->UseRealTime();
}

BENCHMARK(BM_SubaperturePeaks)->Apply(one_thread);
BENCHMARK(BM_SubaperturePeaks)->Apply(thread_counts);
BENCHMARK(BM_SubapertureImages)->Apply(one_thread);
BENCHMARK(BM_NaiveSubapertureImage)
    ->ArgName("anywhere")
    ->Arg(0)
    ->Arg(1)
    ->Unit(benchmark::kMillisecond);

} // namespace
