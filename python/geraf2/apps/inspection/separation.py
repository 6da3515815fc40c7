"""Bodies of a content: where the normals of its echoes meet.

Lines into a body along the normals of its echoes meet near its middle, and those into another body
near another one. So echoes show bodies apart where the smooth surface bridges their gap, or is
missing because each single echo of a body is more likely clutter than not.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter
from scipy.ndimage import label as numbered
from scipy.spatial import ConvexHull, KDTree
from scipy.special import expit, ndtr

from geraf2._types import Bools, Floats, Ints
from geraf2.apps.inspection.bodies import MIN_PART_SHARE, Body, body_of, capped, part_of
from geraf2.echoes.labels import Label
from geraf2.freespace.specular import specular_visibility
from geraf2.geometry.triangles import (
    directed_edges,
    unit_normals,
    used_vertices,
    vertex_normals,
)
from geraf2.io.mesh import Evidence, TriangleMesh
from geraf2.io.points import Cloud, read_cloud
from geraf2.io.run_folder import PEAKS_NAME
from geraf2.ops.visibility import MeshScene
from geraf2.pipeline.reconstruction import Reconstruction
from geraf2.scene import Grid
from geraf2.scene.aperture import Aperture

_FRONT_M = np.arange(0.008, 0.017, 0.002)
"""Depths of a middle below a front face [m]: half of the width of things of 2 to 3 cm."""
_DEPTHS_M = np.concatenate([_FRONT_M, -1.5 * _FRONT_M])
"""Depths of a middle below an echo [m]. The back face of plastic is delayed and focused by it, and
its echo comes from behind the middle: 10 to 25 mm in nine boxes (`bench/python/bodies.py`)."""
_ROUNDS = 3
"""Times that an echo chooses anew between its depths: further ones change little."""
_SPREAD_M = 0.005
"""Standard deviation of a vote [m]: normals err by .25 rad in two directions, 4 mm at this depth,
and positions along the surface by as much as an echo of half a sub-aperture's resolution."""
_STEP_M, _MAX_STEPS = 0.0025, 120
"""Spacing of the votes [m], and most of them along a side."""
_MIN_VOTES = 0.5
"""Fewest planes of which echoes meet in a basin."""
_MIN_SHARE = 0.3
"""Least share of the planes that see a body: most of 61 scans with one to four bodies counted right
(research/2026-11-core.md). .20 to .93 see 52 bodies of them, .19 and less elsewhere."""
_ONE = 0.8
"""Planes whose echoes meet between two maxima, over those of the lower maximum, above which both
are one: .85 to .93 in five bodies there, 0 to .68 between bodies."""
_BAND_M, _PATCH_M2 = 0.004, 10e-6
"""Surface within this distance of a cut is on it [m]: about a sub-aperture's resolution. Area of it
that is seen or not as one [m^2]."""
_LIFT_M = 0.003
"""Rays start this far above the surface [m]: the error of a bridge."""
_SEEN, _BRIDGE_SEEN = 0.9, 0.1
"""Shares of surface faced by planes from which echoes came: .64 to 1 in 18 sections of bodies (four
captures of independent simulators), 0 to .45 in 5 bridges (seeds 10000 to 10002)."""
_MIN_PROBABILITY = 0.1
"""Least probability of an echo of a surface: noise has less."""
_ONCE = 0.95
"""Probability that a body is counted once, if all basins and cuts are right: without it 15.5 of 18
boxes with 58 bodies are expected to be right, and 13 are (`bench/python/bodies.py`, seeds 0 to 9
and 10000 to 10007)."""
_SIGMA_M = 0.004
"""Standard uncertainty of the hull of uncertain echoes [m]."""


class Echoes(NamedTuple):
    """Peaks in the box that may be returns of the content."""

    positions: Floats
    """(n, 3) [m]."""
    normals: Floats
    """Outward, (n, 3)."""
    probability: Floats
    """That each is a return, (n,)."""


class Separated(NamedTuple):
    """Bodies of a content."""

    bodies: list[Body]
    """Those with a surface, the largest first; closed with unseen surface at the cuts."""
    faint: list[Body]
    """Those without: hulls of their echoes."""
    probability: float
    """That so many are right: each exists, is cut where it should be, and nowhere else."""


