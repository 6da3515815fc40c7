// SPDX-License-Identifier: Apache-2.0
// Grid interpolation in both precisions: planes and parabolas, adjointness, threads.
#include <doctest/doctest.h>

#include <cmath>
#include <random>
#include <vector>

#include "geraf2/sdf_grid.hpp"

using namespace geraf2;

TEST_CASE_TEMPLATE("spreading is the adjoint of sampling", T, float, double) {
    const VoxelGrid grid{{0.0, -0.1, 0.2}, 0.05, {5, 4, 6}};
    constexpr std::size_t n = 7001; // enough for three threads, and no whole chunks
    std::mt19937_64 random(3);
    std::uniform_real_distribution<double> uniform(-1.0, 1.0);
    std::vector<T> values(5 * 4 * 6);
    std::vector<T> value_grad(n);
    std::vector<T> gradient_grad(3 * n);
    std::vector<double> points;
    for (auto* part : {&values, &value_grad, &gradient_grad}) {
        for (T& v : *part) {
            v = static_cast<T>(uniform(random));
        }
    }
    for (std::size_t i = 0; i < 3 * n; ++i) {
        const double at = 0.1 + 0.2 * uniform(random);
        // Some on voxels, where rounding decides which cell they are of.
        points.push_back(i % 7 == 0 ? 0.05 * std::round(at / 0.05) : at);
    }
    for (const auto kind : {GridInterpolation::linear, GridInterpolation::cubic}) {
        std::vector<T> value(n);
        std::vector<T> gradient(3 * n);
        sdf_grid_fwd<T>(values, grid, points, kind, 2, {value, gradient, {}});
        std::vector<T> one(values.size());
        std::vector<T> three(values.size());
        sdf_grid_bwd<T>(value_grad, gradient_grad, grid, points, kind, 1, one);
        sdf_grid_bwd<T>(value_grad, gradient_grad, grid, points, kind, 3, three);
        CHECK(one == three);
        double sampled = 0.0;
        double spread = 0.0;
        for (std::size_t i = 0; i < n; ++i) {
            sampled += static_cast<double>(value[i]) * static_cast<double>(value_grad[i]);
        }
        for (std::size_t i = 0; i < 3 * n; ++i) {
            sampled += static_cast<double>(gradient[i]) * static_cast<double>(gradient_grad[i]);
        }
        for (std::size_t i = 0; i < values.size(); ++i) {
            spread += static_cast<double>(values[i]) * static_cast<double>(one[i]);
        }
        CHECK(sampled == doctest::Approx(spread).epsilon(1e-4));
    }
}

TEST_CASE("the same whatever is wanted beside it, and NaN stays NaN") {
    const VoxelGrid grid{{0.0, 0.0, 0.0}, 1.0, {1, 3, 4}};
    const std::vector<double> values{1.0, 2.0, 4.0, 8.0, 3.0, 5.0, 7.0, 9.0, 0.0, 6.0, 1.0, 2.0};
    const std::vector<double> points{0.0, 0.5, 2.25, 0.3, 1e300, -1e300, 0.0, std::nan(""), 1.0};
    for (const auto kind : {GridInterpolation::linear, GridInterpolation::cubic}) {
        std::vector<double> alone(3);
        std::vector<double> value(3);
        std::vector<double> gradient(9);
        std::vector<double> hessian(18);
        sdf_grid_fwd<double>(values, grid, points, kind, 1, {alone, {}, {}});
        sdf_grid_fwd<double>(values, grid, points, kind, 1, {value, gradient, hessian});
        for (std::size_t i = 0; i < 2; ++i) {
            CHECK(alone[i] == doctest::Approx(value[i]).epsilon(1e-14));
        }
        CHECK(alone[1] == 0.0);
        CHECK(gradient[4] == 0.0);
        CHECK(std::isnan(alone[2]));
        CHECK(std::isnan(value[2]));
    }
}
