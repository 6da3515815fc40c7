import numpy as np
import pytest
import trimesh

from geraf2.fields import SdfGrid
from geraf2.io.mesh import Evidence, TriangleMesh
from geraf2.scene import Grid, LosPrior, Wall
from geraf2.surfaces.extraction import box_surface, content_surface, extract_meshes
from geraf2.surfaces.isosurface import (
    extract_surface,
    largest_components,
    redistance,
    signed_distances,
    surface_report,
)
from helpers.glint_sets import glints_on_sphere
from reference.visibility import solid_angle_winding

GRID = Grid(origin_m=(-0.06, -0.05, -0.07), spacing_m=0.004, shape=(31, 27, 36))


def ball(grid, center, radius):
    return (np.linalg.norm(grid.points() - center, axis=1) - radius).reshape(grid.shape)


def sdf(values, grid=GRID):
    return SdfGrid(grid=grid, values=values.astype(np.float32))


def test_sphere_surface_is_metric_closed_and_wound_outwards():
    center, radius = np.array([0.003, -0.001, 0.002]), 0.035
    mesh = extract_surface(sdf(ball(GRID, center, radius)))
    error = np.linalg.norm(mesh.vertices - center, axis=1) - radius
    # linear interpolation along an edge of length h errs by at most h^2 / (8 r) = 6e-5 m
    assert np.abs(error).max() < 6e-5
    report = surface_report(mesh)
    assert report.is_watertight
    assert report.n_components == 1
    # facets cut the corners: volume below the ball's by up to 3 h^2 / (8 r^2) = 0.5 %
    assert report.volume_m3 == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.01)
    assert report.area_m2 == pytest.approx(4 * np.pi * radius**2, rel=0.01)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_plane_is_exact_for_any_gradient(axis):
    coordinate = GRID.points()[:, axis].reshape(GRID.shape)
    mesh = extract_surface(sdf(0.3 * (coordinate - 0.0123)))
    # float32 indices up to 36 times 4 mm: 36 * 2^-24 * 0.004 = 9e-9 m, and the samples' rounding
    np.testing.assert_allclose(mesh.vertices[:, axis], 0.0123, atol=1e-7)
    assert not surface_report(mesh).is_watertight  # it runs into the grid's border


def test_an_open_or_badly_wound_surface_is_not_watertight():
    cube = LosPrior.from_box((1.0, 1.0, 1.0))
    assert surface_report(TriangleMesh(vertices=cube.vertices, faces=cube.faces)).is_watertight
    hole = TriangleMesh(vertices=cube.vertices, faces=cube.faces[1:])
    assert not surface_report(hole).is_watertight
    twisted = cube.faces.copy()
    twisted[0] = twisted[0, ::-1]
    assert not surface_report(TriangleMesh(vertices=cube.vertices, faces=twisted)).is_watertight


def test_holes_are_counted_over_all_pieces():
    solids = [
        trimesh.creation.torus(0.03, 0.01),
        trimesh.creation.torus(0.02, 0.004).apply_translation([0.0, 0.0, 0.1]),
        trimesh.creation.icosphere(subdivisions=1, radius=0.01).apply_translation([0.0, 0.1, 0.0]),
    ]
    both = trimesh.util.concatenate(solids)
    report = surface_report(TriangleMesh(vertices=both.vertices, faces=both.faces))
    assert (report.n_components, report.n_holes) == (3, 2)
    is_open = surface_report(TriangleMesh(vertices=both.vertices, faces=both.faces[1:]))
    assert is_open.n_holes is None


def test_redistancing_gives_unit_gradient_and_leaves_the_zero_level():
    center, radius = np.array([0.001, 0.002, -0.003]), 0.03
    true = ball(GRID, center, radius)
    # A warped field with the same zero level: gradient 0.2 to 0.7, as the surface fit leaves it.
    warped = sdf(true * (0.45 + 0.25 * np.sin(40 * GRID.points()[:, 0]).reshape(GRID.shape)))
    fixed = redistance(warped)
    # Interpolation errs by h^2 / 8 times the second derivative over the first: 1 / r = 33 per
    # metre for the sphere, 2 * 10 / 0.45 = 44 for the warp; facets cut h^2 / (8 r) more.
    error, exact = np.abs(fixed.values - true), np.abs(true) < 3.0 * GRID.spacing_m
    assert error[exact].max() < 0.004**2 / 8 * (33 + 44 + 33)
    assert error.max() < 2.0 * GRID.spacing_m  # at the middle of the ball
    assert np.quantile(error, 0.95) < 0.15 * GRID.spacing_m
    before, after = extract_surface(warped), extract_surface(fixed)
    shift = signed_distances(before, after.vertices)
    assert np.abs(shift).max() < 4e-5
    assert abs(shift.mean()) < 2e-6  # distances to the facets alone would give -4e-5 m
    gradient = np.linalg.norm(np.gradient(fixed.values.astype(float), GRID.spacing_m), axis=0)
    near = (np.abs(true) < 0.012) & (np.abs(true) > 1e-4)
    assert np.abs(gradient[near] - 1).max() < 0.06


