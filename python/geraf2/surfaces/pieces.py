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
"""Pieces below this probability are likely ghosts."""


@dataclass(frozen=True, kw_only=True)
class PieceModel:
    """Probability that a piece of the surface exists, from the glints on it.

        log(p / (1 - p)) = gain log(planes / even)

    planes is the sum over the planes of the probability that one of their glints on the piece is a
    direct return. The main piece, on which most glints lie, has at least `main`. Ghosts are seen
    from one plane, and true parts of 8 mm from four or more of 5 to 16 planes; the constants lie
    between (`bench/python/ghosts.py` on seeds 0 to 4 of the population and on 12 screws).
    """

    even: float = 1.25
    """Planes at which a piece exists as often as not."""
    gain: float = 3.0
    """Slope of the log odds over the logarithm of the planes."""
    main: float = 0.99
    """Least probability of the main piece."""
    reach_m: float = 0.005
    """A glint is on the piece that it is nearest to, if within this distance [m]."""

    def __post_init__(self) -> None:
        require_each(require_positive, self, *self.__dataclass_fields__)


@dataclass(frozen=True, kw_only=True)
class Piece:
    """A connected piece of a surface in numbers."""

    probability: float
    """That it exists."""
    volume_m3: float
    """Enclosed volume [m^3]."""
    low_m: Floats
    """Lowest corner of its box, (3,) [m]."""
    high_m: Floats
    """Highest corner, (3,) [m]."""

    def numbers(self) -> dict[str, Any]:
        """For run.json."""
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

    glints: that the surface was drawn through, those of the rim too.
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
    none = np.zeros((n_pieces, int(glints.poses.max()) + 1))  # log of: no glint is a return
    np.add.at(none, (piece, plane), np.log1p(-np.minimum(glints.probability[near], 1.0 - 1e-6)))
    planes = (1.0 - np.exp(none)).sum(axis=1)
    odds = (planes / model.even) ** model.gain
    probability = odds / (1.0 + odds)
    main = np.bincount(piece, minlength=n_pieces).argmax()
    probability[main] = max(probability[main], model.main)
    return np.asarray(probability[of_vertex])


def with_probability(mesh: TriangleMesh, probability: Floats) -> TriangleMesh:
    """Mesh whose expected error also holds that a piece may not exist.

        sigma'^2 = p sigma^2 + (1 - p) d^2

    d is the distance to the pieces that likely exist. Pieces that likely exist keep their error:
    theirs was measured on such pieces.
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
    """Count the pieces and measure the box around all, for run.json; {} of an empty mesh."""
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
    """Position, size and probability of each likely ghost.

    numbers: of the stage `mesh` in run.json.
    """
    return [
        f"{ghost['volume_cm3']:.2f} cm³ at ({', '.join(f'{v:.0f}' for v in ghost['middle_mm'])}) mm"
        f" exists with {100 * ghost['probability']:.0f} %"
        for ghost in numbers.get("likely_ghosts", ())
    ]
