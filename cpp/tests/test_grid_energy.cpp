// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <random>
#include <vector>

#include "geraf2/grid_energy.hpp"

using geraf2::EnergyGrid;
using geraf2::GridEnergy;
using geraf2::index_t;

namespace {

const EnergyGrid grid{{7, 6, 21}, {0.5, 0.4, 0.3}};
constexpr std::size_t n_voxels = 7 * 6 * 21;

template <class T>
GridEnergy<T> make_energy(double bending, double diagonal) {
    static const std::vector<index_t> rows{3, 100};
    static const std::vector<index_t> starts{0, 2, 4};
    static const std::vector<std::int32_t> columns{3, 100, 3, 100};
    static const std::vector<double> values{2.0, -1.0, -1.0, 3.0};
    return GridEnergy<T>(grid, bending, {rows, starts, columns, values},
                         std::vector<double>(n_voxels, diagonal));
}

template <class T>
std::vector<T> noise(unsigned seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> uniform(-1.0, 1.0);
    std::vector<T> out(n_voxels);
    for (T& value : out) {
        value = static_cast<T>(uniform(random));
    }
    return out;
}

template <class T>
double dot(const std::vector<T>& a, const std::vector<T>& b) {
    double sum = 0.0;
    for (std::size_t i = 0; i < a.size(); ++i) {
        sum += static_cast<double>(a[i]) * static_cast<double>(b[i]);
    }
    return sum;
}

} // namespace

TEST_CASE_TEMPLATE("the matrix of a grid energy is symmetric", T, float, double) {
    const auto energy = make_energy<T>(0.7, 0.1);
    const auto a = noise<T>(1);
    const auto b = noise<T>(2);
    std::vector<T> image_a(n_voxels);
    std::vector<T> image_b(n_voxels);
    energy.apply(a, image_a, 1);
    energy.apply(b, image_b, 2);
    const double tolerance = sizeof(T) == 4 ? 1e-5 : 1e-13;
    CHECK(dot(a, image_b) == doctest::Approx(dot(b, image_a)).epsilon(tolerance));
}

TEST_CASE_TEMPLATE("a plane has no bending, its sparse part stays", T, float, double) {
    const auto energy = make_energy<T>(5.0, 0.0);
    std::vector<T> plane;
    for (index_t i = 0; i < 7; ++i) {
        for (index_t j = 0; j < 6; ++j) {
            for (index_t k = 0; k < 21; ++k) {
                plane.push_back(static_cast<T>(0.5 * static_cast<double>(i) -
                                               0.8 * static_cast<double>(j) +
                                               0.9 * static_cast<double>(k)));
            }
        }
    }
    std::vector<T> image(n_voxels);
    energy.apply(plane, image, 1);
    const double tolerance = sizeof(T) == 4 ? 1e-4 : 1e-12;
    for (std::size_t i = 0; i < n_voxels; ++i) {
        double expected = 0.0;
        if (i == 3) {
            expected = 2.0 * static_cast<double>(plane[3]) - static_cast<double>(plane[100]);
        } else if (i == 100) {
            expected = 3.0 * static_cast<double>(plane[100]) - static_cast<double>(plane[3]);
        }
        CHECK(std::abs(static_cast<double>(image[i]) - expected) < tolerance);
    }
}

TEST_CASE_TEMPLATE("smoothing lowers the energy, and stays at the solution", T, float, double) {
    const auto energy = make_energy<T>(0.1, 1.0);
    const auto solution = noise<T>(3);
    std::vector<T> right(n_voxels);
    energy.apply(solution, right, 1);
    auto field = solution;
    energy.smooth(right, {3, 0.3, 5.0}, 1, field);
    double change = 0.0;
    for (std::size_t i = 0; i < n_voxels; ++i) {
        change = std::max(change, std::abs(static_cast<double>(field[i] - solution[i])));
    }
    CHECK(change < (sizeof(T) == 4 ? 1e-5 : 1e-13));

    std::vector<T> zero(n_voxels);
    auto moved = noise<T>(4);
    std::vector<T> image(n_voxels);
    energy.apply(moved, image, 1);
    const double before = dot(moved, image);
    energy.smooth(zero, {3, 0.3, 5.0}, 1, moved);
    energy.apply(moved, image, 1);
    CHECK(dot(moved, image) < 0.1 * before);
}

TEST_CASE("a value that is not a number stays among its neighbours") {
    const auto energy = make_energy<double>(1.0, 1.0);
    std::vector<double> field(n_voxels);
    field[3 * 6 * 21 + 3 * 21 + 10] = std::numeric_limits<double>::quiet_NaN();
    std::vector<double> image(n_voxels);
    energy.apply(field, image, 1);
    CHECK(std::isnan(image[3 * 6 * 21 + 3 * 21 + 10]));
    CHECK_FALSE(std::isnan(image[0]));
}

TEST_CASE_TEMPLATE("no bit depends on the number of threads", T, float, double) {
    const auto energy = make_energy<T>(0.7, 0.1);
    const auto field = noise<T>(3);
    std::vector<T> one(n_voxels);
    energy.apply(field, one, 1);
    std::vector<T> smooth_one = field;
    energy.smooth(one, {3, 0.1, 4.0}, 1, smooth_one);
    for (const int threads : {2, 4}) {
        std::vector<T> product(n_voxels);
        energy.apply(field, product, threads);
        CHECK(product == one);
        std::vector<T> smooth = field;
        energy.smooth(one, {3, 0.1, 4.0}, threads, smooth);
        CHECK(smooth == smooth_one);
    }
}
