// SPDX-License-Identifier: Apache-2.0
// Grid interpolation: value and gradient at random points, and the adjoint, beside a naive
// trilinear loop of the value alone.
#include "geraf2/sdf_grid.hpp"

#include <benchmark/benchmark.h>

#include <cmath>
#include <random>
#include <vector>

namespace {

using geraf2::GridInterpolation;

struct Case {
    geraf2::VoxelGrid grid{{0.0, 0.0, 0.0}, 0.002, {96, 96, 96}};
    std::vector<float> values = std::vector<float>(96 * 96 * 96, 1.0F);
    std::vector<float> value = std::vector<float>(100000);
    std::vector<float> gradient = std::vector<float>(300000);
    std::vector<double> points;

    Case() {
        std::mt19937_64 random(7);
        std::uniform_real_distribution<double> uniform(0.0, 0.19);
        for (int i = 0; i < 300000; ++i) {
            points.push_back(uniform(random));
        }
    }
};

template <GridInterpolation Kind>
void BM_SdfGrid(benchmark::State& state) {
    Case c;
    for (auto _ : state) {
        geraf2::sdf_grid_fwd<float>(c.values, c.grid, c.points, Kind, 1, {c.value, c.gradient, {}});
        benchmark::ClobberMemory();
    }
    state.SetItemsProcessed(state.iterations() * 100000);
}

template <GridInterpolation Kind>
void BM_SdfGridAdjoint(benchmark::State& state) {
    Case c;
    for (auto _ : state) {
        geraf2::sdf_grid_bwd<float>(c.value, c.gradient, c.grid, c.points, Kind, 1, c.values);
        benchmark::ClobberMemory();
    }
    state.SetItemsProcessed(state.iterations() * 100000);
}

void BM_SdfGridNaiveLinearValue(benchmark::State& state) {
    Case c;
    for (auto _ : state) {
        for (std::size_t i = 0; i < c.value.size(); ++i) {
            double sum = 0.0;
            for (unsigned corner = 0; corner < 8; ++corner) {
                double weight = 1.0;
                std::size_t at = 0;
                for (unsigned axis = 0; axis < 3; ++axis) {
                    const double p = c.points[3 * i + axis] / c.grid.spacing;
                    const double f = p - std::floor(p);
                    const unsigned bit = (corner >> axis) & 1U;
                    weight *= bit == 1U ? f : 1.0 - f;
                    at = at * 96 + static_cast<std::size_t>(p) + bit;
                }
                sum += weight * static_cast<double>(c.values[at]);
            }
            c.value[i] = static_cast<float>(sum);
        }
        benchmark::ClobberMemory();
    }
    state.SetItemsProcessed(state.iterations() * 100000);
}

BENCHMARK(BM_SdfGridNaiveLinearValue)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_SdfGrid<GridInterpolation::linear>)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_SdfGrid<GridInterpolation::cubic>)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_SdfGridAdjoint<GridInterpolation::linear>)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_SdfGridAdjoint<GridInterpolation::cubic>)->Unit(benchmark::kMillisecond);

} // namespace
