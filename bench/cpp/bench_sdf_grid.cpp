// SPDX-License-Identifier: Apache-2.0
// Grid interpolation at random points and its adjoint, beside naive loops of the same quantities.
#include "geraf2/sdf_grid.hpp"

#include <benchmark/benchmark.h>

#include <cmath>
#include <random>
#include <span>
#include <vector>

#include "geraf2/simd.hpp"

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
        std::uniform_real_distribution<double> uniform(0.002, 0.188);
        for (int i = 0; i < 300000; ++i) {
            points.push_back(uniform(random));
        }
    }
};

/// Weights of the taps and their slopes per voxel.
template <unsigned N>
void naive_weights(double f, double* weight, double* slope) {
    if constexpr (N == 2) {
        weight[0] = 1.0 - f;
        weight[1] = f;
        slope[0] = -1.0;
        slope[1] = 1.0;
    } else {
        weight[0] = 0.5 * f * (f * (2.0 - f) - 1.0);
        weight[1] = 1.0 + 0.5 * f * f * (3.0 * f - 5.0);
        weight[2] = 0.5 * f * (1.0 + f * (4.0 - 3.0 * f));
        weight[3] = 0.5 * f * f * (f - 1.0);
        slope[0] = 0.5 * (f * (4.0 - 3.0 * f) - 1.0);
        slope[1] = 0.5 * f * (9.0 * f - 10.0);
        slope[2] = 0.5 * (1.0 + f * (8.0 - 9.0 * f));
        slope[3] = 0.5 * f * (3.0 * f - 2.0);
    }
}

/// Order: 0 the value, 1 with its gradient, 2 with its Hessian.
template <GridInterpolation Kind, int Order>
void BM_SdfGrid(benchmark::State& state) {
    Case c;
    std::vector<float> hessian(Order == 2 ? 600000 : 0);
    for (auto _ : state) {
        geraf2::sdf_grid_fwd<float>(
            c.values, c.grid, c.points, Kind, static_cast<int>(state.range(0)),
            {c.value, Order >= 1 ? std::span<float>(c.gradient) : std::span<float>{}, hessian});
        benchmark::ClobberMemory();
    }
    state.SetItemsProcessed(state.iterations() * 100000);
    state.SetLabel(geraf2::simd_level_name(geraf2::simd_level()));
}

template <GridInterpolation Kind>
void BM_SdfGridAdjoint(benchmark::State& state) {
    Case c;
    for (auto _ : state) {
        geraf2::sdf_grid_bwd<float>(c.value, c.gradient, c.grid, c.points, Kind,
                                    static_cast<int>(state.range(0)), c.values);
        benchmark::ClobberMemory();
    }
    state.SetItemsProcessed(state.iterations() * 100000);
}

/// The plain loops over taps and axes, in double as the kernel: the value, or with its gradient.
template <GridInterpolation Kind, int Order>
void BM_SdfGridNaive(benchmark::State& state) {
    constexpr unsigned n = Kind == GridInterpolation::cubic ? 4 : 2;
    Case c;
    for (auto _ : state) {
        for (std::size_t i = 0; i < c.value.size(); ++i) {
            double weight[3][n];
            double slope[3][n];
            std::size_t cell[3];
            for (unsigned axis = 0; axis < 3; ++axis) {
                const double p = c.points[3 * i + axis] / c.grid.spacing;
                cell[axis] = static_cast<std::size_t>(p) - (n == 4 ? 1 : 0);
                naive_weights<n>(p - std::floor(p), weight[axis], slope[axis]);
            }
            double sum[4] = {};
            for (unsigned x = 0; x < n; ++x) {
                for (unsigned y = 0; y < n; ++y) {
                    for (unsigned z = 0; z < n; ++z) {
                        const auto v = static_cast<double>(
                            c.values[((cell[0] + x) * 96 + cell[1] + y) * 96 + cell[2] + z]);
                        sum[0] += weight[0][x] * weight[1][y] * weight[2][z] * v;
                        if constexpr (Order == 1) {
                            sum[1] += slope[0][x] * weight[1][y] * weight[2][z] * v;
                            sum[2] += weight[0][x] * slope[1][y] * weight[2][z] * v;
                            sum[3] += weight[0][x] * weight[1][y] * slope[2][z] * v;
                        }
                    }
                }
            }
            c.value[i] = static_cast<float>(sum[0]);
            for (unsigned axis = 0; Order == 1 && axis < 3; ++axis) {
                c.gradient[3 * i + axis] = static_cast<float>(sum[1 + axis] / c.grid.spacing);
            }
        }
        benchmark::ClobberMemory();
    }
    state.SetItemsProcessed(state.iterations() * 100000);
    state.SetLabel("plain loops");
}

void one_thread(benchmark::internal::Benchmark* b) {
    b->ArgName("threads")->Arg(1)->Unit(benchmark::kMillisecond);
}

/// Two threads against one: compare real times, on an idle machine.
void thread_counts(benchmark::internal::Benchmark* b) {
    b->ArgName("threads")->Arg(1)->Arg(2)->Unit(benchmark::kMillisecond)->UseRealTime();
}

constexpr GridInterpolation linear = GridInterpolation::linear;
constexpr GridInterpolation cubic = GridInterpolation::cubic;
BENCHMARK(BM_SdfGridNaive<linear, 0>)->Apply(one_thread);
BENCHMARK(BM_SdfGridNaive<linear, 1>)->Apply(one_thread);
BENCHMARK(BM_SdfGridNaive<cubic, 0>)->Apply(one_thread);
BENCHMARK(BM_SdfGridNaive<cubic, 1>)->Apply(one_thread);
BENCHMARK(BM_SdfGrid<linear, 0>)->Apply(one_thread);
BENCHMARK(BM_SdfGrid<linear, 1>)->Apply(one_thread);
BENCHMARK(BM_SdfGrid<linear, 1>)->Apply(thread_counts);
BENCHMARK(BM_SdfGrid<linear, 2>)->Apply(one_thread);
BENCHMARK(BM_SdfGrid<cubic, 0>)->Apply(one_thread);
BENCHMARK(BM_SdfGrid<cubic, 1>)->Apply(one_thread);
BENCHMARK(BM_SdfGrid<cubic, 1>)->Apply(thread_counts);
BENCHMARK(BM_SdfGrid<cubic, 2>)->Apply(one_thread);
BENCHMARK(BM_SdfGridAdjoint<linear>)->Apply(one_thread);
BENCHMARK(BM_SdfGridAdjoint<linear>)->Apply(thread_counts);
BENCHMARK(BM_SdfGridAdjoint<cubic>)->Apply(one_thread);
BENCHMARK(BM_SdfGridAdjoint<cubic>)->Apply(thread_counts);

} // namespace
