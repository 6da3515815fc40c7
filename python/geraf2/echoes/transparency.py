"""Glints of a dielectric body on its faces, and its permittivity.

Glints of metal remain unchanged.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats
from geraf2.echoes.faces import AHEAD_M, AIR, INDEX, MIN_GLINTS, Faces, Scan, find_faces
from geraf2.echoes.glint_set import Glints
from geraf2.errors import UserError
from geraf2.io.text import interval_text
from geraf2.ops.visibility import MeshScene

_MIN_COSINE = 0.95
"""Least cosine of a line of sight with the normals of both faces."""
_MIN_THICKNESS_M = 0.012
"""Least thickness at which both faces are resolved [m]."""
_NEAR_M = 0.006
"""Largest distance of the glints of both faces from the line of sight [m]."""
_CELL_M = 0.01
"""Cell of the surface whose pairs give one ratio, their median [m]."""
_PAIRS_PER_CELL = 3
"""Least number of pairs of such a cell."""
_MIN_CELLS = 5
"""Least number of cells."""
_MAX_SPREAD = 0.06
"""Largest relative deviation of the cells' ratios. Air gaps that the surface does not show, as
between two legs, lower some of them."""
_INDICES = (1.4, 2.0)
"""Refractive indices of solid plastics; others come of faces that were mistaken."""
_RATIO_SIGMA = 0.03
"""Relative standard deviation of a ratio: a round body focuses on its back face."""


@dataclass(frozen=True, kw_only=True)
class SeenThrough:
    """Properties of a dielectric body from its glints."""

    n_behind: int
    """Number of glints of back faces."""
    strength_share: float
    """Their share of the strength of all glints."""
    is_hollow: bool = False
    """Whether the body is a shell that is filled with air."""
    permittivity: float | None = None
    """Relative permittivity; None where no other plane sees a back face from outside."""
    permittivity_sigma: float | None = None
    """Its standard deviation."""
    n_pairs: int = 0
    """Number of pairs of front and back face that give it."""
    thickness_m: tuple[float, float] | None = None
    """Thickness of the body at such pairs, 10 % and 90 % quantile [m]."""

    @classmethod
    def of(cls, glints: Glints, behind: Bools) -> "SeenThrough":
        """Body without permittivity. behind: (n_glints,)."""
        share = glints.strengths[behind].sum() / glints.strengths.sum()
        return cls(n_behind=int(behind.sum()), strength_share=float(share))

    def numbers(self) -> dict[str, Any]:
        """Entry of run.json."""
        found: dict[str, Any] = {
            "n_back_faces": self.n_behind,
            "back_face_share": round(self.strength_share, 3),
            "is_hollow": self.is_hollow,
        }
        if self.permittivity is None or self.permittivity_sigma is None:
            return found
        low, high = self.thickness_m or (0.0, 0.0)
        return found | {
            "permittivity": round(self.permittivity, 2),
            "permittivity_sigma": round(self.permittivity_sigma, 2),
            "n_face_pairs": self.n_pairs,
            "thickness_m": [round(low, 4), round(high, 4)],
        }


def describe(numbers: Mapping[str, Any]) -> str:
    """Sentence about `SeenThrough.numbers`; empty for metal."""
    if "n_back_faces" not in numbers:
        return ""
    of_back = (
        f"{numbers['n_back_faces']} glints, {100.0 * numbers['back_face_share']:.0f} % of the "
        "strength, are echoes of"
    )
    if numbers["is_hollow"]:
        return f"the content is a shell of plastic: {of_back} its far side, seen through it"
    text = f"the content is a dielectric: {of_back} back faces"
    if "permittivity" not in numbers:
        return f"{text}; its permittivity is unknown"
    low, high = (1e3 * value for value in numbers["thickness_m"])
    permittivity = interval_text(numbers["permittivity"], numbers["permittivity_sigma"], digits=2)
    return (
        f"{text}; permittivity {permittivity} from {numbers['n_face_pairs']} pairs of faces, "
        f"{low:.0f} to {high:.0f} mm apart"
    )


def place_on_faces(scan: Scan, index: float = INDEX) -> tuple[Faces, SeenThrough] | None:
    """Glints of plastic on the faces that they are most likely echoes of, and the body.

    None where no surface closes. index: of refraction, `AIR` of a shell.
    """
    faces = find_faces(scan, index)
    if faces is None:
        return None
    if index == AIR:
        behind = faces.of_glints(len(scan.glints))[1]
        return faces, replace(SeenThrough.of(scan.glints, behind), is_hollow=True)
    body = _seen_through(scan, faces)
    if body.permittivity is not None:
        again = find_faces(scan, float(np.sqrt(body.permittivity)))
        if again is not None:
            return again, _seen_through(scan, again)
    return faces, body


def _seen_through(scan: Scan, faces: Faces) -> SeenThrough:
    """Body that glints are seen through, with its permittivity where fronts show both ends."""
    glints, first = scan.glints, faces.glints.select(~faces.is_back)
    behind = faces.of_glints(len(glints))[1]
    body = SeenThrough.of(glints, behind)
    if len(first) < MIN_GLINTS:
        return body
    try:  # a surface through back faces would repeat the index by which they were placed
        scene = MeshScene(*scan.surface_through(first), num_threads=scan.num_threads)
    except UserError:
        return body
    return _material(body, face_pairs(glints.select(behind), first, scene))


@dataclass(frozen=True, kw_only=True, eq=False)
class FacePairs:
    """Back faces seen through a body, whose true position another plane shows."""

    entries: Floats
    """Points where the line of sight enters the body, (n, 3) [m]."""
    thickness_m: Floats
    """Distance from there to the exit, (n,) [m]."""
    optical_m: Floats
    """Distance from there to the apparent back face, (n,) [m]: sqrt(permittivity) as much."""


def face_pairs(back: Glints, front: Glints, scene: MeshScene) -> FacePairs:
    """Pairs of faces across the line of sight, each with a glint of a first surface on it.

    back: glints of back faces.
    front: glints of first surfaces.
    scene: closed surface through these.
    """
    start, directions = back.positions + AHEAD_M * back.normals, -back.normals
    inside = scene.entry_exit(start, directions)
    if inside.t_entry.shape[1] == 0 or not len(front):
        return FacePairs(entries=start[:0], thickness_m=np.zeros(0), optical_m=np.zeros(0))
    entry, leave = inside.t_entry[:, 0], inside.t_exit[:, 0]
    good = np.isfinite(leave) & (leave < AHEAD_M)
    good &= (inside.t_entry[:, 1:] > AHEAD_M).all(axis=1)
    entry, leave = np.where(good, entry, 0.0), np.where(good, leave, 0.0)
    good &= leave - entry > _MIN_THICKNESS_M
    tree = KDTree(front.positions)
    for path_m, sign in ((entry, 1.0), (leave, -1.0)):
        distance, nearest = tree.query(start + path_m[:, None] * directions)
        facing = sign * np.einsum("ij,ij->i", front.normals[nearest], back.normals)
        good &= (distance < _NEAR_M) & (facing > _MIN_COSINE)
    entries = start + entry[:, None] * directions
    thickness, optical = leave - entry, AHEAD_M - entry
    return FacePairs(entries=entries[good], thickness_m=thickness[good], optical_m=optical[good])


def _material(seen: SeenThrough, pairs: FacePairs) -> SeenThrough:
    """Permittivity from the pairs, if the cells of the surface agree."""
    ratio = pairs.optical_m / pairs.thickness_m
    cells = np.unique(np.floor(pairs.entries / _CELL_M), axis=0, return_inverse=True)[1].ravel()
    n_pairs = np.bincount(cells)
    ratios = [np.median(ratio[cells == k]) for k in np.flatnonzero(n_pairs >= _PAIRS_PER_CELL)]
    if len(ratios) < _MIN_CELLS:
        return seen
    index = float(np.median(ratios))
    spread = 1.4826 * float(np.median(np.abs(np.array(ratios) - index))) / index
    if spread > _MAX_SPREAD or np.quantile(ratios, 0.9) > (1.0 + 2.0 * _MAX_SPREAD) * index:
        return seen
    if not _INDICES[0] < index < _INDICES[1]:
        return seen
    low, high = np.quantile(pairs.thickness_m, [0.1, 0.9])
    return replace(
        seen,
        permittivity=index**2,
        permittivity_sigma=2.0
        * index**2
        * float(np.hypot(spread / len(ratios) ** 0.5, _RATIO_SIGMA)),
        n_pairs=len(ratio),
        thickness_m=(float(low), float(high)),
    )
