"""Necks: where the surface of one part may bridge the gap between two bodies.

The smooth surface of two near bodies bridges a gap that no plane sees. A bridge is narrower than
both bodies, and no echo came from it although planes face it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import label as numbered
from scipy.ndimage import maximum_filter
from scipy.spatial import KDTree
from scipy.special import expit

from geraf2._types import Floats, Ints
from geraf2.apps.inspection.bodies import Body, capped, part_of
from geraf2.freespace.specular import specular_visibility
from geraf2.geometry.components import connected_labels
from geraf2.geometry.triangles import vertex_normals
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Grid
from geraf2.scene.aperture import Aperture

_STEP_M, _MOST_STEPS = 0.002, 60
"""Spacing of the grid inside of a part [m], and most of its points along a side."""
_DEEPEST_SHARE = 0.9
"""Depth of a neck over that of the shallower side above which both sides are one."""
_LEAST_BODY_M3 = 0.25e-6
"""Least volume of a body [m^3]: a ball of 8 mm."""
_BAND_M = 0.004
"""Surface within this distance of a neck is on it [m]: about a sub-aperture's resolution."""
_LIFT_M = 0.003
"""Rays start this far above the surface [m]: the error of a bridge."""


_PATCH_M2 = 10e-6
"""Area of a neck that is seen or not as one [m^2]."""
_BRIDGE_SEEN = 0.1
"""Share of a bridge that is near an echo, of the bodies beside it."""
_PRIOR_LOG_ODDS = -1.25
"""Log odds that a neck is a bridge before its echoes are counted. All three are maximum likelihood
values of 31 necks, 6 of them bridges (`bench/python/bodies.py`, even seeds 0 to 18)."""


class Neck(NamedTuple):
    """Narrow section between two regions of a part."""

    regions: tuple[int, int]
    faced_m2: float
    """Area of its surface that planes face [m^2]."""
    seen: float
    """Share of this area from which echoes came."""
    usual: float
    """The same share of the whole part."""

    @property
    def probability(self) -> float:
        """That it bridges a gap between two bodies."""
        n, usual = self.faced_m2 / _PATCH_M2, max(self.usual, _BRIDGE_SEEN)
        seen = self.seen * np.log(_BRIDGE_SEEN / usual)
        unseen = (1.0 - self.seen) * np.log((1.0 - _BRIDGE_SEEN) / (1.0 - usual))
        return float(expit(_PRIOR_LOG_ODDS + n * (seen + unseen)))


class Separated(NamedTuple):
    """Bodies of a content."""

    bodies: list[Body]
    """The largest first; closed with unseen surface at the cuts."""
    probability: float
    """That so many are right: each exists, is cut where it should be, and nowhere else."""


def cut_at_necks(
    pieces: Sequence[Body], corners_m: Floats, num_threads: int | None = None
) -> Separated:
    """Cut parts into bodies where their surface more likely bridges a gap than not.

    pieces: connected parts. corners_m: of the planes of antennas, (n_planes, 4, 3) [m].
    Bodies that touch stay one.
    """
    bodies, certain = list[Body](), 1.0
    apertures = [Aperture.of_corners(corners) for corners in corners_m]
    for piece in pieces:
        regions = _regions(piece, num_threads)
        necks = _necks(piece, regions, apertures)
        kept = [neck.regions for neck in necks if neck.probability < 0.5]
        i, j = np.array(kept, dtype=np.int64).reshape(-1, 2).T
        of_region = connected_labels(i, j, len(regions.depths_m))
        nearest = KDTree(regions.points).query(piece.mesh.corners.mean(axis=1))[1]
        of_face = of_region[regions.labels[nearest]]
        parts = [piece.mesh.faces[of_face == k] for k in np.unique(of_face)]
        bodies += [piece] if len(parts) < 2 else [capped(part_of(piece, part)) for part in parts]
        odds = [piece.probability, *(max(n.probability, 1.0 - n.probability) for n in necks)]
        certain *= float(np.prod(odds))
    bodies.sort(key=lambda body: -float(body.areas_m2.sum()))
    return Separated(bodies, certain)


class _Regions(NamedTuple):
    """Inside of a part, divided at its necks."""

    points: Floats
    """Grid points inside, (n, 3) [m]."""
    labels: Ints
    """Region of each, (n,)."""
    depths_m: Floats
    """Largest distance from the surface in each region, (n_regions,) [m]."""
    saddles_m: Floats
    """The same on the boundary of two regions; 0 where they have none, (n_regions, n_regions)."""
    scene: MeshScene
    """Surface of the part."""


