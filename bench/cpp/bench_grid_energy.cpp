// SPDX-License-Identifier: Apache-2.0
// Items are voxels. The peer is the same matrix in compressed rows, as a sparse library has it.
#include <benchmark/benchmark.h>

#include <cstdint>
#include <vector>

#include "geraf2/grid_energy.hpp"

namespace {

using geraf2::index_t;

template <class T>
geraf2::GridEnergy<T> make_energy(index_t n) {
    const std::vector<index_t> starts{0};
    const std::vector<double> diagonal(static_cast<std::size_t>(n * n * n), 1e-6);
    return {{{n, n, n}, {0.4, 0.4, 0.4}}, 0.4, {{}, starts, {}, {}}, diagonal};
}

template <class T>
void BM_GridEnergyApply(benchmark::State& state) {
    const index_t n = state.range(0);
    const auto energy = make_energy<T>(n);
    std::vector<T> field(static_cast<std::size_t>(n * n * n), T(1));
    std::vector<T> product(field.size());
    for (auto _ : state) {
        energy.apply(field, product, static_cast<int>(state.range(1)));
        benchmark::DoNotOptimize(product.data());
    }
    state.SetItemsProcessed(state.iterations() * n * n * n);
    state.SetBytesProcessed(state.iterations() * n * n * n * 3 * static_cast<index_t>(sizeof(T)));
}

template <class T>
void BM_GridEnergySmooth(benchmark::State& state) {
    const index_t n = state.range(0);
    const auto energy = make_energy<T>(n);
    const std::vector<T> right(static_cast<std::size_t>(n * n * n), T(1));
    std::vector<T> field(right.size());
    for (auto _ : state) {
        energy.smooth(right, {4, 0.1, 4.0}, static_cast<int>(state.range(1)), field);
        benchmark::DoNotOptimize(field.data());
    }
    state.SetItemsProcessed(state.iterations() * n * n * n * 4);
}

/// 25 entries in each row, as bending has inside the grid.
template <class T>
void BM_CompressedRows(benchmark::State& state) {
    const index_t n = state.range(0);
    const index_t n_voxels = n * n * n;
    std::vector<std::int32_t> columns;
    std::vector<T> values;
    for (index_t row = 0; row < n_voxels; ++row) {
        for (const index_t x : {-2, -1, 0, 1, 2}) {
            for (const index_t step : {n * n, n, index_t{1}}) {
                if (x != 0 || step == 1) {
                    columns.push_back(
                        static_cast<std::int32_t>((row + x * step + n_voxels) % n_voxels));
                    values.push_back(T(1));
                }
            }
        }
        for (const index_t step : {n * n + n, n * n - n, n * n + 1, n * n - 1, n + 1, n - 1}) {
            for (const index_t sign : {-1, 1}) {
                columns.push_back(
                    static_cast<std::int32_t>((row + sign * step + n_voxels) % n_voxels));
                values.push_back(T(1));
            }
        }
    }
    std::vector<T> field(static_cast<std::size_t>(n_voxels), T(1));
    std::vector<T> product(field.size());
    const std::size_t width = values.size() / product.size();
    for (auto _ : state) {
        for (std::size_t row = 0; row < product.size(); ++row) {
            T sum{};
            for (std::size_t entry = row * width; entry < (row + 1) * width; ++entry) {
                sum += values[entry] * field[static_cast<std::size_t>(columns[entry])];
            }
            product[row] = sum;
        }
        benchmark::DoNotOptimize(product.data());
    }
    state.SetItemsProcessed(state.iterations() * n_voxels);
}

void one_thread(benchmark::internal::Benchmark* b) {
    b->ArgNames({"side", "threads"})->Args({29, 1})->Args({57, 1});
}

/// Two threads against one: compare real times, on an idle machine.
void thread_counts(benchmark::internal::Benchmark* b) {
    b->ArgNames({"side", "threads"})->ArgsProduct({{113}, {1, 2}})->UseRealTime();
}

BENCHMARK(BM_GridEnergyApply<float>)->Apply(one_thread);
BENCHMARK(BM_GridEnergyApply<float>)->Apply(thread_counts);
BENCHMARK(BM_GridEnergyApply<double>)->Apply(one_thread);
BENCHMARK(BM_GridEnergySmooth<float>)->Apply(one_thread);
BENCHMARK(BM_GridEnergySmooth<float>)->Apply(thread_counts);
BENCHMARK(BM_CompressedRows<double>)->Arg(29)->Arg(57);

} // namespace
