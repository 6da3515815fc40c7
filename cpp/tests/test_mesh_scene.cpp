// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "failing_allocations.hpp"
#include "geraf2/mesh_scene.hpp"

using geraf2::index_t;
using geraf2::MeshScene;

namespace {

// Unit cube around the origin, wound counter-clockwise seen from outside.
MeshScene make_cube() {
    std::vector<double> vertices;
    for (const double x : {-0.5, 0.5}) {
        for (const double y : {-0.5, 0.5}) {
            for (const double z : {-0.5, 0.5}) {
                vertices.insert(vertices.end(), {x, y, z});
            }
        }
    }
    const std::vector<index_t> faces{0, 1, 3, 0, 3, 2, 4, 6, 7, 4, 7, 5, 0, 4, 5, 0, 5, 1,
                                     2, 3, 7, 2, 7, 6, 0, 2, 6, 0, 6, 4, 1, 5, 7, 1, 7, 3};
    return {vertices, faces};
}

} // namespace

TEST_CASE("a ray through the cube enters and leaves once") {
    const MeshScene cube = make_cube();
    // The second ray meets the diagonal shared by two triangles on both faces.
    const std::vector<double> origins{-2.0, 0.1, 0.2, -2.0, 0.0, 0.0};
    const std::vector<double> directions{3.0, 0.0, 0.0, 1.0, 0.0, 0.0};
    const auto crossings = cube.crossings(origins, directions, 1);
    REQUIRE(crossings.offsets == std::vector<index_t>{0, 2, 4});
    for (std::size_t ray = 0; ray < 2; ++ray) {
        CHECK(crossings.distances[2 * ray] == doctest::Approx(1.5));
        CHECK(crossings.distances[2 * ray + 1] == doctest::Approx(2.5));
        CHECK(crossings.entering[2 * ray] == 1);
        CHECK(crossings.entering[2 * ray + 1] == 0);
    }
}

TEST_CASE("a ray beside the cube hits nothing") {
    const MeshScene cube = make_cube();
    const std::vector<double> origin{-2.0, 0.6, 0.0};
    const std::vector<double> direction{1.0, 0.0, 0.0};
    std::vector<double> distance(1);
    std::vector<index_t> face(1);
    cube.closest_hit(origin, direction, distance, face, 1);
    CHECK(std::isinf(distance[0]));
    CHECK(face[0] == -1);
}

TEST_CASE("signed distance is negative inside") {
    const MeshScene cube = make_cube();
    const std::vector<double> points{0.0, 0.0, 0.0, 0.9, 0.0, 0.0, 0.8, 0.9, 0.5};
    std::vector<double> distances(3);
    cube.signed_distance(points, distances, 2);
    CHECK(distances[0] == doctest::Approx(-0.5));
    CHECK(distances[1] == doctest::Approx(0.4));
    CHECK(distances[2] == doctest::Approx(0.5));
}

TEST_CASE("the order of points does not matter to their distances") {
    const MeshScene cube = make_cube();
    const std::vector<double> points{0.0, 0.0, 0.0, 5.0, 0.0, 0.0, 0.9, 0.0, 0.0,
                                     0.5, 0.1, 0.2, 0.8, 0.9, 0.5, 0.5, 0.1, 0.2};
    const std::vector<double> expected{0.5, 4.5, 0.4, 0.0, 0.5, 0.0};
    std::vector<double> distances(6);
    cube.distance(points, distances, 2);
    for (std::size_t i = 0; i < 6; ++i) {
        CHECK(distances[i] == doctest::Approx(expected[i]));
    }
}

TEST_CASE("one and four threads agree exactly") {
    const MeshScene cube = make_cube();
    std::vector<double> points;
    for (int i = 0; i < 300; ++i) {
        points.push_back(std::sin(1.7 * i));
    }
    std::vector<double> one(100);
    std::vector<double> four(100);
    cube.signed_distance(points, one, 1);
    cube.signed_distance(points, four, 4);
    CHECK(one == four);
}

TEST_CASE("each allocation of crossings fails once") {
    // Embree corrupts its memory where an allocation of its own fails: the scene is there before,
    // and one thread, which has met it already, asks.
    const MeshScene cube = make_cube();
    std::vector<double> origins;
    std::vector<double> directions;
    for (int i = 0; i < 300; ++i) {
        origins.push_back(0.3 * std::sin(0.9 * i));
        directions.push_back(std::sin(1.3 * i + 1.0));
    }
    CHECK(fail_each_allocation([&] { return cube.crossings(origins, directions, 1).distances; }) >
          2);
}