def test_voids_are_dropped_since_a_radar_cannot_see_them():
    values = np.maximum(ball(GRID, np.zeros(3), 0.04), -ball(GRID, np.zeros(3), 0.02))
    mesh = largest_components(extract_surface(sdf(values)))
    assert np.linalg.norm(mesh.vertices, axis=1).min() > 0.039
    assert surface_report(mesh).n_components == 1


WALL = Wall(size_m=(0.11, 0.10, 0.12), thickness_m=0.004, permittivity=1.6)
PRIOR = LosPrior.from_box(WALL.size_m, WALL.center_m, (WALL,))


def test_box_and_content_are_separated_and_joined():
    radius = 0.03
    meshes = extract_meshes(
        sdf(ball(GRID, np.zeros(3), radius)), glints_on_sphere(radius, 200), PRIOR
    )
    mesh, box, content = meshes[:3]
    assert surface_report(content).is_watertight
    assert np.linalg.norm(content.vertices, axis=1).max() == pytest.approx(radius, abs=1e-4)
    assert content.expected_error_m.min() > 0
    assert (content.evidence == Evidence.SEEN).mean() > 0.6  # 200 glints on 113 cm^2: 75 %
    report = surface_report(box)
    assert report.is_watertight
    outer, inner = 0.11 * 0.10 * 0.12, 0.102 * 0.092 * 0.112
    assert report.volume_m3 == pytest.approx(outer - inner, rel=1e-9)
    assert box.expected_error_m is None  # it was given, not found
    assert mesh.faces.shape[0] == box.faces.shape[0] + content.faces.shape[0]
    # negative in the wall and in the content, positive in the air between them
    probes = np.array([[0.053, 0, 0], [0, 0, 0], [0.042, 0, 0], [0.07, 0, 0]])
    winding = solid_angle_winding(mesh.vertices, mesh.faces, probes)
    np.testing.assert_allclose(winding, [1, 1, 0, 0], atol=1e-6)


def test_content_that_meets_the_wall_is_cut_there_and_stays_closed():
    content = content_surface(sdf(ball(GRID, [0.035, 0, 0], 0.03)), PRIOR)
    assert content.vertices[:, 0].max() == pytest.approx(0.051, abs=2e-4)
    assert surface_report(content).is_watertight


def test_a_round_prior_gets_an_inner_face_one_thickness_inside():
    shell = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    wall = Wall(size_m=(0.2, 0.2, 0.2), thickness_m=0.005, permittivity=2.0)
    prior = LosPrior(vertices=np.array(shell.vertices), faces=np.array(shell.faces), walls=(wall,))
    box = box_surface(prior)
    inner = box.vertices[len(prior.vertices) :]
    np.testing.assert_allclose(np.linalg.norm(inner, axis=1), 0.095, atol=3e-4)
    assert surface_report(box).is_watertight
    assert surface_report(box).volume_m3 == pytest.approx(
        4 / 3 * np.pi * (0.1**3 - 0.095**3), rel=0.03
    )


def test_nested_walls_are_both_drawn_and_without_walls_there_is_an_outer_surface_alone():
    assert len(box_surface(LosPrior.from_box(WALL.size_m)).faces) == 12
    inner_wall = Wall(size_m=(0.06, 0.05, 0.07), thickness_m=0.002, permittivity=1.6)
    prior = LosPrior.from_box(WALL.size_m, walls=(WALL, inner_wall))
    report = surface_report(box_surface(prior))
    assert report.n_components == 4
    expected = 0.11 * 0.10 * 0.12 - 0.102 * 0.092 * 0.112
    expected += 0.06 * 0.05 * 0.07 - 0.056 * 0.046 * 0.066
    assert report.volume_m3 == pytest.approx(expected, rel=1e-9)
