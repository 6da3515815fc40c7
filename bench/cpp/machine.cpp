// SPDX-License-Identifier: Apache-2.0
// What the machine can do at most: independent multiply-adds on registers, and copies of memory.
// Linked into every program, so that kernels and limits are measured in one run.
#include <benchmark/benchmark.h>

#include <cstddef>
#include <cstring>
#include <vector>

#include "geraf2/simd.hpp"

namespace {

constexpr int chains = 12; // two units times a latency of four or five cycles
constexpr int rounds = 1000;

template <class Vector>
[[gnu::always_inline]] inline float run_chains() {
    Vector sum[chains];
    for (int i = 0; i < chains; ++i) {
        sum[i] = Vector{} + static_cast<float>(i);
    }
    Vector factor = Vector{} + 0.999F;
    for (int round = 0; round < rounds; ++round) {
#pragma GCC unroll 12
        for (int i = 0; i < chains; ++i) {
            sum[i] = sum[i] * factor + factor;
        }
        asm volatile("" : "+x"(factor)); // the loop must not be folded
    }
    Vector total = sum[0];
    for (int i = 1; i < chains; ++i) {
        total += sum[i];
    }
    return total[0];
}

using Vector16 [[gnu::vector_size(16)]] = float;
using Vector32 [[gnu::vector_size(32)]] = float;
using Vector64 [[gnu::vector_size(64)]] = float;

float chains_baseline() { return run_chains<Vector16>(); }
#if defined(__x86_64__)
__attribute__((target("avx2,fma"))) float chains_avx2() { return run_chains<Vector32>(); }
__attribute__((target("avx512f,fma"))) float chains_avx512() { return run_chains<Vector64>(); }
#endif

struct Chains {
    float (*run)();
    int lanes;
};

Chains chains_of(geraf2::SimdLevel level) {
#if defined(__x86_64__)
    if (level == geraf2::SimdLevel::avx2) {
        return {&chains_avx2, 8};
    }
    if (level == geraf2::SimdLevel::avx512) {
        return {&chains_avx512, 16};
    }
#endif
    static_cast<void>(level);
    return {&chains_baseline, 4};
}

void BM_FmaPeak(benchmark::State& state) {
    const geraf2::SimdLevel level = geraf2::simd_level();
    const Chains chain = chains_of(level);
    for (auto _ : state) {
        benchmark::DoNotOptimize(chain.run());
    }
    state.SetItemsProcessed(state.iterations() * chains * rounds * chain.lanes);
    state.SetLabel(geraf2::simd_level_name(level));
}
BENCHMARK(BM_FmaPeak);

/// The same work, 2 ms of it, shared out: what two threads gain over one where nothing is shared.
void BM_MachineMultiplyAdds(benchmark::State& state) {
    const Chains chain = chains_of(geraf2::simd_level());
    const auto threads = static_cast<int>(state.range(0));
    for (auto _ : state) {
#pragma omp parallel for num_threads(threads) schedule(static)
        for (int i = 0; i < 800; ++i) {
            benchmark::DoNotOptimize(chain.run());
        }
    }
}

/// Memory that no second-level cache holds.
void BM_MachineCopy(benchmark::State& state) {
    constexpr std::size_t parts = 64;
    constexpr std::size_t part = 524288;
    const auto threads = static_cast<int>(state.range(0));
    const std::vector<char> from(parts * part, 1);
    std::vector<char> to(parts * part);
    for (auto _ : state) {
#pragma omp parallel for num_threads(threads) schedule(static)
        for (std::size_t i = 0; i < parts; ++i) {
            std::memcpy(to.data() + i * part, from.data() + i * part, part);
        }
        benchmark::ClobberMemory();
    }
    state.SetBytesProcessed(state.iterations() * static_cast<int64_t>(2 * parts * part));
}

void thread_counts(benchmark::internal::Benchmark* b) {
    b->ArgName("threads")->Arg(1)->Arg(2)->Unit(benchmark::kMillisecond)->UseRealTime();
}
BENCHMARK(BM_MachineMultiplyAdds)->Apply(thread_counts);
BENCHMARK(BM_MachineCopy)->Apply(thread_counts);

} // namespace
