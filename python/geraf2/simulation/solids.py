"""The object of a scene as a closed mesh in the capture frame."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geraf2.errors import UserError
from geraf2.io.mesh import TriangleMesh, merge_duplicate_vertices, read_mesh
from geraf2.simulation.figures import FIGURES, build_figure
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

    Parameters
    ----------
    spec
        Which figure, and how it stands.
    """
    if spec.mesh is not None:
        mesh = read_mesh(Path(spec.mesh))
        where: object = spec.mesh
    else:
        if spec.name not in FIGURES:
            msg = f"unknown figure {spec.name!r}"
            raise UserError(msg, expected="one of " + ", ".join(FIGURES))
        mesh = merge_duplicate_vertices(build_figure(str(spec.name)))
        where = spec.name
    vertices, faces = mesh.vertices, mesh.faces
    _require_closed(vertices, faces, where)
    if _volume(vertices, faces) < 0:
        faces = faces[:, ::-1]
    if spec.smooth_subdivisions:
        vertices, faces = _smooth(vertices, faces, spec.smooth_subdivisions)
    vertices = vertices @ _TO_UP[spec.up].T
    turn = np.deg2rad(spec.turn_deg)
    cos, sin = np.cos(turn), np.sin(turn)
    vertices = vertices @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]).T
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    if high[2] <= low[2]:
        msg = "the mesh has no height"
        raise UserError(msg, where=where)
    vertices = (vertices - 0.5 * (low + high)) * (spec.height_m / (high[2] - low[2]))
    return TriangleMesh(
        vertices=vertices + np.asarray(spec.center_m), faces=np.ascontiguousarray(faces)
    )


def _require_closed(vertices: NDArray[np.float64], faces: NDArray[np.int64], where: object) -> None:
    """Every edge must be met as often in one direction as in the other."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    n_vertices = vertices.shape[0]
    forward = edges[:, 0] * n_vertices + edges[:, 1]
    backward = edges[:, 1] * n_vertices + edges[:, 0]
    n_open = int((~np.isin(forward, backward)).sum())
    if faces.shape[0] == 0 or n_open or np.unique(forward).size != forward.size:
        msg = "the mesh is not watertight"
        raise UserError(
            msg,
            where=where,
            expected="every edge shared by two faces of the same winding",
            got=f"{n_open} open edges of {edges.shape[0]}",
            hint="close its holes first",
        )


def _volume(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> float:
    a, b, c = (vertices[faces[:, k]] - vertices.mean(axis=0) for k in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c))) / 6.0


def _smooth(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], rounds: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    from trimesh.remesh import subdivide_loop  # noqa: PLC0415 - heavy, and seldom used

    smooth_vertices, smooth_faces = subdivide_loop(vertices, faces, iterations=rounds)
    return np.asarray(smooth_vertices, float), np.asarray(smooth_faces, np.int64)
