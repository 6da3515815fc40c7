from dataclasses import replace

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from geraf2.apps.inspection.registration import (
    MIN_ECHOES,
    echoes_of,
    register,
    surface_evidence_of,
)
from geraf2.geometry.transforms import apply_rigid
from geraf2.geometry.triangles import unit_normals
from geraf2.io.mesh import TriangleMesh
from helpers.glint_sets import glints_at
from helpers.inspected import POSE, block, measured_body, wedge
from helpers.solids import triangles


def angle_deg(pose, true=POSE):
    return np.rad2deg(Rotation.from_matrix(pose[:3, :3] @ true[:3, :3].T).magnitude())


def test_a_part_is_found_from_nowhere_with_its_far_side_filled():
    model = wedge()
    placement = register(surface_evidence_of(measured_body(model, unseen=(0, 1, 0)), None), model)
    middle = model.vertices.mean(axis=0)
    off = apply_rigid(placement.pose, middle) - apply_rigid(POSE, middle)
    assert np.abs(off).max() < 5e-4
    assert angle_deg(placement.pose) < 0.7
    assert (np.abs(off) < 3.5 * placement.position_sigma_m + 1e-4).all()
    assert placement.free_axis is None
    assert placement.rival_misfit > 1.2 * placement.misfit


def test_errors_of_the_pose_are_as_large_as_stated():
    """Displacements that patches of a centimetre share; from the true pose, 12 draws."""
    model = wedge()
    clean = measured_body(model, sigma_m=0.0)
    axes = np.linalg.svd(clean.mesh.vertices - clean.mesh.vertices.mean(axis=0))[2]
    normals = np.asarray(trimesh.Trimesh(clean.mesh.vertices, clean.mesh.faces).vertex_normals)
    cells = np.floor(clean.mesh.vertices @ axes.T / 0.01).astype(int)
    facing = np.rint(normals @ axes.T)
    patch = np.unique(np.c_[cells, facing], axis=0, return_inverse=True)[1].reshape(-1)
    rng, pulls = np.random.default_rng(2), []
    for seed in range(12):
        shift = 5e-4 * rng.normal(size=patch.max() + 1)[patch]
        vertices = clean.mesh.vertices + shift[:, None] * normals
        body = measured_body(model)
        moved = TriangleMesh(vertices=vertices, faces=clean.mesh.faces)
        body = replace(body, mesh=moved)
        found = register(surface_evidence_of(body, None), model, start=POSE, seed=seed)
        off = found.middle_m - apply_rigid(
            POSE, apply_rigid(np.linalg.inv(found.pose), found.middle_m)
        )
        pulls.append(off / found.position_sigma_m)
    # 36 numbers of deviation one would lie in 0.8 to 1.2; patches are not all alike.
    assert 0.5 < np.sqrt(np.mean(np.square(pulls))) < 1.6


def test_the_turn_of_a_turned_part_is_free():
    model = triangles(trimesh.creation.cylinder(radius=0.015, height=0.07, sections=64).subdivide())
    placement = register(surface_evidence_of(measured_body(model, sigma_m=2e-4), None), model)
    axis = POSE[:3, 2]
    assert abs(np.dot(placement.free_axis, axis)) > 0.99
    assert abs(placement.pose[:3, 2] @ axis) > 0.9998
    assert placement.rival_misfit is None or placement.rival_misfit > 1.5 * placement.misfit


def test_many_echoes_set_the_pose_and_few_do_not():
    """The fitted surface is 1.5 mm thicker on one side than the echoes from the part say."""
    model = block((0.06, 0.04, 0.02), edge_m=0.002)
    body = measured_body(model, np.eye(4), sigma_m=1e-5)
    x = model.vertices[:, 0]
    thick = model.vertices + np.outer(0.0015 * (x > 0.0299), [1.0, 0, 0])
    body = replace(body, mesh=TriangleMesh(vertices=thick, faces=model.faces))
    positions, normals = model.corners.mean(axis=1), unit_normals(model.corners)
    found = []
    for n in (MIN_ECHOES - 1, 3000):
        some = np.random.default_rng(1).permutation(len(positions))[:n]
        glints = glints_at(positions[some], normals[some])
        joined, echoes = surface_evidence_of(body, glints), echoes_of(body, glints)
        placement = register(joined, model, echoes=echoes, start=np.eye(4))
        assert placement.by_echoes == (n >= MIN_ECHOES)
        found.append(placement.pose[0, 3])
    assert found[0] > 3e-4
    assert abs(found[1]) < 5e-5
    assert echoes_of(body, glints_at(np.ones((3, 3)), np.eye(3))) is None
