// SPDX-License-Identifier: Apache-2.0
#include <cstdint>
#include <memory>

#include "arrays.hpp"
#include "geraf2/mesh_scene.hpp"
#include "geraf2/types.hpp"

namespace geraf2::bindings {

void bind_mesh_scene(py::module_& m) {
    py::class_<MeshScene>(m, "MeshScene")
        .def(py::init([](const Doubles& vertices, const Array<index_t>& faces) {
                 require_shape("vertices", vertices, {-1, 3});
                 require_shape("faces", faces, {-1, 3});
                 const py::gil_scoped_release nogil;
                 return std::make_unique<MeshScene>(view(vertices), view(faces));
             }),
             py::arg("vertices").noconvert(), py::arg("faces").noconvert())
        .def(
            "closest_hit",
            [](const MeshScene& scene, const Doubles& origins, const Doubles& directions,
               int num_threads) {
                require_shape("origins", origins, {-1, 3});
                require_shape("directions", directions, {origins.shape(0), 3});
                auto distances = make_array<double>({origins.shape(0)});
                auto hit_faces = make_array<index_t>({origins.shape(0)});
                const auto distances_view = mutable_view(distances);
                const auto faces_view = mutable_view(hit_faces);
                {
                    const py::gil_scoped_release nogil;
                    scene.closest_hit(view(origins), view(directions), distances_view, faces_view,
                                      num_threads);
                }
                return py::make_tuple(distances, hit_faces);
            },
            py::arg("origins").noconvert(), py::arg("directions").noconvert(),
            py::arg("num_threads"))
        .def(
            "first_meetings",
            [](const MeshScene& scene, const Doubles& origins, const Doubles& targets,
               int num_threads) {
                require_shape("origins", origins, {-1, 3});
                require_shape("targets", targets, {origins.shape(0), 3});
                auto places = make_array<double>({origins.shape(0), 3});
                const auto out = mutable_view(places);
                {
                    const py::gil_scoped_release nogil;
                    scene.first_meetings(view(origins), view(targets), out, num_threads);
                }
                return places;
            },
            py::arg("origins").noconvert(), py::arg("targets").noconvert(), py::arg("num_threads"))
        .def(
            "spans",
            [](const MeshScene& scene, const Doubles& origins, const Doubles& directions,
               bool wound_outward, int num_threads) {
                require_shape("origins", origins, {-1, 3});
                require_shape("directions", directions, {origins.shape(0), 3});
                auto near = make_array<double>({origins.shape(0)});
                auto far = make_array<double>({origins.shape(0)});
                const auto to_near = mutable_view(near);
                const auto to_far = mutable_view(far);
                {
                    const py::gil_scoped_release nogil;
                    scene.spans(view(origins), view(directions), wound_outward, to_near, to_far,
                                num_threads);
                }
                return py::make_tuple(near, far);
            },
            py::arg("origins").noconvert(), py::arg("directions").noconvert(),
            py::arg("wound_outward"), py::arg("num_threads"))
        .def(
            "occluded",
            [](const MeshScene& scene, const Doubles& origins, const Doubles& targets,
               double margin_m, int num_threads) {
                require_shape("origins", origins, {-1, 3});
                require_shape("targets", targets, {origins.shape(0), 3});
                auto blocked = make_array<std::uint8_t>({origins.shape(0)});
                const auto blocked_view = mutable_view(blocked);
                {
                    const py::gil_scoped_release nogil;
                    scene.occluded(view(origins), view(targets), margin_m, blocked_view,
                                   num_threads);
                }
                return blocked;
            },
            py::arg("origins").noconvert(), py::arg("targets").noconvert(), py::arg("margin_m"),
            py::arg("num_threads"))
        .def(
            "crossings",
            [](const MeshScene& scene, const Doubles& origins, const Doubles& directions,
               int num_threads) {
                require_shape("origins", origins, {-1, 3});
                require_shape("directions", directions, {origins.shape(0), 3});
                Crossings found;
                {
                    const py::gil_scoped_release nogil;
                    found = scene.crossings(view(origins), view(directions), num_threads);
                }
                return py::make_tuple(copy_array(found.offsets), copy_array(found.distances),
                                      copy_array(found.entering));
            },
            py::arg("origins").noconvert(), py::arg("directions").noconvert(),
            py::arg("num_threads"))
        .def(
            "distance",
            [](const MeshScene& scene, const Doubles& points, int num_threads) {
                require_shape("points", points, {-1, 3});
                auto distances = make_array<double>({points.shape(0)});
                const auto distances_view = mutable_view(distances);
                {
                    const py::gil_scoped_release nogil;
                    scene.distance(view(points), distances_view, num_threads);
                }
                return distances;
            },
            py::arg("points").noconvert(), py::arg("num_threads"))
        .def(
            "signed_distance",
            [](const MeshScene& scene, const Doubles& points, int num_threads) {
                require_shape("points", points, {-1, 3});
                auto distances = make_array<double>({points.shape(0)});
                const auto distances_view = mutable_view(distances);
                {
                    const py::gil_scoped_release nogil;
                    scene.signed_distance(view(points), distances_view, num_threads);
                }
                return distances;
            },
            py::arg("points").noconvert(), py::arg("num_threads"))
        .def(
            "contains",
            [](const MeshScene& scene, const Doubles& points, int num_threads) {
                require_shape("points", points, {-1, 3});
                auto inside = make_array<std::uint8_t>({points.shape(0)});
                const auto inside_view = mutable_view(inside);
                {
                    const py::gil_scoped_release nogil;
                    scene.contains(view(points), inside_view, num_threads);
                }
                return inside;
            },
            py::arg("points").noconvert(), py::arg("num_threads"))
        .def(
            "winding_number",
            [](const MeshScene& scene, const Doubles& points, int num_threads) {
                require_shape("points", points, {-1, 3});
                auto winding = make_array<double>({points.shape(0)});
                const auto winding_view = mutable_view(winding);
                {
                    const py::gil_scoped_release nogil;
                    scene.winding_number(view(points), winding_view, num_threads);
                }
                return winding;
            },
            py::arg("points").noconvert(), py::arg("num_threads"));
}

} // namespace geraf2::bindings
