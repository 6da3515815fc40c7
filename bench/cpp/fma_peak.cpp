// SPDX-License-Identifier: Apache-2.0
// What the machine can do at most: independent multiply-adds on registers, one thread.
#include <benchmark/benchmark.h>

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

void BM_FmaPeak(benchmark::State& state) {
    const geraf2::SimdLevel level = geraf2::simd_level();
    float (*run)() = &chains_baseline;
    int lanes = 4;
#if defined(__x86_64__)
    if (level == geraf2::SimdLevel::avx2) {
        run = &chains_avx2;
        lanes = 8;
    } else if (level == geraf2::SimdLevel::avx512) {
        run = &chains_avx512;
        lanes = 16;
    }
#endif
    for (auto _ : state) {
        benchmark::DoNotOptimize(run());
    }
    state.SetItemsProcessed(state.iterations() * chains * rounds * lanes);
    state.SetLabel(geraf2::simd_level_name(level));
}
BENCHMARK(BM_FmaPeak);

} // namespace
