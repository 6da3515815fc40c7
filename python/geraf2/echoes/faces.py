"""Front and back faces of a dielectric body (docs/math/echoes.md#back-faces).

A wave that enters a body of refractive index n at f and is reflected after the thickness t seems to
come from f + n t. Which echoes are of back faces follows from the surface, and the surface from the
echoes: both are estimated in turns, by expectation maximisation, from several starts.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats, Ints
from geraf2.echoes.glint_set import Glints, relative_strengths
from geraf2.echoes.noise import ECHO_NOISE, normal_density
from geraf2.errors import UserError
from geraf2.geometry.triangles import face_areas, vertex_normals
from geraf2.ops.visibility import MeshScene

SurfaceThrough = Callable[[Glints], tuple[Floats, Ints]]
"""Vertices [m] and faces of a closed surface through glints; UserError where there is none."""

INDEX = 1.67
"""Refractive index of plastics, 1.58 to 1.82."""
AHEAD_M = 0.4
"""Start of a line of sight in front of its glint, outside of any content [m]."""
_STARTS_M = (0.0, 0.008, 0.016, 0.028, 0.05, 0.09)
"""Starts: all echoes this far behind the surface [m]."""
_UNEXPLAINED = 0.15
"""Share of the echoes that no front explains from which on plastic is tried. Metal leaves 0.04 to
0.15 in 27 of 30 scans."""
_ROUNDS = 6
"""Rounds of each start."""
_SIGMA_M, _SIGMA_OF_PATH, _SIGMA_OF_BODY = 0.002, 0.05, 0.08
"""Standard deviation of an echo about its face [m]; over the path in the body, and in bodies that
were crossed before."""
_MERGED, _MERGED_SIGMA = 0.67, 0.12
"""Place of the one echo of both faces of a thin body over the optical thickness, and its standard
deviation: of nine random bodies."""
_THIN, _THICK = 0.5, 0.8
"""Optical thickness over the range cell up to which both faces send one echo, and from which on
two."""
_HIDDEN = 0.5
"""Share of the echoes that a body leaves of what is behind it."""
_PLASTIC, _METAL = np.array([0.3, 0.3, 0.25, 0.15]), np.array([0.85, 0.0, 0.0, 0.15])
"""Shares of echoes of front faces, back faces, both, and clutter before the scan is seen."""
_PRIOR_WEIGHT = 0.2
"""Their weight against the shares of the scan."""
_WIDEST, _NARROWER = 2.5, 0.5
"""Standard deviations of the first round over those at last, and their change in each round."""
_LIKELY = 0.15
"""Least probability of a face that is used."""
_MIN_GLINTS = 10
"""Glints without which no surface is fitted."""


class Faces(NamedTuple):
    """Glints on the faces that they are echoes of, and the surface that explains them."""

    glints: Glints
    """At the faces, with outward normals."""
    sources: Ints
    """Glint that each comes from, (n,)."""
    is_back: Bools
    """Which of them are back faces, seen through the body, (n,)."""
    log_likelihood: float
    """Mean of the glints' log densities [log 1 / m^3]."""
    shares: Floats
    """Shares of fronts, backs, both, and clutter, (4,)."""


class _Lines(NamedTuple):
    """What each line of sight crosses, (n_glints, n_bodies) each."""

    behind_m: Floats  # depth of the glint behind the apparent entry
    thickness_m: Floats
    before_m: Floats  # path in bodies crossed before
    entry: Floats  # agreement of the surface's normal with the glint's where the line enters
    leave: Floats  # and where it leaves
    exists: Bools
    area_m2: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Scan:
    """Glints whose faces are searched, and what the search needs of their scan."""

    glints: Glints
    surface_through: SurfaceThrough
    cell_m: float
    """Range cell [m]."""
    volume_m3: float
    """Volume of the box, in which clutter is uniform [m^3]."""
    num_threads: int | None = None
    """All when None."""


