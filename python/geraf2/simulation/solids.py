"""The object of a scene as a closed mesh in the capture frame."""

from pathlib import Path

import numpy as np

from geraf2.errors import UserError
from geraf2.geometry.triangles import count_open_edges, enclosed_volume_m3
from geraf2.io.mesh import TriangleMesh, merge_duplicate_vertices, read_mesh
from geraf2.simulation.figures import FIGURES, build_figure
from geraf2.simulation.random_objects import RANDOM_NAME, random_object
from geraf2.simulation.spec import FigureSpec

_TO_UP = {
    # Rows: which file axes become x, y and z; all proper rotations.
    "+z": np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    "-z": np.array([[1, 0, 0], [0, -1, 0], [0, 0, -1]]),
    "+y": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "-y": np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "+x": np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]]),
    "-x": np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]),
}


def build_solid(spec: FigureSpec) -> TriangleMesh:
    """Mesh of the object, outward winding, scaled, turned and placed [m].

    spec: the object and its placement.
    """
    if spec.mesh is not None:
        mesh = read_mesh(Path(spec.mesh))
        where: object = spec.mesh
    elif seed := RANDOM_NAME.fullmatch(str(spec.name)):
        mesh, where = random_object(int(seed[1])).mesh, spec.name
    else:
        if spec.name not in FIGURES:
            raise UserError(
                what=f"unknown object {spec.name!r}",
                expected="one of " + ", ".join(FIGURES) + ", or random-SEED",
            )
        mesh = merge_duplicate_vertices(build_figure(str(spec.name)))
        where = spec.name
    vertices, faces = mesh.vertices, mesh.faces
    n_open = count_open_edges(faces)
    if faces.shape[0] == 0 or n_open:
        raise UserError(
            what="the mesh is not watertight",
            where=where,
            expected="every edge shared by two faces of the same winding",
            got=f"{n_open} open edges of {faces.size}",
            hint="close its holes first",
        )
    if enclosed_volume_m3(vertices, faces) < 0:
        faces = faces[:, ::-1]
    if spec.smooth_subdivisions:
        from trimesh.remesh import subdivide_loop  # noqa: PLC0415 - heavy, and seldom used

        smooth = subdivide_loop(vertices, faces, iterations=spec.smooth_subdivisions)
        vertices, faces = np.asarray(smooth[0], float), np.asarray(smooth[1], np.int64)
    vertices = vertices @ _TO_UP[spec.up].T
    turn = np.deg2rad(spec.turn_deg)
    cos, sin = np.cos(turn), np.sin(turn)
    vertices = vertices @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]).T
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    if high[2] <= low[2]:
        raise UserError(what="the mesh has no height", where=where)
    vertices = (vertices - 0.5 * (low + high)) * (spec.height_m / (high[2] - low[2]))
    return TriangleMesh(
        vertices=vertices + np.asarray(spec.center_m), faces=np.ascontiguousarray(faces)
    )
