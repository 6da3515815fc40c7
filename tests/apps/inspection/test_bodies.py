import numpy as np
import pytest
import trimesh

from geraf2.apps.inspection.bodies import (
    COMMON_SHARE,
    ERROR_FACTOR,
    PATCH_M,
    Body,
    body_of,
    measure,
    split_bodies,
)
from geraf2.echoes.glint_set import Glints
from geraf2.geometry.transforms import apply_rigid
from geraf2.geometry.triangles import enclosed_volume_m3, vertex_areas, vertex_normals
from geraf2.io.mesh import TriangleMesh
from inspected import POSE, block, joined, measured

SIDES = (0.06, 0.04, 0.02)


def test_a_block_that_lies_askew_has_its_own_lengths():
    found = measure(measured(block(SIDES), sigma_m=0.0))
    assert [length.value for length in found.dimensions_m] == pytest.approx(SIDES, abs=1e-9)
    assert np.abs(np.array(found.axes) @ POSE[:3, :3]) == pytest.approx(np.eye(3), abs=1e-6)
    assert found.center_m == pytest.approx(tuple(POSE[:3, 3]), abs=1e-9)
    assert found.volume_m3.value == pytest.approx(np.prod(SIDES))
    assert found.area_m2.value == pytest.approx(2 * (24 + 12 + 8) * 1e-4)
    assert found.seen_fraction == 1.0


def test_an_error_moves_volume_area_and_middle_as_the_formulas_say():
    """A displacement that all places share, on a sphere: dV = A d, dA = 8 pi r d, dc = 0."""
    r, sigma = 0.03, 1e-5 * ERROR_FACTOR
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=r)
    mesh = TriangleMesh(vertices=np.asarray(sphere.vertices), faces=np.asarray(sphere.faces))
    n = len(mesh.vertices)
    body = Body(mesh=mesh, sigma_m=np.full(n, 1e-5), seen=np.ones(n, dtype=bool))
    found = measure(body)
    area = 4 * np.pi * r**2
    patches = (1 - COMMON_SHARE) * PATCH_M**2 * area
    assert found.volume_m3.sigma == pytest.approx(
        sigma * np.sqrt(COMMON_SHARE * area**2 + patches), rel=0.01
    )
    by_curvature = (2 / r) * np.sqrt(COMMON_SHARE * area**2 + patches)
    assert found.area_m2.sigma == pytest.approx(sigma * by_curvature, rel=0.02)
    # Only what differs from place to place moves the middle; the mean of cos^2 is 1/3.
    volume = area * r / 3
    assert found.center_sigma_m == pytest.approx(
        [sigma * np.sqrt(patches * r**2 / 3) / volume] * 3, rel=0.02
    )


def test_the_volume_of_patchwise_displaced_surfaces_scatters_as_stated():
    """Slow twin: surfaces whose patches of PATCH_M by PATCH_M, and all together, are displaced."""
    rng, sigma = np.random.default_rng(1), 2e-4
    mesh = block((0.05, 0.04, 0.03), edge_m=0.003)
    normals = vertex_normals(mesh.vertices, mesh.faces)
    areas = vertex_areas(mesh.vertices, mesh.faces)
    cells = np.floor(mesh.vertices / PATCH_M + 0.37).astype(int)
    _, patch = np.unique(np.column_stack([cells, np.rint(normals)]), axis=0, return_inverse=True)
    patch = patch.reshape(-1)
    volumes = []
    for _ in range(300):
        common = np.sqrt(COMMON_SHARE) * rng.normal()
        single = np.sqrt(1 - COMMON_SHARE) * rng.normal(size=patch.max() + 1)[patch]
        moved = mesh.vertices + (sigma * (common + single))[:, None] * normals
        volumes.append(enclosed_volume_m3(moved, mesh.faces))
    n = len(areas)
    stated = np.full(n, sigma / ERROR_FACTOR)
    body = Body(mesh=mesh, sigma_m=stated, seen=np.ones(n, dtype=bool))
    # 300 draws tell a spread to 4 %; patches at edges are smaller than PATCH_M squared.
    assert np.std(volumes) == pytest.approx(measure(body).volume_m3.sigma, rel=0.15)


def test_parts_come_apart_largest_first_and_crumbs_stay_out():
    three = joined(
        block((0.02, 0.02, 0.02), (0.05, 0, 0)), block(SIDES), block((0.002,) * 3, (0, 0, 0.05))
    )
    n = len(three.vertices)
    whole = Body(mesh=three, sigma_m=np.arange(n) * 1e-6, seen=np.arange(n) % 2 == 0)
    parts = split_bodies(whole)
    assert [len(p.mesh.faces) for p in parts] == [
        len(block(SIDES).faces),
        len(three.faces) - len(block(SIDES).faces) - len(block((0.002,) * 3).faces),
    ]
    at = int(np.flatnonzero((three.vertices == parts[0].mesh.vertices[7]).all(axis=1))[0])
    assert parts[0].sigma_m[7] == whole.sigma_m[at]
    assert parts[0].seen[7] == whole.seen[at]


def test_a_surface_without_errors_takes_them_from_the_glints():
    mesh = block(SIDES)
    up = np.flatnonzero(mesh.vertices[:, 2] > 0.0099)[:1]
    glints = Glints(
        positions=mesh.vertices[up] + [0, 0, 0.001],
        normals=np.array([[0.0, 0.0, 1.0]]),
        strengths=np.ones(1),
        position_sigma_m=np.full(1, 5e-4),
        normal_sigma_rad=np.full(1, 0.01),
        poses=np.zeros(1, dtype=np.int64),
    )
    body = body_of(mesh, glints)
    far = np.linalg.norm(mesh.vertices - glints.positions, axis=1) > 0.009
    assert body.seen.any()
    assert not body.seen[far].any()
    assert not body.seen[mesh.vertices[:, 2] < 0].any()
    assert (body.sigma_m[body.seen] < body.sigma_m[far].min()).all()
    assert apply_rigid(np.eye(4), mesh.vertices) == pytest.approx(body.mesh.vertices)