def find_faces(scan: Scan) -> Faces | None:
    """Faces of plastic, where they explain the glints better than fronts of metal; else None."""
    fronts = _improve(scan, _start(scan.glints, _METAL), _METAL, range(_ROUNDS - 1, _ROUNDS))
    if fronts is not None and fronts.shares[3] < _UNEXPLAINED:
        return None
    found = []
    for start_m in _STARTS_M:
        start = scan.glints.positions + start_m * scan.glints.normals
        faces = _start(replace(scan.glints, positions=start), _PLASTIC)
        found.append(_improve(scan, faces, _PLASTIC, range(_ROUNDS)))
    best = max(filter(None, found), key=lambda f: f.log_likelihood, default=None)
    if fronts is None or best is None:
        return best
    fronts = _improve(scan, fronts, _METAL, range(_ROUNDS // 2, _ROUNDS)) or fronts
    return best if best.log_likelihood > fronts.log_likelihood else None


def _start(glints: Glints, shares: Floats) -> Faces:
    n = len(glints)
    return Faces(glints, np.arange(n), np.zeros(n, dtype=bool), -np.inf, shares)


def _improve(scan: Scan, faces: Faces, prior: Floats, rounds: range) -> Faces | None:
    """Faces after some rounds; None where the surface does not close."""
    weights = scan.glints.probability * relative_strengths(scan.glints.strengths)
    weights = weights / weights.sum()
    for number in rounds:
        width = max(1.0, _WIDEST - _NARROWER * number)
        try:
            lines = _cross(scan, faces.glints, width)
        except UserError:
            return None
        density = _densities(lines, faces.shares, width, scan.cell_m)
        total = density.sum(axis=(1, 2)) + faces.shares[3] / scan.volume_m3
        chances = density / total[:, None, None]
        seen = weights @ chances.sum(axis=1)
        shares = (1.0 - _PRIOR_WEIGHT) * np.append(seen, 1.0 - seen.sum())
        faces = _place(scan.glints, lines, chances)._replace(
            log_likelihood=float(weights @ np.log(total)), shares=shares + _PRIOR_WEIGHT * prior
        )
        if len(faces.glints) < _MIN_GLINTS:
            return None
    return faces


def _cross(scan: Scan, placed: Glints, width: float) -> _Lines:
    """Crossings of the lines of sight with the surface through glints that were put on faces."""
    glints, (vertices, faces) = scan.glints, scan.surface_through(placed)
    scene, tree = MeshScene(vertices, faces, num_threads=scan.num_threads), KDTree(vertices)
    normals = vertex_normals(vertices, faces)
    start = glints.positions + AHEAD_M * glints.normals
    found = scene.entry_exit(start, -glints.normals)
    exists = np.isfinite(found.t_entry) & np.isfinite(found.t_exit)
    entry, leave = (np.where(exists, t, 0.0) for t in (found.t_entry, found.t_exit))
    before = np.cumsum(leave - entry, axis=1) - (leave - entry)

    def agreement(distance_m: Floats, sign: float) -> Floats:
        points = start[:, None] - distance_m[..., None] * glints.normals[:, None]
        cosine = sign * np.einsum("nki,ni->nk", normals[tree.query(points)[1]], glints.normals)
        turn2 = 2.0 - 2.0 * np.clip(cosine, -1.0, 1.0)
        return np.asarray(np.exp(-0.5 * turn2 / (width * ECHO_NOISE.peak_normal_rad**2)))

    return _Lines(
        behind_m=AHEAD_M - entry - (INDEX - 1.0) * before,
        thickness_m=leave - entry,
        before_m=before,
        entry=agreement(entry, 1.0),
        leave=agreement(leave, -1.0),
        exists=exists,
        area_m2=float(face_areas(vertices[faces]).sum()),
    )


def _densities(lines: _Lines, shares: Floats, width: float, cell_m: float) -> Floats:
    """Density of glints by fronts, backs, and both faces, (n_glints, n_bodies, 3) [1 / m^3]."""
    optical, before = INDEX * lines.thickness_m, _SIGMA_OF_BODY * lines.before_m
    own = width * _SIGMA_M + before
    thin = np.clip((_THICK - optical / cell_m) / (_THICK - _THIN), 0.0, 1.0)
    both = thin * lines.entry * lines.leave
    hidden = lines.exists * _HIDDEN ** np.arange(optical.shape[1]) / lines.area_m2
    front = (lines.entry - both) * normal_density(lines.behind_m, own)
    back = (lines.leave - 0.5 * both) * normal_density(
        lines.behind_m - optical, own + _SIGMA_OF_PATH * optical
    )
    merged = both * normal_density(
        lines.behind_m - _MERGED * optical, own + _MERGED_SIGMA * optical
    )
    return np.stack([front, back, merged], axis=2) * shares[:3] * hidden[..., None]


def _place(glints: Glints, lines: _Lines, chances: Floats) -> Faces:
    """Glints at the two likeliest of their faces."""
    flat = chances.reshape(len(glints), -1)
    order = np.argsort(-flat, axis=1)[:, :2]
    rows, choices = np.repeat(np.arange(len(glints)), order.shape[1]), order.ravel()
    body, kind = np.divmod(choices, 3)
    both = np.flatnonzero(kind == 2)  # evidence of either face
    rows, body = np.append(rows, rows[both]), np.append(body, body[both])
    chance, kind = flat[rows, np.append(choices, choices[both])], np.append(kind, kind[both] + 1)
    likely = chance > _LIKELY
    rows, body, kind, chance = rows[likely], body[likely], kind[likely], chance[likely]
    behind, thickness, before = (
        values[rows, body] for values in (lines.behind_m, lines.thickness_m, lines.before_m)
    )
    none, merged = np.zeros(len(rows)), _MERGED * INDEX * thickness
    moved = [none, (1.0 - 1.0 / INDEX) * behind, merged, merged - thickness]
    merged_sigma = _MERGED_SIGMA * INDEX * thickness
    sigma = [none, _SIGMA_OF_PATH * thickness, merged_sigma, merged_sigma]
    moved_m = np.choose(kind, moved) + (INDEX - 1.0) * before
    sigma_m = np.choose(kind, sigma) + _SIGMA_OF_BODY * before
    own, is_back = glints.select(rows), kind % 2 == 1
    placed = replace(
        own,
        positions=own.positions + moved_m[:, None] * own.normals,
        normals=np.where(is_back[:, None], -own.normals, own.normals),
        position_sigma_m=np.hypot(own.position_sigma_m, sigma_m),
        probability=own.probability * chance,
    )
    return Faces(placed, rows, is_back, -np.inf, _PLASTIC)
