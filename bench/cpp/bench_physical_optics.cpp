// SPDX-License-Identifier: Apache-2.0
// Items are (element, antenna) pairs of 32 ADC samples: a small part of a simulated plane, whose
// blocks the threads share.
#include <benchmark/benchmark.h>

#include <cmath>
#include <complex>
#include <random>
#include <vector>

#include "geraf2/physical_optics.hpp"

namespace {

using geraf2::index_t;

constexpr index_t antennas_per_block = 16;

// Elements within 5 cm of the origin, a plane of antennas 0.4 m away, in blocks that threads share.
struct Setup {
    std::vector<double> points, normals, edges, tx, rx;
    std::vector<index_t> offsets;
    std::vector<std::complex<float>> weights, signal;
    geraf2::EchoParams params;

    Setup(index_t n_elements, index_t n_antennas) {
        std::mt19937_64 random(1);
        std::uniform_real_distribution<double> uniform(-1.0, 1.0);
        for (index_t p = 0; p < n_elements; ++p) {
            for (int axis = 0; axis < 3; ++axis) {
                points.push_back(0.05 * uniform(random));
            }
            const double y = 0.7 * uniform(random);
            const double z = 0.7 * uniform(random);
            normals.insert(normals.end(), {std::sqrt(1.0 - y * y - z * z), y, z});
            for (int value = 0; value < 6; ++value) {
                edges.push_back(5e-4 * uniform(random));
            }
        }
        for (index_t a = 0; a < n_antennas; ++a) {
            const double y = 0.02 * uniform(random);
            const double z = 0.02 * uniform(random);
            tx.insert(tx.end(), {0.4, y + 0.0025, z});
            rx.insert(rx.end(), {0.4, y - 0.0025, z});
        }
        for (index_t first = 0; first <= n_antennas; first += antennas_per_block) {
            offsets.push_back(first);
        }
        weights.assign((offsets.size() - 1) * static_cast<std::size_t>(n_elements), 1e-6F);
        params.waveform = {77.3704e9, 70.15e12, 625e3, 32, 0.15};
        params.boresight = {-1.0, 0.0, 0.0};
        signal.resize(static_cast<std::size_t>(n_antennas) * 32);
    }
};

void BM_PhysicalOptics(benchmark::State& state) {
    const index_t n_elements = 4000;
    const index_t n_antennas = 512;
    Setup setup(n_elements, n_antennas);
    setup.params.shape =
        state.range(0) != 0 ? geraf2::ElementShape::rectangle : geraf2::ElementShape::triangle;
    std::vector<geraf2::DielectricBox> walls(
        static_cast<std::size_t>(state.range(1)),
        geraf2::DielectricBox{{0.0, 0.0, 0.0}, {0.11, 0.11, 0.11}, 0.004, 1.6});
    for (auto _ : state) {
        geraf2::physical_optics<float>(setup.points, setup.normals, setup.edges, setup.weights,
                                       setup.tx, setup.rx, setup.offsets, walls, setup.params,
                                       setup.signal, static_cast<int>(state.range(2)));
        benchmark::DoNotOptimize(setup.signal.data());
    }
    state.SetItemsProcessed(state.iterations() * n_elements * n_antennas);
}

BENCHMARK(BM_PhysicalOptics)
    ->ArgNames({"rectangle", "walls", "threads"})
    ->ArgsProduct({{0, 1}, {0, 1, 2}, {1}})
    ->Unit(benchmark::kMillisecond);
// Two threads against one: compare real times, on an idle machine.
BENCHMARK(BM_PhysicalOptics)
    ->ArgNames({"rectangle", "walls", "threads"})
    ->ArgsProduct({{0}, {1}, {1, 2}})
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();

} // namespace
