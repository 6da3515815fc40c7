// SPDX-License-Identifier: Apache-2.0
// Ray and distance queries against a torus of 20,000 faces. Items are rays, segments or points; the
// peer asks every face, as a loop without a hierarchy does.
#include "geraf2/mesh_scene.hpp"

#include <benchmark/benchmark.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>
#include <span>
#include <vector>

namespace {

using geraf2::index_t;

constexpr index_t n_around = 100;
/// As many as the points of a coarse grid, or the rays of a plane's shadow.
constexpr std::size_t n_queries = 65536;

struct Case {
    std::vector<double> vertices, origins, directions;
    std::vector<index_t> faces;

    Case() {
        for (index_t i = 0; i < n_around; ++i) {
            for (index_t j = 0; j < n_around; ++j) {
                const double u = 2.0 * std::numbers::pi * static_cast<double>(i) / n_around;
                const double v = 2.0 * std::numbers::pi * static_cast<double>(j) / n_around;
                const double radius = 0.08 + 0.03 * std::cos(v);
                vertices.insert(vertices.end(),
                                {radius * std::cos(u), radius * std::sin(u), 0.03 * std::sin(v)});
                const index_t next_i = (i + 1) % n_around;
                const index_t next_j = (j + 1) % n_around;
                const index_t a = i * n_around + j;
                const index_t b = next_i * n_around + j;
                const index_t c = next_i * n_around + next_j;
                const index_t d = i * n_around + next_j;
                faces.insert(faces.end(), {a, b, c, a, c, d});
            }
        }
        std::mt19937_64 random(7);
        std::uniform_real_distribution<double> uniform(-0.12, 0.12);
        for (std::size_t i = 0; i < 3 * n_queries; ++i) {
            origins.push_back(uniform(random));
            directions.push_back(uniform(random));
        }
    }
};

template <class Query>
void measure(benchmark::State& state, const Query& query, std::size_t n = n_queries) {
    const Case c;
    const geraf2::MeshScene scene(c.vertices, c.faces);
    for (auto _ : state) {
        query(scene, c);
        benchmark::ClobberMemory();
    }
    state.SetItemsProcessed(state.iterations() * static_cast<index_t>(n));
}

void BM_ClosestHit(benchmark::State& state) {
    std::vector<double> distances(n_queries);
    std::vector<index_t> hit(n_queries);
    measure(state, [&](const auto& scene, const Case& c) {
        scene.closest_hit(c.origins, c.directions, distances, hit,
                          static_cast<int>(state.range(0)));
    });
}

void BM_Occluded(benchmark::State& state) {
    std::vector<std::uint8_t> blocked(n_queries);
    measure(state, [&](const auto& scene, const Case& c) {
        scene.occluded(c.origins, c.directions, 1e-5, blocked, static_cast<int>(state.range(0)));
    });
}

void BM_Crossings(benchmark::State& state) {
    measure(state, [&](const auto& scene, const Case& c) {
        benchmark::DoNotOptimize(
            scene.crossings(c.origins, c.directions, static_cast<int>(state.range(0))));
    });
}

void BM_SignedDistance(benchmark::State& state) {
    constexpr std::size_t few = n_queries / 8; // each takes five rays and a search
    std::vector<double> distances(few);
    measure(
        state,
        [&](const auto& scene, const Case& c) {
            scene.signed_distance(std::span(c.origins).first(3 * few), distances,
                                  static_cast<int>(state.range(0)));
        },
        few);
}

/// Nearest hit of one ray by Moeller and Trumbore's test of every face.
double nearest_hit(const Case& c, const double* origin, const double* direction) {
    double nearest = std::numeric_limits<double>::infinity();
    for (std::size_t f = 0; f < c.faces.size(); f += 3) {
        const double* corner[3];
        for (std::size_t k = 0; k < 3; ++k) {
            corner[k] = c.vertices.data() + 3 * c.faces[f + k];
        }
        double e1[3];
        double e2[3];
        double s[3];
        for (std::size_t k = 0; k < 3; ++k) {
            e1[k] = corner[1][k] - corner[0][k];
            e2[k] = corner[2][k] - corner[0][k];
            s[k] = origin[k] - corner[0][k];
        }
        const auto triple = [](const double* a, const double* b, const double* d) {
            return a[0] * (b[1] * d[2] - b[2] * d[1]) + a[1] * (b[2] * d[0] - b[0] * d[2]) +
                   a[2] * (b[0] * d[1] - b[1] * d[0]);
        };
        const double det = triple(e1, direction, e2);
        const double u = triple(s, direction, e2) / det;
        const double v = triple(direction, s, e1) / det;
        const double t = triple(e2, s, e1) / det;
        if (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t >= 0.0) {
            nearest = std::min(nearest, t);
        }
    }
    return nearest;
}

void BM_NaiveClosestHit(benchmark::State& state) {
    const Case c;
    constexpr std::size_t few = 64;
    for (auto _ : state) {
        for (std::size_t i = 0; i < few; ++i) {
            benchmark::DoNotOptimize(
                nearest_hit(c, c.origins.data() + 3 * i, c.directions.data() + 3 * i));
        }
    }
    state.SetItemsProcessed(state.iterations() * static_cast<index_t>(few));
}

/// One thread, and two against one: compare real times, on an idle machine.
void thread_counts(benchmark::internal::Benchmark* b) {
    b->ArgName("threads")->Arg(1)->Arg(2)->Unit(benchmark::kMillisecond)->UseRealTime();
}

BENCHMARK(BM_ClosestHit)->Apply(thread_counts);
BENCHMARK(BM_Occluded)->Apply(thread_counts);
BENCHMARK(BM_Crossings)->Apply(thread_counts);
BENCHMARK(BM_SignedDistance)->Apply(thread_counts);
BENCHMARK(BM_NaiveClosestHit)->Unit(benchmark::kMillisecond);

} // namespace
