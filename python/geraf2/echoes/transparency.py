"""Glints of a body that waves pass through, freed of its back faces, and what it is made of.

Only where glints show such a body at all; those of metal stay as they are.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats, Ints
from geraf2.echoes.back_faces import BEHIND_M, seen_first, seen_through_share
from geraf2.echoes.glint_set import Glints
from geraf2.errors import UserError
from geraf2.ops.visibility import MeshScene

# Metal objects have up to 0.02 of the strength behind other glints, plastic ones 0.24 and more.
_MIN_SHARE = 0.1
_ROUNDS = 2
# Lines of sight begin so far before their glint [m]: before any content.
_AHEAD_M = 0.4
# Of what permittivity is read off: faces met within 18 degrees of their normals, bodies thick
# enough to be resolved, glints of both faces this near.
_MIN_COSINE = 0.95
_MIN_THICKNESS_M = 0.012
_NEAR_M = 0.006
# Each place of this size has one vote, of three pairs at least; as many places at least must agree
# to within this share: air that the surface does not show, as between two legs, lowers the ratio
# here and there, so that a tenth well above the median refute it.
_PLACE_M = 0.01
_PAIRS_PER_PLACE = 3
_MIN_PLACES = 5
_MAX_SPREAD = 0.06
# Ratios are off by as much where a round body focuses on its back face (a jug: 4 %, a dog: 1 %).
_RATIO_SIGMA = 0.03


@dataclass(frozen=True, kw_only=True)
class SeenThrough:
    """What glints say of a body that waves pass through."""

    n_dropped: int
    """Glints of its back faces, and of what else was seen through it."""
    strength_share: float
    """Their share of the strength of all glints that were looked at."""
    permittivity: float | None = None
    """Relative; None where no back face has its true place from another plane."""
    permittivity_sigma: float | None = None
    """Its standard uncertainty."""
    n_pairs: int = 0
    """Pairs of front and back face that it was read off."""
    thickness_m: tuple[float, float] | None = None
    """Of the body between such pairs, 10 % and 90 % quantile [m]."""

    def numbers(self) -> dict[str, Any]:
        """For run.json."""
        found: dict[str, Any] = {
            "n_back_faces": self.n_dropped,
            "back_face_share": round(self.strength_share, 3),
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
    """Sentence about what `SeenThrough.numbers` holds; empty where nothing was seen through."""
    if "n_back_faces" not in numbers:
        return ""
    text = (
        f"the content lets waves through: {numbers['n_back_faces']} glints seen through it, "
        f"{100.0 * numbers['back_face_share']:.0f} % of the strength, were left out"
    )
    if "permittivity" not in numbers:
        return f"{text}; its permittivity does not show"
    low, high = (1e3 * value for value in numbers["thickness_m"])
    return (
        f"{text}; permittivity {numbers['permittivity']:.2f} +- "
        f"{numbers['permittivity_sigma']:.2f} from {numbers['n_face_pairs']} pairs of faces, "
        f"{low:.0f} to {high:.0f} mm apart"
    )


def first_surfaces(
    glints: Glints,
    surface_through: Callable[[Glints], tuple[Floats, Ints]],
    *,
    num_threads: int | None = None,
) -> tuple[Bools, SeenThrough | None]:
    """Glints of first surfaces, (n_glints,), and what was seen through them; all, None for metal.

    The share of glints behind others shows whether there is such a body. If so, glints behind
    others in their own line of sight are dropped. Then, twice, a surface is fitted through the
    remainder, and glints behind it are dropped: the fit closes entries that no antenna sees
    squarely.

    glints: of `find_glints`.
    surface_through: vertices [m] and faces of a closed surface through glints; raises UserError
        where they enclose nothing. It only stops lines of sight.
    num_threads: all when None.
    """
    if seen_through_share(glints) < _MIN_SHARE:
        return np.ones(len(glints), dtype=bool), None
    first, perhaps = seen_first(glints)
    keep = first
    scene: MeshScene | None = None
    for _ in range(_ROUNDS):
        if not keep.any():
            return np.ones(len(glints), dtype=bool), None
        try:
            vertices, faces = surface_through(glints.select(keep))
        except UserError:  # too few to enclose anything
            return np.ones(len(glints), dtype=bool), None
        scene = MeshScene(vertices, faces, num_threads=num_threads)
        keep = perhaps & (_behind(glints, scene) < BEHIND_M)
    if not keep.any():
        return np.ones(len(glints), dtype=bool), None
    assert scene is not None
    kept, dropped = glints.select(keep), glints.select(~keep)
    lost = float(dropped.strengths.sum() / glints.strengths.sum())
    return keep, _material(len(dropped), lost, face_pairs(dropped, kept, scene))


def _behind(glints: Glints, scene: MeshScene) -> Floats:
    """How far each glint lies behind the first surface in its line of sight, (n,) [m]; -inf."""
    start = glints.positions + _AHEAD_M * glints.normals
    return np.asarray(_AHEAD_M - scene.closest_hit(start, -glints.normals)[0])


@dataclass(frozen=True, kw_only=True, eq=False)
class FacePairs:
    """Back faces seen through a body whose other side is seen from another plane."""

    entries: Floats
    """Where the line of sight enters the body, (n, 3) [m]."""
    thickness_m: Floats
    """From there to where it leaves it, (n,) [m]."""
    optical_m: Floats
    """From there to where the back face seems to be, (n,) [m]: sqrt(permittivity) as much."""


def face_pairs(back: Glints, front: Glints, scene: MeshScene) -> FacePairs:
    """Pairs whose faces both lie across the line of sight, with a glint of the front on each.

    back: glints of back faces.
    front: of first surfaces.
    scene: the surface through these, closed.
    """
    start, ways = back.positions + _AHEAD_M * back.normals, -back.normals
    stretches = scene.entry_exit(start, ways)
    if stretches.t_entry.shape[1] == 0:
        return FacePairs(entries=start[:0], thickness_m=np.zeros(0), optical_m=np.zeros(0))
    entry, leave = stretches.t_entry[:, 0], stretches.t_exit[:, 0]
    good = np.isfinite(leave) & (leave < _AHEAD_M)
    good &= (stretches.t_entry[:, 1:] > _AHEAD_M).all(axis=1)
    entry, leave = np.where(good, entry, 0.0), np.where(good, leave, 0.0)
    good &= leave - entry > _MIN_THICKNESS_M
    tree = KDTree(front.positions)
    for path_m, sign in ((entry, 1.0), (leave, -1.0)):
        distance, nearest = tree.query(start + path_m[:, None] * ways)
        facing = sign * np.einsum("ij,ij->i", front.normals[nearest], back.normals)
        good &= (distance < _NEAR_M) & (facing > _MIN_COSINE)
    entries = start + entry[:, None] * ways
    thickness, optical = leave - entry, _AHEAD_M - entry
    return FacePairs(entries=entries[good], thickness_m=thickness[good], optical_m=optical[good])


def _material(n_dropped: int, strength_share: float, pairs: FacePairs) -> SeenThrough:
    """Permittivity from the pairs, where those of different places agree."""
    seen = SeenThrough(n_dropped=n_dropped, strength_share=strength_share)
    ratio = pairs.optical_m / pairs.thickness_m
    places = np.unique(np.floor(pairs.entries / _PLACE_M), axis=0, return_inverse=True)[1].ravel()
    n_pairs = np.bincount(places)
    votes = [np.median(ratio[places == k]) for k in np.flatnonzero(n_pairs >= _PAIRS_PER_PLACE)]
    if len(votes) < _MIN_PLACES:
        return seen
    index = float(np.median(votes))
    spread = 1.4826 * float(np.median(np.abs(np.array(votes) - index))) / index
    if spread > _MAX_SPREAD or np.quantile(votes, 0.9) > (1.0 + 2.0 * _MAX_SPREAD) * index:
        return seen
    low, high = np.quantile(pairs.thickness_m, [0.1, 0.9])
    return replace(
        seen,
        permittivity=index**2,
        permittivity_sigma=2.0
        * index**2
        * float(np.hypot(spread / len(votes) ** 0.5, _RATIO_SIGMA)),
        n_pairs=len(ratio),
        thickness_m=(float(low), float(high)),
    )
