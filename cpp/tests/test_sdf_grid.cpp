// SPDX-License-Identifier: Apache-2.0
// Grid interpolation in both precisions: planes and parabolas, adjointness, threads.
#include <doctest/doctest.h>

#include <random>
#include <vector>

#include "geraf2/sdf_grid.hpp"

using namespace geraf2;

TEST_CASE_TEMPLATE("spreading is the adjoint of sampling", T, float, double) {
    const VoxelGrid grid{{0.0, -0.1, 0.2}, 0.05, {5, 4, 6}};
    std::mt19937_64 random(3);
    std::uniform_real_distribution<double> uniform(-1.0, 1.0);
    std::vector<T> values(5 * 4 * 6);
    std::vector<T> value_grad(50);
    std::vector<T> gradient_grad(150);
    std::vector<double> points;
    for (auto* part : {&values, &value_grad, &gradient_grad}) {
        for (T& v : *part) {
            v = static_cast<T>(uniform(random));
        }
    }
    for (int i = 0; i < 150; ++i) {
        points.push_back(0.1 + 0.2 * uniform(random));
    }
    for (const auto kind : {GridInterpolation::linear, GridInterpolation::cubic}) {
        std::vector<T> value(50);
        std::vector<T> gradient(150);
        sdf_grid_fwd<T>(values, grid, points, kind, 2, {value, gradient, {}});
        std::vector<T> one(values.size());
        std::vector<T> three(values.size());
        sdf_grid_bwd<T>(value_grad, gradient_grad, grid, points, kind, 1, one);
        sdf_grid_bwd<T>(value_grad, gradient_grad, grid, points, kind, 3, three);
        CHECK(one == three);
        double sampled = 0.0;
        double spread = 0.0;
        for (std::size_t i = 0; i < 50; ++i) {
            sampled += static_cast<double>(value[i] * value_grad[i]);
        }
        for (std::size_t i = 0; i < 150; ++i) {
            sampled += static_cast<double>(gradient[i] * gradient_grad[i]);
        }
        for (std::size_t i = 0; i < values.size(); ++i) {
            spread += static_cast<double>(values[i] * one[i]);
        }
        CHECK(sampled == doctest::Approx(spread).epsilon(1e-4));
    }
}
