// SPDX-License-Identifier: Apache-2.0
// Ray march, forward and backward, beside the naive loop of the forward equation, in one run.
#include "geraf2/ray_march.hpp"

#include <benchmark/benchmark.h>

#include <cmath>
#include <random>
#include <vector>

#include "geraf2/simd.hpp"

namespace {

using geraf2::index_t;

struct Case {
    std::vector<float> sdf, cos, step, alpha, transmittance, weight, depth;
    index_t n_rays, n_samples;

    explicit Case(const benchmark::State& state)
        : n_rays(state.range(0)), n_samples(state.range(1)) {
        std::mt19937_64 random(7);
        std::uniform_real_distribution<float> uniform(-1.0F, 1.0F);
        const auto n = static_cast<std::size_t>(n_rays * n_samples);
        for (std::size_t i = 0; i < n; ++i) {
            sdf.push_back(0.03F + 0.1F * uniform(random));
            cos.push_back(uniform(random));
            step.push_back(0.006F);
        }
        for (auto* out : {&alpha, &transmittance, &weight}) {
            out->resize(n);
        }
        depth.resize(static_cast<std::size_t>(n_rays));
    }
    [[nodiscard]] geraf2::RaySamples<float> samples() const {
        return {sdf, cos, step, 84.0, n_samples, 1};
    }
    [[nodiscard]] geraf2::RayWeights<float> out() { return {alpha, transmittance, weight, depth}; }
};

/// Samples and bytes: `arrays` of float a sample are read or written.
void report(benchmark::State& state, const Case& c, index_t arrays) {
    const index_t samples = state.iterations() * c.n_rays * c.n_samples;
    state.SetItemsProcessed(samples);
    state.SetBytesProcessed(samples * arrays * static_cast<index_t>(sizeof(float)));
}

void BM_RayMarch(benchmark::State& state) {
    Case c(state);
    for (auto _ : state) {
        geraf2::ray_march_fwd<float>(c.samples(), c.out(), static_cast<int>(state.range(2)));
        benchmark::ClobberMemory();
    }
    report(state, c, 6);
    state.SetLabel(geraf2::simd_level_name(geraf2::simd_level()));
}

void BM_RayMarchBackward(benchmark::State& state) {
    Case c(state);
    geraf2::ray_march_fwd<float>(c.samples(), c.out(), 1);
    std::vector<float> sdf_grad(c.sdf.size());
    std::vector<float> cos_grad(c.sdf.size());
    for (auto _ : state) {
        benchmark::DoNotOptimize(geraf2::ray_march_bwd<float>(
            c.samples(), c.alpha, c.transmittance, {{}, {}, c.sdf, c.depth},
            static_cast<int>(state.range(2)), sdf_grad, cos_grad));
    }
    report(state, c, 8);
    state.SetLabel(geraf2::simd_level_name(geraf2::simd_level()));
}

void BM_RayMarchNaive(benchmark::State& state) {
    Case c(state);
    const auto phi = [](float x) { return 1.0F / (1.0F + std::exp(-84.0F * x)); };
    for (auto _ : state) {
        for (std::size_t ray = 0; ray < c.depth.size(); ++ray) {
            float t = 1.0F;
            float u = 0.0F;
            c.depth[ray] = 0.0F;
            for (index_t k = 0; k < c.n_samples; ++k) {
                const std::size_t i =
                    ray * static_cast<std::size_t>(c.n_samples) + static_cast<std::size_t>(k);
                const float half = 0.5F * std::fmin(c.cos[i], 0.0F) * c.step[i];
                const float near = phi(c.sdf[i] - half);
                c.alpha[i] = (near - phi(c.sdf[i] + half)) / near;
                c.transmittance[i] = t;
                c.weight[i] = t * c.alpha[i];
                c.depth[ray] += c.weight[i] * (u + 0.5F * c.step[i]);
                u += c.step[i];
                t *= 1.0F - c.alpha[i];
            }
        }
        benchmark::ClobberMemory();
    }
    report(state, c, 6);
    state.SetLabel("plain loops");
}

void size(benchmark::internal::Benchmark* b) {
    b->ArgNames({"rays", "samples", "threads"})->Args({1024, 32, 1})->Unit(benchmark::kMicrosecond);
}

/// Two threads against one: compare real times, on an idle machine.
void thread_counts(benchmark::internal::Benchmark* b) {
    b->ArgNames({"rays", "samples", "threads"})->Unit(benchmark::kMicrosecond);
    b->ArgsProduct({{16384}, {64}, {1, 2}})->UseRealTime();
}

BENCHMARK(BM_RayMarchNaive)->Apply(size);
BENCHMARK(BM_RayMarch)->Apply(size);
BENCHMARK(BM_RayMarchBackward)->Apply(size);
BENCHMARK(BM_RayMarch)->Apply(thread_counts);
BENCHMARK(BM_RayMarchBackward)->Apply(thread_counts);

} // namespace
