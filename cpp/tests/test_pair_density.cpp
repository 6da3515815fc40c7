// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "geraf2/pair_density.hpp"

using geraf2::index_t;
using geraf2::pair_densities;
using geraf2::PairModel;
using geraf2::PeakPoints;

namespace {

const PairModel model{0.02, 0.5, 0.011, 4e-6, 60.0, 0.125, 8.0, 0.0};

/// Points on a plane of constant z, in a line.
struct Line {
    std::vector<double> positions, normals;
    std::vector<index_t> planes, subapertures;

    Line(index_t n_points, double step) {
        for (index_t k = 0; k < n_points; ++k) {
            positions.insert(positions.end(), {step * static_cast<double>(k), 0.0, 0.0});
            normals.insert(normals.end(), {0.0, 0.0, 1.0});
            planes.push_back(k % 2);
            subapertures.push_back(k);
        }
    }
    PeakPoints view() const { return {positions, normals, planes, subapertures}; }
};

} // namespace

TEST_CASE("a point predicts those in reach, of its own plane in the last columns") {
    const Line line(5, 0.009);
    const auto rows = pair_densities(line.view(), line.view(), model);
    CHECK(rows.starts == std::vector<index_t>{0, 2, 5, 9, 12, 14});
    // The third point: its neighbours at one step are of the other plane, those at two of its own.
    std::vector<bool> seen(10);
    for (index_t at = rows.starts[2]; at < rows.starts[3]; ++at) {
        seen[static_cast<std::size_t>(rows.columns[static_cast<std::size_t>(at)])] = true;
    }
    CHECK(seen ==
          std::vector<bool>{false, true, false, true, false, true, false, false, false, true});
}

TEST_CASE("at the same place a point predicts the largest density") {
    Line one(1, 0.0);
    const Line other(1, 0.0);
    one.subapertures[0] = 7;
    const double turn = 2.0 * std::numbers::pi;
    const double largest = 1.0 / (std::sqrt(turn * 4e-6) * turn * 0.125 * turn * 0.011 * 0.011);
    const auto rows = pair_densities(one.view(), other.view(), model);
    REQUIRE(rows.densities.size() == 1);
    CHECK(rows.densities[0] == doctest::Approx(largest).epsilon(1e-12));
    one.subapertures[0] = 0;
    CHECK(pair_densities(one.view(), other.view(), model).densities.empty());
}

TEST_CASE("positions far from everything, and none at all, do no harm") {
    Line line(2, 0.001);
    line.positions[0] = std::numeric_limits<double>::max();
    CHECK(pair_densities(line.view(), line.view(), model).densities.empty());
    const Line nothing(0, 0.0);
    CHECK(pair_densities(nothing.view(), line.view(), model).starts == std::vector<index_t>{0});
    CHECK(pair_densities(line.view(), nothing.view(), model).starts ==
          std::vector<index_t>{0, 0, 0});
}