def _regions(body: Body, num_threads: int | None) -> _Regions:
    """Catchment basins of the distance from the surface, merged where hardly a neck divides them.

    Regions smaller than a body are merged with the neighbour of the widest neck.
    """
    from skimage.segmentation import watershed  # noqa: PLC0415 - scikit-image takes 0.3 s

    mesh = body.mesh
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    step = max(_STEP_M, float((high - low).max()) / _MOST_STEPS)
    nx, ny, nz = (int(n) + 3 for n in (high - low) / step)
    grid = Grid.centered(0.5 * (low + high), step, (nx, ny, nz))
    scene, points = MeshScene(mesh.vertices, mesh.faces, num_threads=num_threads), grid.points()
    depth = np.maximum(-scene.signed_distance(points).reshape(grid.shape), 0.0)
    inside = depth > 0.0
    peaks = (maximum_filter(depth, size=3) == depth) & inside
    labels = watershed(-depth, numbered(peaks, np.ones((3, 3, 3)))[0], mask=inside) - 1
    n = int(labels.max(initial=-1)) + 1
    depths, volumes, saddles = np.zeros(n), np.zeros(n), np.zeros((n, n))
    np.maximum.at(depths, labels[inside], depth[inside])
    np.add.at(volumes, labels[inside], step**3)
    for axis in range(3):
        a, b = (np.moveaxis(labels, axis, 0)[part] for part in (np.s_[:-1], np.s_[1:]))
        d, e = (np.moveaxis(depth, axis, 0)[part] for part in (np.s_[:-1], np.s_[1:]))
        at = (a != b) & (a >= 0) & (b >= 0)
        np.maximum.at(saddles, (a[at], b[at]), np.minimum(d, e)[at])
    owner = _merged(depths, volumes, np.maximum(saddles, saddles.T))
    kept, of_region = np.unique(owner, return_inverse=True)
    merged = np.zeros((len(kept), len(kept)))
    np.maximum.at(merged, (of_region[:, None], of_region[None]), np.maximum(saddles, saddles.T))
    np.fill_diagonal(merged, 0.0)
    deepest = np.zeros(len(kept))
    np.maximum.at(deepest, of_region, depths)
    whole = inside.ravel()
    return _Regions(points[whole], of_region[labels.ravel()[whole]], deepest, merged, scene)


def _merged(depths: Floats, volumes: Floats, saddles: Floats) -> Ints:
    """Region that each region belongs to, (n,), after merging the pair of the widest neck first."""
    owner = np.arange(len(depths))
    depths, volumes, saddles = depths.copy(), volumes.copy(), saddles.copy()
    while True:
        share = saddles / np.minimum(depths[:, None], depths)
        is_small = np.minimum(volumes[:, None], volumes) < _LEAST_BODY_M3
        share[is_small & (saddles > 0.0)] += 1.0
        if not share.size or share.max() < _DEEPEST_SHARE:
            return owner
        i, j = np.unravel_index(np.argmax(share), share.shape)
        owner[owner == j] = i
        depths[i], volumes[i] = max(depths[i], depths[j]), volumes[i] + volumes[j]
        saddles[i] = saddles[:, i] = np.maximum(saddles[i], saddles[j])
        saddles[j] = saddles[:, j] = saddles[i, i] = 0.0


def _necks(body: Body, regions: _Regions, apertures: Sequence[Aperture]) -> list[Neck]:
    """Necks between the regions of a part, with the surface that planes face."""
    pairs = np.argwhere(np.triu(regions.saddles_m) > 0.0)
    if not len(pairs):
        return []
    mesh = body.mesh
    areas, normals = body.areas_m2, vertex_normals(mesh.vertices, mesh.faces)
    margins = specular_visibility(mesh.vertices, normals, apertures, regions.scene, lift_m=_LIFT_M)
    faced = (margins > -np.inf).any(axis=1)
    trees = [KDTree(regions.points[regions.labels == k]) for k in range(len(regions.depths_m))]
    faced_m2 = np.where(faced, areas, 0.0)
    usual = (faced_m2[body.seen].sum() + _PATCH_M2) / (faced_m2.sum() + 2.0 * _PATCH_M2)
    found = []
    for i, j in pairs:
        # Near both regions: a neck may be a point wide.
        gap = np.maximum(*(trees[k].query(mesh.vertices)[0] for k in (i, j)))
        own = np.where(gap < _BAND_M, faced_m2, 0.0)
        seen = own[body.seen].sum() / max(own.sum(), 1e-12)
        found.append(Neck((int(i), int(j)), float(own.sum()), float(seen), float(usual)))
    return found
