// SPDX-License-Identifier: Apache-2.0
// Densities of pairs of peaks beside a loop over all pairs.
#include <benchmark/benchmark.h>

#include <cmath>
#include <numbers>
#include <random>
#include <vector>

#include "geraf2/pair_density.hpp"

namespace {

using geraf2::index_t;

constexpr index_t n_points = 3000;
constexpr geraf2::PairModel model{.reach = 0.04,
                                  .least_cosine = 0.5,
                                  .spread = 0.02,
                                  .offset_variance = 4e-6,
                                  .bend = 60.0,
                                  .turn_variance = 0.125,
                                  .curvature = 8.0,
                                  .least_density = 1e-3};

/// Points of a ball of 6 cm with its normals, as 24 planes of 9 sub-apertures see them.
struct Ball {
    std::vector<double> positions, normals;
    std::vector<index_t> planes, subapertures;

    Ball() {
        std::mt19937_64 random(5);
        std::normal_distribution<double> normal;
        for (index_t i = 0; i < n_points; ++i) {
            const double x = normal(random), y = normal(random), z = normal(random);
            const double length = std::sqrt(x * x + y * y + z * z);
            normals.insert(normals.end(), {x / length, y / length, z / length});
            planes.push_back(i % 24);
            subapertures.push_back(i % (24 * 9));
        }
        for (const double value : normals) {
            positions.push_back(0.06 * value);
        }
    }

    [[nodiscard]] geraf2::PeakPoints points() const {
        return {positions, normals, planes, subapertures};
    }
};

void pairs(benchmark::State& state) {
    const Ball ball;
    for (auto _ : state) {
        benchmark::DoNotOptimize(geraf2::pair_densities(ball.points(), ball.points(), model));
    }
}

void naive(benchmark::State& state) {
    const Ball ball;
    const auto& p = ball.positions;
    const auto& n = ball.normals;
    for (auto _ : state) {
        double sum = 0.0;
        for (std::size_t i = 0; i < p.size(); i += 3) {
            for (std::size_t j = 0; j < p.size(); j += 3) {
                double square = 0.0, cosine = 0.0, along = 0.0;
                for (std::size_t axis = 0; axis < 3; ++axis) {
                    const double step = p[j + axis] - p[i + axis];
                    square += step * step;
                    cosine += n[i + axis] * n[j + axis];
                    along += step * (n[i + axis] + n[j + axis]);
                }
                if (square > model.reach * model.reach || !(cosine > model.least_cosine) ||
                    ball.subapertures[i / 3] == ball.subapertures[j / 3]) {
                    continue;
                }
                const double offset2 = along * along / (2.0 + 2.0 * cosine);
                const double s_offset2 =
                    model.offset_variance + std::pow(model.bend * std::pow(square, 1.5), 2);
                const double s_turn2 = model.turn_variance + std::pow(model.curvature, 2) * square;
                const double spread2 = model.spread * model.spread;
                const double turn = 2.0 * std::numbers::pi;
                sum += std::exp(-0.5 * (offset2 / s_offset2 + (2.0 - 2.0 * cosine) / s_turn2 +
                                        (square - offset2) / spread2)) /
                       (std::sqrt(turn * s_offset2) * turn * s_turn2 * turn * spread2);
            }
        }
        benchmark::DoNotOptimize(sum);
    }
}

BENCHMARK(pairs)->Unit(benchmark::kMillisecond);
BENCHMARK(naive)->Unit(benchmark::kMillisecond);

} // namespace