def separated(
    pieces: Sequence[Body],
    echoes: Echoes,
    apertures: Sequence[Aperture],
    num_threads: int | None = None,
) -> Separated:
    """Cut connected parts, and add bodies without a surface, where echoes of many planes meet.

    A part is cut between two such points where planes face its surface and it did not echo. What
    lies at an echo of a back face did not.

    pieces: connected parts. apertures: of the planes. Bodies that touch stay one.
    """
    certain = float(np.prod([piece.probability for piece in pieces]))
    regions = _regions(echoes, apertures)
    if regions is None:
        return Separated(list(pieces), [], certain)
    owners = [regions.of(piece) for piece in pieces]
    areas = [
        np.bincount(owner[owner >= 0], piece.areas_m2[owner >= 0], minlength=len(regions.seen))
        for owner, piece in zip(owners, pieces, strict=True)
    ]
    home = np.argmax(areas, axis=0)
    total = sum(float(piece.areas_m2.sum()) for piece in pieces)
    home[np.max(areas, axis=0) < MIN_PART_SHARE * total] = -1
    bodies, faint = list[Body](), list[Body]()
    for k, (piece, owner) in enumerate(zip(pieces, owners, strict=True)):
        own = np.flatnonzero((home == k) & (regions.seen > 0.5))
        if len(own) < 2:
            bodies.append(piece)
            continue
        nearest = own[KDTree(regions.middles[own]).query(piece.mesh.vertices)[1]]
        basin = np.where(np.isin(owner, own), owner, nearest)
        cut, sure = _cut(piece, basin, regions.seen_in(piece, echoes), apertures, num_threads)
        bodies, certain = bodies + cut, certain * sure
    for r in np.flatnonzero(home < 0):
        certain *= max(regions.seen[r], 1.0 - regions.seen[r])
        hull = regions.hull(echoes, int(r)) if regions.seen[r] > 0.5 else None
        faint += [] if hull is None else [hull]
    bodies.sort(key=lambda body: -float(body.areas_m2.sum()))
    return Separated(bodies, faint, certain * _ONCE ** (len(bodies) + len(faint)))


