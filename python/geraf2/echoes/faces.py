"""Front and back faces of a dielectric body (docs/math/echoes.md#back-faces).

A wave that enters a body of refractive index n at f and is reflected after the thickness t seems to
come from f + n t. The body of a shell is the air in it, of index 1. Which echoes are of back faces
follows from the surface, and the surface from the echoes: both are estimated in turns, by
expectation maximisation, from what a network that has seen objects takes each echo for.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats, Ints
from geraf2.echoes.face_network import FaceGuess, guess_faces
from geraf2.echoes.glint_set import Glints, relative_strengths
from geraf2.echoes.noise import ECHO_NOISE, normal_density
from geraf2.errors import UserError
from geraf2.geometry.components import are_voids, connected_labels, face_labels
from geraf2.geometry.triangles import face_areas, used_vertices, vertex_normals
from geraf2.ops.visibility import MeshScene

SurfaceThrough = Callable[[Glints], tuple[Floats, Ints]]
"""Vertices [m] and faces of a closed surface through glints; UserError where there is none."""

INDEX, AIR = 1.67, 1.0
"""Refractive index of plastics, 1.58 to 1.82, and of what a shell holds."""
AHEAD_M = 0.4
"""Start of a line of sight in front of its glint, outside of any content [m]."""
_LOG_ODDS, _OF_SHARE, _OF_GAIN = -2.7, 14.6, 3.6
"""Log odds of plastic against metal, what the share of the strength adds that is taken for echoes
of back faces, and each nat by which plastic predicts a glint better. Maximum likelihood of 97 scans
of metal, of which one is taken for plastic, and of 54 of plastic, of which ten are taken for metal;
28 are of balls."""
_FRONTS, _MIN_PLANES = 0.03, 6
"""Share of the same below which no gain is large enough, and the fewest planes of the scans that
the network has learned from."""
_SHELL = 0.36
"""Least growth, over solid plastic, of the mean log density of glints by a shell [nats]. The
network knows solid bodies alone. Maximum likelihood of 18 scans of solid plastic and 14 of
shells, of which ten are mistaken."""
_LEAST_CLUTTER = 0.02
"""Probability of clutter, at least, of a glint that other planes should predict."""
LEAST_PROBABILITY = 0.1
"""Of a glint of plastic. Its faces send weaker echoes than metal, and clutter is told by the
network and the surface."""
_ENOUGH = 768
"""Glints that decide on the material: the share of back faces is known to about 0.01 from them."""
SIDE_LOBE, _STRONGER, _SAME_RAD = 2.2, 3.0, 0.2
"""Place of the range window's side lobe in front of an echo [range cells], the least ratio of both
amplitudes, and the largest angle of both directions [rad]."""
_ROUNDS, _ROUNDS_LEFT_OUT = 6, 1
"""Rounds of expectation and maximisation, of all planes and where half of them are left out."""
_SIGMA_M, _SIGMA_OF_PATH, _SIGMA_OF_BODY = 0.002, 0.05, 0.08
"""Standard deviation of an echo about its face [m]; over the path in the body, and in bodies that
were crossed before."""
MERGED, MERGED_SIGMA = 0.67, 0.12
"""Place of the one echo of both faces of a thin body over the optical thickness, and its standard
deviation: of nine random bodies."""
THIN, THICK = 0.5, 0.8
"""Optical thickness over the range cell up to which both faces send one echo, and from which on
two."""
_LIFT_M = 5e-4
"""Step of a refracted line off the face that it enters [m]."""
_LIKELY = 0.15
"""Least probability of a face that is used."""
_LINK_M, _STRAY = 0.015, 0.01
"""Distance within which glints are one group [m], and the weight of a stray group, or the area of a
stray piece, over that of the largest one: clutter that other planes do not see is in one place."""
MIN_GLINTS = 10
"""Glints without which no surface is fitted."""


class Faces(NamedTuple):
    """Glints on the faces that they are echoes of."""

    glints: Glints
    """At the faces, with outward normals."""
    sources: Ints
    """Glint that each comes from, (n,)."""
    is_back: Bools
    """Which of them are back faces, seen through the body, (n,)."""

    def of_glints(self, n_glints: int) -> tuple[Bools, Bools]:
        """Which glints have a front face, and which a back face alone, (n_glints,) each."""
        front, back = np.zeros((2, n_glints), dtype=bool)
        front[self.sources[~self.is_back]] = True
        back[self.sources[self.is_back]] = True
        return front, back & ~front


class _Lines(NamedTuple):
    """What each line of sight crosses, (n_glints, n_bodies) each."""

    behind_m: Floats  # depth of the glint behind the apparent entry
    thickness_m: Floats  # along the refracted line
    before_m: Floats  # path in bodies crossed before
    entry: Floats  # agreement of the surface's normal with the glint's where the line enters
    leave: Floats  # and with the refracted line where it leaves
    exists: Bools
    entries: Floats  # points, (n_glints, n_bodies, 3)
    inside: Floats  # directions of the refracted lines, (n_glints, n_bodies, 3)
    area_m2: float
    n: float  # refractive index


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


def likeliest_index(likely: Glints, scan: Scan) -> float | None:
    """Refractive index of the body that glints are echoes of; None of metal.

    The network sees back faces of plastic. Surfaces through the glints of every second plane have
    to predict those of the others: by fronts alone, as of metal, or by both faces of solid plastic
    or of a shell along each line of sight.

    likely: probable glints. scan: with fainter ones, too.
    """
    n_planes, share = len(np.unique(scan.glints.poses)), back_share(_drawn(likely))
    if n_planes < _MIN_PLANES or share < _FRONTS:
        return None
    scan = replace(scan, glints=_drawn(scan.glints))
    scan = replace(scan, glints=scan.glints.select(~_side_lobes(scan)))
    guess, halves = guess_faces(scan.glints), _halves(scan.glints)
    fronts = np.zeros_like(guess.probability)
    fronts[:, 0], fronts[:, 3] = 1.0 - guess.probability[:, 3], guess.probability[:, 3]
    metal = _predicted(scan, halves, guess._replace(probability=fronts), None)
    solid, shell = (_predicted(scan, halves, guess, index) for index in (INDEX, AIR))
    gain = max(solid, shell) - metal
    gain = gain if np.isfinite(gain) else 0.0  # without a surface nothing is predicted
    if _LOG_ODDS + _OF_SHARE * share + _OF_GAIN * gain < 0.0:
        return None
    return AIR if shell - solid > _SHELL else INDEX


def _drawn(glints: Glints) -> Glints:
    return glints.select(np.random.default_rng(0).permutation(len(glints))[:_ENOUGH])


def _halves(glints: Glints) -> tuple[Bools, Bools]:
    """Glints of every second plane around the content, whatever the order of planes, and others."""
    plane = np.unique(glints.poses, return_inverse=True)[1]
    east, north = (np.bincount(plane, glints.normals[:, axis]) for axis in (0, 1))
    rank = np.argsort(np.argsort(np.arctan2(north, east)))
    is_odd = rank[plane] % 2 == 1
    return is_odd, ~is_odd


def _predicted(
    scan: Scan, halves: tuple[Bools, Bools], guess: FaceGuess, index: float | None
) -> float:
    """Mean log density of each half by the faces that the other shows; -inf without a surface."""
    glints, log_density = scan.glints, np.zeros(len(scan.glints))
    if min(half.sum() for half in halves) < MIN_GLINTS:
        return -np.inf
    for shown, left_out in (halves, halves[::-1]):
        own = replace(scan, glints=glints.select(shown))
        faces = _maximise(own, guess.select(shown), index, _ROUNDS_LEFT_OUT)
        if faces is None:
            return -np.inf
        try:
            lines = _cross(replace(scan, glints=glints.select(left_out)), faces.glints, index)
        except UserError:
            return -np.inf
        density, clutter = _explained(scan, lines, guess.select(left_out))
        least = _LEAST_CLUTTER / scan.volume_m3
        log_density[left_out] = np.log(density.sum(axis=(1, 2)) + np.maximum(clutter, least))
    return float(glints.probability @ log_density / glints.probability.sum())


def find_faces(scan: Scan, index: float = INDEX) -> Faces | None:
    """Faces of plastic of a refractive index; None where their surface does not close."""
    kept = np.flatnonzero(~_side_lobes(scan))
    scan = replace(scan, glints=scan.glints.select(kept))
    faces = _maximise(scan, guess_faces(scan.glints), index, _ROUNDS)
    if faces is None:
        return None
    faces = _without_stray(faces)
    return faces._replace(sources=kept[faces.sources])


def _maximise(scan: Scan, guess: FaceGuess, index: float | None, n_rounds: int) -> Faces | None:
    """Alternate expectation and maximisation; None where a surface does not close."""
    if index == AIR:  # the network has seen solid bodies, whose depth it divided by their index
        guess = guess._replace(thickness_m=INDEX * guess.thickness_m)
    faces = _placed_by(scan.glints, guess, index or AIR)
    for _ in range(n_rounds):
        try:
            lines = _cross(scan, faces.glints, index)
        except UserError:
            return None
        density, clutter = _explained(scan, lines, guess)
        total = density.sum(axis=(1, 2)) + clutter
        faces = _place(scan.glints, lines, density / total[:, None, None])
        if len(faces.glints) < MIN_GLINTS:
            return None
    return faces


def _explained(scan: Scan, lines: _Lines, guess: FaceGuess) -> tuple[Floats, Floats]:
    """Densities of glints by each face, (n_glints, n_bodies, 3), and by clutter [1 / m^3]."""
    density = _densities(lines, scan.cell_m) * guess.probability[:, None, :3]
    return density, guess.probability[:, 3] / scan.volume_m3


def _without_stray(faces: Faces) -> Faces:
    """Leave out groups that hold a small part of what the largest one holds."""
    glints = faces.glints
    i, j = KDTree(glints.positions).query_pairs(_LINK_M, output_type="ndarray").T
    group = connected_labels(i, j, len(glints))
    held = np.bincount(group, glints.probability)
    stays = (held > _STRAY * held.max())[group]
    return Faces(glints.select(stays), faces.sources[stays], faces.is_back[stays])


def back_share(glints: Glints) -> float:
    """Share of the strength that the network takes for echoes of back faces."""
    weights = glints.probability * relative_strengths(glints.strengths)
    return float(weights @ guess_faces(glints).probability[:, 1:3].sum(axis=1) / weights.sum())


def _side_lobes(scan: Scan) -> Bools:
    """Glints where the range window of a far stronger back face shows a side lobe, (n_glints,)."""
    glints, found = scan.glints, np.zeros(len(scan.glints), dtype=bool)
    lobe_m = SIDE_LOBE * scan.cell_m
    tree = KDTree(glints.positions)
    ahead = glints.positions - lobe_m * glints.normals
    for number, near in enumerate(tree.query_ball_point(ahead, 0.25 * scan.cell_m)):
        same = np.array(near, dtype=np.int64)
        same = same[glints.poses[same] == glints.poses[number]]
        along = glints.normals[same] @ glints.normals[number] > 1.0 - 0.5 * _SAME_RAD**2
        stronger = glints.strengths[same] > _STRONGER * glints.strengths[number]
        found[number] = bool((along & stronger).any())
    return found


def _placed_by(glints: Glints, guess: FaceGuess, index: float) -> Faces:
    """Glints on the faces, and at the thickness, that the network takes them for."""
    n, depth_m = len(glints), index * guess.thickness_m[:, None]
    lines = _Lines(
        behind_m=depth_m,
        thickness_m=guess.thickness_m[:, None],
        before_m=np.zeros((n, 1)),
        entry=np.ones((n, 1)),
        leave=np.ones((n, 1)),
        exists=np.ones((n, 1), dtype=bool),
        entries=(glints.positions + depth_m * glints.normals)[:, None],
        inside=-glints.normals[:, None],
        area_m2=1.0,
        n=index,
    )
    return _place(glints, lines, guess.probability[:, None, :3])


def _cross(scan: Scan, placed: Glints, index: float | None = INDEX) -> _Lines:
    """Crossings of the lines of sight with the surface through glints that were put on faces.

    A shell may hold bodies, which its air does not hide: a line goes through each of them alone.
    Metal, whose index is None, has no echo where a line leaves it.
    """
    if index is None:
        lines = _cross(scan, placed, AIR)
        return lines._replace(leave=np.zeros_like(lines.leave))
    vertices, faces = scan.surface_through(placed)
    if index != AIR:
        return _cross_body(scan, vertices, faces, index)
    labels, n_pieces = face_labels(faces)
    areas = np.bincount(labels, face_areas(vertices[faces]), n_pieces)
    areas[are_voids(vertices, faces, labels, n_pieces)] = 0.0
    if not areas.any():  # it is inside out
        return _cross_body(scan, vertices, faces, index)
    found = []
    for piece in np.flatnonzero(areas > _STRAY * areas.max()):
        used, own = used_vertices(faces[labels == piece])
        found.append(_cross_body(scan, vertices[used], own, index))
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(lines, name) for lines in found], axis=1)
        for name in _Lines._fields[:-2]
    }
    return _Lines(**arrays, area_m2=sum(lines.area_m2 for lines in found), n=index)


def _cross_body(scan: Scan, vertices: Floats, faces: Ints, index: float) -> _Lines:
    glints = scan.glints
    scene, tree = MeshScene(vertices, faces, num_threads=scan.num_threads), KDTree(vertices)
    normals = vertex_normals(vertices, faces)
    start, ahead = glints.positions + AHEAD_M * glints.normals, -glints.normals[:, None]
    found = scene.entry_exit(start, ahead[:, 0])
    exists = np.isfinite(found.t_entry) & np.isfinite(found.t_exit)
    entry, leave = (np.where(exists, t, 0.0) for t in (found.t_entry, found.t_exit))
    before = np.cumsum(leave - entry, axis=1) - (leave - entry)
    entries = start[:, None] + entry[..., None] * ahead
    at_entry = normals[tree.query(entries)[1]]
    inside = refract(ahead, at_entry, 1.0 / index)
    lifted = entries + _LIFT_M * inside
    thickness = scene.closest_hit(lifted.reshape(-1, 3), inside.reshape(-1, 3))[0] + _LIFT_M
    exists &= np.isfinite(thickness.reshape(entry.shape))
    thickness = np.where(exists, thickness.reshape(entry.shape), 0.0)
    at_exit = normals[tree.query(entries + thickness[..., None] * inside)[1]]

    def agreement(outward: Floats, directions: Floats) -> Floats:
        turn2 = ((outward - directions) ** 2).sum(axis=2)
        return np.asarray(np.exp(-0.5 * turn2 / ECHO_NOISE.peak_normal_rad**2))

    return _Lines(
        behind_m=AHEAD_M - entry - (index - 1.0) * before,
        thickness_m=thickness,
        before_m=before,
        entry=agreement(at_entry, -ahead),
        leave=agreement(at_exit, inside),
        exists=exists,
        entries=entries,
        inside=inside,
        area_m2=float(face_areas(vertices[faces]).sum()),
        n=index,
    )


def refract(directions: Floats, normals: Floats, ratio: float) -> Floats:
    """Directions of waves behind a surface, by Snell's law, (..., 3).

    directions: of the waves before it, unit vectors, (..., 3).
    normals: against them, unit vectors, (..., 3). A wave that comes from the other side is taken
        for a grazing one.
    ratio: of the refractive indices, before over behind, at most 1.
    """
    cosine = np.maximum(-(directions * normals).sum(axis=-1, keepdims=True), 0.0)
    inner = np.sqrt(1.0 - ratio**2 * (1.0 - cosine**2))
    bent = ratio * directions + (ratio * cosine - inner) * normals
    return np.asarray(bent / np.linalg.norm(bent, axis=-1, keepdims=True))


def _densities(lines: _Lines, cell_m: float) -> Floats:
    """Density of glints by fronts, backs, and both faces, (n_glints, n_bodies, 3) [1 / m^3]."""
    optical, before = lines.n * lines.thickness_m, _SIGMA_OF_BODY * lines.before_m
    own = _SIGMA_M + before
    thin = np.clip((THICK - optical / cell_m) / (THICK - THIN), 0.0, 1.0)
    both = thin * lines.entry * lines.leave
    front = (lines.entry - both) * normal_density(lines.behind_m, own)
    back = (lines.leave - 0.5 * both) * normal_density(
        lines.behind_m - optical, own + _SIGMA_OF_PATH * optical
    )
    merged = both * normal_density(lines.behind_m - MERGED * optical, own + MERGED_SIGMA * optical)
    return np.stack([front, back, merged], axis=2) * lines.exists[..., None] / lines.area_m2


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
    crossed = (lines.behind_m, lines.thickness_m, lines.before_m, lines.entries, lines.inside)
    behind, thickness, before, entry, inside = (values[rows, body] for values in crossed)
    own, is_back = glints.select(rows), kind % 2 == 1
    merged = MERGED * lines.n * thickness
    front = own.positions + ((lines.n - 1.0) * before)[:, None] * own.normals
    thin = front + merged[:, None] * own.normals
    far = entry + (behind / lines.n)[:, None] * inside
    places = [front, far, thin, thin + thickness[:, None] * inside]
    none, merged_sigma = np.zeros(len(rows)), MERGED_SIGMA * lines.n * thickness
    sigmas = [none, _SIGMA_OF_PATH * thickness, merged_sigma, merged_sigma]
    sigma_m = np.choose(kind, sigmas) + _SIGMA_OF_BODY * before
    placed = replace(
        own,
        positions=np.choose(kind[:, None], places),
        normals=np.where(is_back[:, None], inside, own.normals),
        position_sigma_m=np.hypot(own.position_sigma_m, sigma_m),
        probability=own.probability * chance,
    )
    return Faces(placed, rows, is_back)
