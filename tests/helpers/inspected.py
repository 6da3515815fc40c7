"""Parts with closed surfaces, as if they had been measured, for tests of inspections."""

from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from geraf2.apps.inspection import registration
from geraf2.apps.inspection.bodies import body_of
from geraf2.apps.inspection.registration import Placement
from geraf2.geometry.triangles import vertex_normals
from geraf2.io.mesh import TriangleMesh, write_mesh
from geraf2.io.planes import ScannedPlanes, save_planes
from geraf2.io.points import cloud_bytes
from geraf2.io.run_folder import (
    CONFIG_NAME,
    CONTENT_NAME,
    GLINTS_NAME,
    PEAKS_NAME,
    PLANES_NAME,
    PRIOR_NAME,
)
from geraf2.pipeline.presets import FastPreset
from geraf2.pipeline.prior import save_prior
from geraf2.pipeline.run_record import PriorSource, RunOptions, RunRecord
from geraf2.scene import LosPrior
from geraf2.scene.aperture import Aperture
from helpers.glint_sets import glints_at
from helpers.run_folders import record_run
from helpers.solids import joined, triangles

POSE = np.eye(4)
POSE[:3, :3] = Rotation.from_rotvec([0.4, -1.1, 2.0]).as_matrix()
POSE[:3, 3] = [0.012, -0.007, 0.02]


def block(sides_m, middle_m=(0.0, 0.0, 0.0), edge_m=0.004):
    """Block in fine triangles."""
    made = trimesh.creation.box(extents=sides_m)
    made = made.subdivide_to_size(edge_m, max_iter=20)
    made.merge_vertices()
    return triangles(made, middle_m)


def wedge(height_m=0.03):
    """Solid without any symmetry: a block with three of its upper corners moved."""
    made = block((0.06, 0.04, height_m))
    x, y, z = made.vertices.T
    up = z / height_m + 0.5
    moved = np.stack([x * (1.0 - 0.3 * up * (y > 0)), y * (1.0 - 0.35 * up), z + 0.25 * x * up], 1)
    return TriangleMesh(vertices=moved, faces=made.faces)


@contextmanager
def few_starts():
    """Search for poses with fewer starts and points: seconds less."""
    with pytest.MonkeyPatch.context() as patch:
        for name, number in (("N_STARTS", 16), ("_N_FINE", 200), ("_N_CAD_POINTS", 3000)):
            patch.setattr(registration, name, number)
        patch.setattr(registration, "_TABLE_CELLS", 16)
        yield


def placement(pose, covariance):
    """Pose with a covariance, without free axes or rivals."""
    known = {"pose": pose, "covariance": covariance, "middle_m": pose[:3, 3]}
    return Placement(**known, misfit=1.0, free_axis=None)


SMALL = block((0.02, 0.015, 0.03), (0.07, 0.0, 0.0))
CUBES = [block((0.02,) * 3, (x, 0.0, 0.0), 0.003) for x in (-0.05, 0.0, 0.05)]


def measured_body(mesh, pose=POSE, *, sigma_m=0.0005, unseen=None, seed=0):
    """Body of a mesh that was moved; errors of the stated size along its normals.

    unseen: directions in the mesh's frame whose side was filled, 4 mm off, with that uncertainty.
    """
    rng = np.random.default_rng(seed)
    normals = vertex_normals(mesh.vertices, mesh.faces)
    seen, off = np.ones(len(normals), dtype=bool), sigma_m * rng.normal(size=len(normals))
    if unseen is not None:
        seen = normals @ np.asarray(unseen) < 0.5
        off = np.where(seen, off, -0.004)
    vertices = (mesh.vertices + off[:, None] * normals) @ pose[:3, :3].T + pose[:3, 3]
    mesh = TriangleMesh(
        vertices=vertices, faces=mesh.faces, expected_error_m=np.where(seen, sigma_m, 0.004)
    )
    return replace(body_of(mesh), seen=seen)


def planes_around():
    """Twelve wide planes around the content, one above and one below."""
    turns = [Rotation.from_euler("z", 30.0 * k, degrees=True).as_matrix() for k in range(12)]
    turns += [Rotation.from_euler("y", angle, degrees=True).as_matrix() for angle in (-90, 90)]
    half = np.array([0.18, 0.18])
    return [Aperture.from_rectangle(turn @ [0.4, 0, 0], turn.T, half) for turn in turns]


def glints_of(body, apertures, *, seed=0, sigma_m=3e-4):
    """Returns from all of the surface, each seen by the plane that it faces."""
    mesh, rng = body.mesh, np.random.default_rng(seed)
    normals = vertex_normals(mesh.vertices, mesh.faces)
    facing = np.stack([aperture.axes[0] for aperture in apertures])
    off = sigma_m * rng.normal(size=(len(normals), 1))
    return replace(
        glints_at(mesh.vertices + off * normals, normals),
        poses=np.argmax(normals @ facing.T, axis=1),
    )


def run_of(out, *meshes, pose=POSE, box_m=(0.2, 0.2, 0.2), wavelength_m=0.0039, has_glints=False):
    """Folder of a run that found these parts, in the frame that they are moved into."""
    out.mkdir()
    body = measured_body(joined(*meshes), pose, sigma_m=3e-4)
    write_mesh(body.mesh, out / CONTENT_NAME)
    save_prior(LosPrior.from_box(box_m), out / PRIOR_NAME)
    apertures = planes_around() if has_glints else []
    corners = np.array([aperture.corners_m for aperture in apertures]).reshape(-1, 4, 3)
    planes = ScannedPlanes(corners_m=corners, wavelength_m=wavelength_m)
    save_planes(planes, out / PLANES_NAME)
    if has_glints:
        glints = glints_of(body, apertures)
        glints.save(out / GLINTS_NAME)
        (out / PEAKS_NAME).write_bytes(cloud_bytes(glints.positions, glints.normals, {}))
        none = PriorSource.from_argument(None)
        record = RunRecord(scene=None, prior=none, options=RunOptions(), config=FastPreset())
        record.write(out / CONFIG_NAME)
    record_run(out, "crate")
    return out
