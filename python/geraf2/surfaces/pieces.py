"""Connected pieces of a surface: the probability that each exists, and its size."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Floats, Ints
from geraf2._validation import require_each, require_positive
from geraf2.echoes.glint_set import Glints
from geraf2.geometry.components import are_voids, face_labels
from geraf2.geometry.triangles import (
    enclosed_volume_m3,
    face_areas,
    used_vertices,
    volume_centroid_m,
)
from geraf2.io.mesh import TriangleMesh
from geraf2.surfaces.expected_error import SEEN_REACH_M

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
    min_size_m: float = 0.005
    """Least diameter of the ball with a piece's area [m]; smaller ones are point scatterers."""
    min_density: float = 0.1
    """Least glints per area over those of the main piece; the fit of few glints bridges air."""

    def __post_init__(self) -> None:
        require_each(require_positive, self, *self.__dataclass_fields__)

    def probability(self, n_pieces: int, pieces: Ints, planes: Ints, probability: Floats) -> Floats:
        """Probability of each piece, (n_pieces,).

        pieces, planes, probability: of each glint on a piece, (n_glints,).
        """
        none = np.zeros((n_pieces, int(planes.max(initial=-1)) + 1))
        # log P(no glint of the plane is a direct return)
        np.add.at(none, (pieces, planes), np.log1p(-np.minimum(probability, 1.0 - 1e-6)))
        odds = ((1.0 - np.exp(none)).sum(axis=1) / self.even) ** self.gain
        return np.asarray(odds / (1.0 + odds))


@dataclass(frozen=True, kw_only=True)
class Piece:
    """Numbers of a connected piece of a surface."""

    probability: float
    """Probability that the piece exists."""
    volume_m3: float
    """Enclosed volume [m^3]."""
    extents_m: Floats
    """Lengths along x, y, z, (3,) [m]."""
    center_m: Floats
    """Centroid of its volume, (3,) [m]."""

    def numbers(self) -> dict[str, Any]:
        """Entry of run.json."""
        return {
            "probability": round(self.probability, 3),
            "volume_cm3": round(1e6 * self.volume_m3, 2),
            "extents_mm": [round(float(v), 1) for v in 1e3 * self.extents_m],
            "center_mm": [round(float(v), 1) for v in 1e3 * self.center_m],
        }


class Separated(NamedTuple):
    """Pieces of a surface that likely exist, and the others."""

    content: TriangleMesh
    """Pieces that likely exist; `confidence` is the probability of each vertex's piece."""
    ghosts: TriangleMesh
    """Pieces that likely do not exist, with theirs."""


def separate_pieces(mesh: TriangleMesh, glints: Glints) -> Separated:
    """Separate the pieces that likely exist from likely ghosts.

    Point scatterers (`PieceModel.min_size_m`), pieces without glints, pieces that bridge air
    (`PieceModel.min_density`) and closed surfaces that face inwards are in neither: a radar does
    not see the inside of a reflector. The main piece, with most glints, always remains.

    mesh: surface that was fitted to the glints.
    glints: all of them, rim glints too.
    """
    model = PieceModel()
    labels, n_pieces = face_labels(mesh.faces)
    if n_pieces == 0:
        return Separated(mesh, mesh)
    solid = ~are_voids(mesh.vertices, mesh.faces, labels, n_pieces)
    areas = np.bincount(labels, face_areas(mesh.corners), n_pieces)
    of_vertex = np.zeros(len(mesh.vertices), dtype=np.int64)
    of_vertex[mesh.faces] = labels[:, None]
    used = np.unique(mesh.faces)
    distance, nearest = KDTree(mesh.vertices[used]).query(glints.positions)
    near = distance <= SEEN_REACH_M  # such a glint belongs to the piece nearest to it
    piece = of_vertex[used[nearest[near]]]
    counts = np.bincount(piece, minlength=n_pieces)
    probability = model.probability(n_pieces, piece, glints.poses[near], glints.probability[near])
    main = int(np.lexsort((areas, counts, solid))[-1])
    probability[main] = max(probability[main], model.main)
    dense = counts * areas[main] >= model.min_density * counts[main] * areas
    shown = solid & dense & (counts > 0) & (areas > np.pi * model.min_size_m**2)
    shown[main] = True
    marked = replace(mesh, confidence=probability[of_vertex])
    content, ghosts = (
        marked.with_faces(mesh.faces[(shown & likely)[labels]])
        for likely in (probability >= LIKELY, probability < LIKELY)
    )
    return Separated(content, ghosts)


def pieces_of(mesh: TriangleMesh) -> list[Piece]:
    """Numbers of the connected pieces of a mesh with probabilities, the most probable first."""
    labels, n_pieces = face_labels(mesh.faces)
    return sorted(
        (_piece(mesh, mesh.faces[labels == k]) for k in range(n_pieces)),
        key=lambda piece: -piece.probability,
    )


def piece_numbers(mesh: TriangleMesh) -> dict[str, Any]:
    """Count the pieces and state lengths and centre of all, for run.json; {} if empty."""
    if not len(mesh.faces):
        return {}
    center = volume_centroid_m(mesh.vertices, mesh.faces)
    return {
        "n_pieces": face_labels(mesh.faces)[1],
        "extents_mm": [round(float(v), 2) for v in 1e3 * np.ptp(mesh.vertices, axis=0)],
        "center_mm": [round(float(v), 2) for v in 1e3 * center],
    }


def _piece(mesh: TriangleMesh, faces: Any) -> Piece:
    assert mesh.confidence is not None
    used, renumbered = used_vertices(faces)
    corners = mesh.vertices[used]
    return Piece(
        probability=float(mesh.confidence[used[0]]),
        volume_m3=abs(enclosed_volume_m3(corners, renumbered)),
        extents_m=np.ptp(corners, axis=0),
        center_m=volume_centroid_m(corners, renumbered),
    )


def ghost_texts(numbers: Mapping[str, Any]) -> list[str]:
    """Describe position, size and probability of each likely ghost.

    numbers: entry of the stage `mesh` in run.json.
    """
    return [
        f"{ghost['volume_cm3']:.2f} cm³ at "
        f"({', '.join(f'{v:z.0f}' for v in ghost['center_mm'])}) mm "
        f"exists with {100 * ghost['probability']:.0f} %"
        for ghost in numbers.get("likely_ghosts", ())
    ]
