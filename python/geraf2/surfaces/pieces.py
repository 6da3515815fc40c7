"""Connected pieces of a surface: the probability that each exists, and its size."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats
from geraf2._validation import require_each, require_positive
from geraf2.echoes.glint_set import Glints
from geraf2.geometry.components import face_labels
from geraf2.geometry.triangles import enclosed_volume_m3, used_vertices
from geraf2.io.mesh import TriangleMesh

LIKELY = 0.5
"""Pieces with a lower probability are likely ghosts."""


@dataclass(frozen=True, kw_only=True)
class PieceModel:
    """Probability that a piece of the surface exists, from its glints.

        log(p / (1 - p)) = gain log(planes / even)

    planes is the sum over the planes of the probability that at least one of the plane's glints on
    the piece is a direct return. The main piece, with most glints, has at least `main`. The
    constants are properties of the simulated population of objects: ghosts are seen from one
    plane, true parts of 8 mm from four or more (`bench/python/ghosts.py`).
    """

    even: float = 1.25
    """Number of planes at which the odds are even."""
    gain: float = 3.0
    """Slope of the log odds over the logarithm of the number of planes."""
    main: float = 0.99
    """Least probability of the main piece."""
    reach_m: float = 0.005
    """A glint within this distance [m] belongs to the piece nearest to it."""

    def __post_init__(self) -> None:
        require_each(require_positive, self, *self.__dataclass_fields__)


@dataclass(frozen=True, kw_only=True)
class Piece:
    """Numbers of a connected piece of a surface."""

    probability: float
    """Probability that the piece exists."""
    volume_m3: float
    """Enclosed volume [m^3]."""
    low_m: Floats
    """Lowest corner of its bounding box, (3,) [m]."""
    high_m: Floats
    """Highest corner, (3,) [m]."""

    def numbers(self) -> dict[str, Any]:
        """Entry of run.json."""
        return {
            "probability": round(self.probability, 3),
            "volume_cm3": round(1e6 * self.volume_m3, 2),
            "extents_mm": [round(float(v), 1) for v in 1e3 * (self.high_m - self.low_m)],
            "middle_mm": [round(float(v), 1) for v in 5e2 * (self.high_m + self.low_m)],
        }


def piece_probability(
    mesh: TriangleMesh, glints: Glints, model: PieceModel | None = None
) -> Floats:
    """Probability that the piece of each vertex exists, (n_vertices,).

    glints: all that the surface was fitted to, rim glints too.
    """
    model = model or PieceModel()
    labels, n_pieces = face_labels(mesh.faces)
    of_vertex = np.zeros(len(mesh.vertices), dtype=np.int64)
    of_vertex[mesh.faces] = labels[:, None]
    if n_pieces < 2 or not len(glints):
        return np.ones(len(mesh.vertices))
    distance, nearest = KDTree(mesh.vertices).query(glints.positions)
    near = distance <= model.reach_m
    piece, plane = of_vertex[nearest[near]], np.unique(glints.poses, return_inverse=True)[1][near]
    none = np.zeros((n_pieces, int(glints.poses.max()) + 1))  # log P(no glint is a direct return)
    np.add.at(none, (piece, plane), np.log1p(-np.minimum(glints.probability[near], 1.0 - 1e-6)))
    planes = (1.0 - np.exp(none)).sum(axis=1)
    odds = (planes / model.even) ** model.gain
    probability = odds / (1.0 + odds)
    main = np.bincount(piece, minlength=n_pieces).argmax()
    probability[main] = max(probability[main], model.main)
    return np.asarray(probability[of_vertex])


def with_probability(mesh: TriangleMesh, probability: Floats) -> TriangleMesh:
    """Mesh whose expected error includes the probability that a piece does not exist.

        sigma'^2 = p sigma^2 + (1 - p) d^2

    d is the distance to the pieces that likely exist. These keep their expected error, which was
    measured on existing pieces.
    """
    assert mesh.expected_error_m is not None
    likely, error = probability >= LIKELY, mesh.expected_error_m.copy()
    if likely.any() and not likely.all():
        away = KDTree(mesh.vertices[likely]).query(mesh.vertices[~likely])[0]
        p = probability[~likely]
        error[~likely] = np.sqrt(p * error[~likely] ** 2 + (1.0 - p) * away**2)
    return replace(mesh, expected_error_m=error, confidence=probability)


def likely_faces(mesh: TriangleMesh) -> Bools:
    """Faces of the pieces that likely exist, (n_faces,); all of a mesh without probabilities."""
    if mesh.confidence is None:
        return np.ones(len(mesh.faces), dtype=bool)
    return np.asarray(mesh.confidence[mesh.faces[:, 0]] >= LIKELY)


def likely_part(mesh: TriangleMesh) -> TriangleMesh:
    """Mesh without its likely ghosts."""
    likely = likely_faces(mesh)
    return mesh if likely.all() else mesh.with_faces(mesh.faces[likely])


def likely_ghosts(mesh: TriangleMesh) -> list[Piece]:
    """Pieces that likely do not exist, the most probable first."""
    ghosts = mesh.faces[~likely_faces(mesh)]
    labels, n_pieces = face_labels(ghosts)
    return sorted(
        (_piece(mesh, ghosts[labels == k]) for k in range(n_pieces)),
        key=lambda piece: -piece.probability,
    )


def piece_numbers(mesh: TriangleMesh) -> dict[str, Any]:
    """Count the pieces and measure their common bounding box, for run.json; {} if empty."""
    if not len(mesh.faces):
        return {}
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    return {
        "n_pieces": face_labels(mesh.faces)[1],
        "extents_mm": [round(float(v), 2) for v in 1e3 * (high - low)],
        "middle_mm": [round(float(v), 2) for v in 5e2 * (high + low)],
    }


def _piece(mesh: TriangleMesh, faces: Any) -> Piece:
    assert mesh.confidence is not None
    used, renumbered = used_vertices(faces)
    corners = mesh.vertices[used]
    return Piece(
        probability=float(mesh.confidence[used[0]]),
        volume_m3=abs(enclosed_volume_m3(corners, renumbered)),
        low_m=corners.min(axis=0),
        high_m=corners.max(axis=0),
    )


def ghost_texts(numbers: Mapping[str, Any]) -> list[str]:
    """Describe position, size and probability of each likely ghost.

    numbers: entry of the stage `mesh` in run.json.
    """
    return [
        f"{ghost['volume_cm3']:.2f} cm³ at ({', '.join(f'{v:.0f}' for v in ghost['middle_mm'])}) mm"
        f" exists with {100 * ghost['probability']:.0f} %"
        for ghost in numbers.get("likely_ghosts", ())
    ]