def echoes_in(result: Reconstruction) -> Echoes:
    """Direct and uncertain echoes in the box of a run; none of a run without labels."""
    cloud = labelled_peaks(result)
    if cloud is None:
        return Echoes(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    own = np.isin(cloud.columns["label"], (Label.CLUTTER, Label.DIRECT))
    return Echoes(cloud.positions[own], cloud.normals[own], cloud.columns["probability"][own])


def labelled_peaks(result: Reconstruction) -> Cloud | None:
    """Peaks of a run with their labels and probabilities; None of a run without labels."""
    path = result.run.written(PEAKS_NAME)
    cloud = None if path is None else read_cloud(path)
    return cloud if cloud and {"label", "probability"} <= set(cloud.columns) else None


def _likely(echoes: Echoes) -> Bools:
    """Echoes that are more than noise, (n,)."""
    least = min(_MIN_PROBABILITY, echoes.probability.max(initial=0.0))
    return np.asarray(echoes.probability >= least)


def bridge_probability(seen_m2: float, faced_m2: float) -> float:
    """Probability that a section of surface bridges a gap between two bodies.

    faced_m2: area that planes face [m^2]. seen_m2: of it, from which echoes came [m^2].
    """
    seen = seen_m2 * np.log(_BRIDGE_SEEN / _SEEN)
    unseen = (faced_m2 - seen_m2) * np.log((1.0 - _BRIDGE_SEEN) / (1.0 - _SEEN))
    return float(expit((seen + unseen) / _PATCH_M2))


def joined_by(necks: Sequence[tuple[float, int, int]], n: int) -> tuple[Ints, float]:
    """Group of each of n regions, (n,), and the probability that these groups are right.

    necks: probability of a bridge, and the two regions; those hardly a bridge join them first. What
    is joined already is one, whatever less certain necks are.
    """
    group, certain = np.arange(n), 1.0
    for bridge, i, j in sorted(necks):
        if group[i] != group[j]:
            certain *= max(bridge, 1.0 - bridge)
            group[group == group[i]] = group[j] if bridge <= 0.5 else group[i]
    return group, certain


def _cut(
    piece: Body,
    owner: Ints,
    seen: Bools,
    apertures: Sequence[Aperture],
    num_threads: int | None,
) -> tuple[list[Body], float]:
    """Cut a part at its bridges; also the probability that all cuts are right.

    owner: region of each vertex, (n_vertices,). seen: vertices that echoed, (n_vertices,).
    """
    mesh, areas = piece.mesh, piece.areas_m2
    scene = MeshScene(mesh.vertices, mesh.faces, num_threads=num_threads)
    normals = vertex_normals(mesh.vertices, mesh.faces)
    margins = specular_visibility(mesh.vertices, normals, apertures, scene, lift_m=_LIFT_M)
    areas = np.where((margins > -np.inf).any(axis=1), areas, 0.0)
    edges = directed_edges(mesh.faces)
    ends, necks = np.sort(owner[edges], axis=1), list[tuple[float, int, int]]()
    for i, j in np.unique(ends[ends[:, 0] < ends[:, 1]], axis=0):
        rim = mesh.vertices[np.unique(edges[(ends == (i, j)).all(axis=1)])]
        band = np.where(KDTree(rim).query(mesh.vertices)[0] < _BAND_M, areas, 0.0)
        bridge = bridge_probability(float(band[seen].sum()), float(band.sum()))
        necks.append((bridge, int(i), int(j)))
    group, certain = joined_by(necks, int(owner.max()) + 1)
    of_face = group[owner[mesh.faces[:, 0]]]
    parts = [mesh.faces[of_face == k] for k in np.unique(of_face)]
    return [piece] if len(parts) < 2 else [capped(part_of(piece, part)) for part in parts], certain


class _Regions(NamedTuple):
    """Where echoes meet: basins of their density, each of a body or of none."""

    points: Floats
    """Grid points, (n, 3) [m]."""
    labels: Ints
    """Basin of each, (n,)."""
    middles: Floats
    """Where most echoes meet in each, (n_basins, 3) [m]."""
    echoes: Ints
    """Basin of each echo, -1 of none, (n_echoes,)."""
    back: Bools
    """Echoes that are of a back face, (n_echoes,)."""
    seen: Floats
    """Probability that enough planes see something there, (n_basins,)."""

    def of(self, body: Body) -> Ints:
        """Basin below each vertex of a part, -1 where there is none, (n_vertices,)."""
        normals = vertex_normals(body.mesh.vertices, body.mesh.faces)
        inner = body.mesh.vertices - _FRONT_M.mean() * normals
        return self.at(inner)

    def at(self, points: Floats) -> Ints:
        """Basin at each point, -1 where there is none, (n,)."""
        gap, at = KDTree(self.points).query(points)
        return np.where(gap < _SPREAD_M, self.labels[at], -1)

    def seen_in(self, body: Body, echoes: Echoes) -> Bools:
        """Vertices that echoes support, and not of a back face, (n_vertices,)."""
        likely = np.flatnonzero(_likely(echoes))
        nearest = likely[KDTree(echoes.positions[likely]).query(body.mesh.vertices)[1]]
        return np.asarray(body.seen & ~self.back[nearest])

    def hull(self, echoes: Echoes, body: int) -> Body | None:
        """Body of the convex hull of its echoes, seen nowhere for certain; None of too few.

        Those of back faces, behind it, only where there are no others.
        """
        own = (self.echoes == body) & _likely(echoes)
        front = own & ~self.back
        points = echoes.positions[front if front.sum() > 3 else own]
        if len(points) <= 3:
            return None
        hull = ConvexHull(points)
        used, faces = used_vertices(hull.simplices.astype(np.int64))
        vertices = points[used]
        inwards = (unit_normals(vertices[faces]) * hull.equations[:, :3]).sum(axis=1) < 0.0
        faces[inwards] = faces[inwards][:, ::-1]
        mesh = TriangleMesh(
            vertices=vertices,
            faces=faces,
            expected_error_m=np.full(len(used), _SIGMA_M),
            evidence=np.full(len(used), Evidence.NOT_SEEN, dtype=np.uint8),
        )
        return replace(body_of(mesh), probability=float(self.seen[body]))


class _Votes(NamedTuple):
    """What echoes vote for."""

    grid: Grid
    planes: Floats
    """Mean number of planes whose echoes meet at each point of the grid."""
    variance: Floats
    """Of that number."""
    at: Ints
    """Points of the grid that each echo votes for, (n_echoes, n_depths)."""
    shares: Floats
    """Probability of each of them, if the echo is of a body, (n_echoes, n_depths)."""


def _regions(echoes: Echoes, apertures: Sequence[Aperture]) -> _Regions | None:
    """Catchment basins of the number of planes whose echoes meet, merged where hardly divided.

    None where no echoes meet.
    """
    from skimage.segmentation import watershed  # noqa: PLC0415 - scikit-image takes 0.3 s

    if not len(echoes.probability) or not apertures:
        return None
    grid, planes, variance, cells, shares = _votes(echoes, apertures)
    peaks = (maximum_filter(planes, size=3) == planes) & (planes > _MIN_VOTES)
    labels = (
        watershed(-planes, numbered(peaks, np.ones((3, 3, 3)))[0], mask=planes > _MIN_VOTES) - 1
    )
    order = np.argsort(planes, axis=None)
    order = order[labels.flat[order] >= 0]
    if not len(order):
        return None
    top = np.zeros(int(labels.max()) + 1, dtype=np.int64)
    top[labels.flat[order]] = order  # where each basin is highest
    kept, basin = np.unique(
        _merged(planes.flat[top], _saddles(planes, labels, len(top))), return_inverse=True
    )
    points, at, top = grid.points(), np.flatnonzero(labels >= 0), top[kept]
    label = np.where(labels >= 0, basin[labels], -1).flat[cells]
    of_echo = [(shares * (label == k)).sum(axis=1) for k in range(len(kept))]
    over = planes.flat[top] - _MIN_SHARE * len(apertures)
    return _Regions(
        points=points[at],
        labels=basin[labels.flat[at]],
        middles=points[top],
        back=shares[:, len(_FRONT_M) :].sum(axis=1) > 0.5,
        echoes=np.argmax([1.0 - np.sum(of_echo, axis=0), *of_echo], axis=0) - 1,
        seen=ndtr(over / np.sqrt(np.maximum(variance.flat[top], 1e-9))),
    )


def _votes(echoes: Echoes, apertures: Sequence[Aperture]) -> _Votes:
    """Where the echoes of most planes meet, each echo at one depth along its normal.

    An echo chooses depths by the square of the number of planes that meet there.
    """
    inner = echoes.positions[:, None] - _DEPTHS_M[:, None] * echoes.normals[:, None]
    low, high = inner.min(axis=(0, 1)) - 2 * _SPREAD_M, inner.max(axis=(0, 1)) + 2 * _SPREAD_M
    step = max(_STEP_M, float((high - low).max()) / _MAX_STEPS)
    nx, ny, nz = (int(n) + 2 for n in (high - low) / step)
    grid = Grid.centered(0.5 * (low + high), step, (nx, ny, nz))
    cells = np.rint((inner - grid.points()[0]) / step).astype(np.int64)
    at = np.ravel_multi_index(tuple(np.moveaxis(cells, -1, 0)), grid.shape)
    plane = _planes_of(echoes, apertures)
    shares = np.full(at.shape, 1.0 / len(_DEPTHS_M))
    for _ in range(_ROUNDS):
        planes = _meeting(grid, at, echoes.probability[:, None] * shares, plane)[0]
        shares = planes.flat[at] ** 2
        shares /= shares.sum(axis=1, keepdims=True)
    planes, variance = _meeting(grid, at, echoes.probability[:, None] * shares, plane)
    return _Votes(grid, planes, variance, at, shares)


def _meeting(grid: Grid, at: Ints, weights: Floats, plane: Ints) -> tuple[Floats, Floats]:
    """Mean number of planes whose echoes meet at each point of a grid, and its variance.

    A plane votes with the probability that at least one of its echoes is a return of a body there.
    at, weights: cells that echoes vote for and probabilities, (n, n_depths). plane: of each, (n,).
    """
    mean, variance = np.zeros(grid.shape), np.zeros(grid.shape)
    scale = (2.0 * np.pi) ** 1.5 * (_SPREAD_M / grid.spacing_m) ** 3
    for k in np.unique(plane):
        own = plane == k
        votes = np.bincount(at[own].ravel(), scale * weights[own].ravel(), minlength=mean.size)
        none = np.exp(-gaussian_filter(votes.reshape(grid.shape), _SPREAD_M / grid.spacing_m))
        mean += 1.0 - none
        variance += none * (1.0 - none)
    return mean, variance


def _planes_of(echoes: Echoes, apertures: Sequence[Aperture]) -> Ints:
    """Plane that each echo came to: the one that its normal points at best, (n,)."""
    towards = np.stack([aperture.middle_m - echoes.positions for aperture in apertures])
    towards /= np.linalg.norm(towards, axis=2, keepdims=True)
    return np.asarray(np.argmax((towards * echoes.normals).sum(axis=2), axis=0))


def _saddles(values: Floats, labels: Ints, n: int) -> Floats:
    """Largest value on the boundary of two basins; 0 where they have none, (n, n)."""
    saddles = np.zeros((n, n))
    for axis in range(3):
        a, b = (np.moveaxis(labels, axis, 0)[part] for part in (np.s_[:-1], np.s_[1:]))
        d, e = (np.moveaxis(values, axis, 0)[part] for part in (np.s_[:-1], np.s_[1:]))
        at = (a != b) & (a >= 0) & (b >= 0)
        np.maximum.at(saddles, (a[at], b[at]), np.minimum(d, e)[at])
    return np.asarray(np.maximum(saddles, saddles.T))


def _merged(heights: Floats, saddles: Floats) -> Ints:
    """Basin that each belongs to, (n,): the least divided pair is merged first, into the higher."""
    owner, saddles = np.arange(len(heights)), saddles.copy()
    while True:
        share = saddles / np.minimum(heights[:, None], heights)
        if share.max() < _ONE:
            return owner
        pair = np.unravel_index(np.argmax(share), share.shape)
        low, high = sorted(map(int, pair), key=lambda k: float(heights[k]))
        owner[owner == low] = high
        saddles[high] = saddles[:, high] = np.maximum(saddles[high], saddles[low])
        saddles[low] = saddles[:, low] = saddles[high, high] = 0.0
