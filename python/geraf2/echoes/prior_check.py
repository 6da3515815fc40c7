"""Whether the echoes come from where the box is said to be.

Between the antennas and the outside of a closed box there is nothing but air, and the box is
what the scan looks at. So echoes from in front of the box mean that it is too small or that it
lies elsewhere, and echoes mostly from beside it that it does not contain the scene.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from geraf2._types import Floats
from geraf2.errors import UserError
from geraf2.geometry.triangles import unit_normals
from geraf2.imaging.subapertures import Echoes, PoseImages, SubapertureConfig, pose_images
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Capture, LosPrior
from geraf2.scene.checks import in_mm

# A prior may be off by a centimetre (it costs little), and a strong echo is placed to a few mm.
_MARGIN_M = 0.015
# Measured on a figure in a 0.22 m carton: the right box, or one up to 10 mm off, has no energy in
# front or outside; a box of 0.18 m has 41 % in front, one of 0.10 m 22 % and 43 % outside, one of
# 0.05 m 9 % and 66 %. Antennas 4 mm apart see the flash of a bulged wall in a wrong direction, too:
# a fifth of the energy of a right box, which is why what may be such a flash is not counted.
# A turntable or stand adds to what is outside, never to what is in front.
_MAX_IN_FRONT = 0.15
_MAX_OUTSIDE = 0.35
# A wall flashes along its normal, within what it is turned and bulged by: 15 degrees.
_SQUARE = 0.966
_N_POSES = 6
# Only the echoes that stand out: side lobes and far clutter are weaker.
_DYNAMIC_RANGE_DB = 15.0
_NOISE_MARGIN_DB = 15.0
# Every third sub-aperture in each direction is enough to see where the energy is.
_SUBAPERTURES = SubapertureConfig(step_m=0.06, direction_oversampling=2.0)


@dataclass(frozen=True, kw_only=True)
class EchoPlaces:
    """Where the strong echoes lie; shares of their energy."""

    n_echoes: int
    inside: float
    """In the box or within the margin of its surface."""
    in_front: float
    """On a ray into the box, before the ray meets it, and not the flash of a wall in another
    direction that the raster shows in the same place."""
    beside: float
    """On a ray that misses the box, or behind it."""
    bounds_m: Floats
    """Box around the echoes that hold 90 % of the energy, (2, 3) [m]."""


def locate_echoes(
    capture: Capture, prior: LosPrior, *, num_threads: int | None = None
) -> EchoPlaces:
    """Shares of the strong echoes' energy inside, in front of, and beside the prior.

    capture: the scan; six of its poses are looked at.
    """
    scene = MeshScene(prior.vertices, prior.faces, num_threads=num_threads)
    reach = 0.5 * float(np.linalg.norm(prior.size_m))
    normals = unit_normals(prior.vertices[prior.faces])
    parts = []
    for images, echoes in _strong_echoes(capture, prior, reach, num_threads):
        origins, ways, ranges = echoes.centers, echoes.directions, echoes.ranges_m
        points = origins + ranges[:, None] * ways
        near = -scene.signed_distance(points) > -_MARGIN_M
        hit, _ = scene.closest_hit(origins, ways)
        front = ~near & (ranges < hit) & np.isfinite(hit)
        before = np.flatnonzero(front)
        for others in images.ghosts(ways[before]):
            known = np.isfinite(others).all(axis=1)
            some, ahead = before[known], others[known]
            path, face = scene.closest_hit(origins[some], ahead)
            square = np.abs(np.einsum("ij,ij->i", normals[face], ahead)) > _SQUARE
            near[some] |= square & (np.abs(path - ranges[some]) < _MARGIN_M)
        parts.append((points, echoes.magnitudes**2, near, front & ~near))
    if not parts:
        return EchoPlaces(
            n_echoes=0, inside=0.0, in_front=0.0, beside=0.0, bounds_m=np.full((2, 3), np.nan)
        )
    points, energy, near, front = (np.concatenate(column) for column in zip(*parts, strict=True))
    total = float(energy.sum())
    return EchoPlaces(
        n_echoes=len(energy),
        inside=float(energy[near].sum()) / total,
        in_front=float(energy[front].sum()) / total,
        beside=float(energy[~near & ~front].sum()) / total,
        bounds_m=_bounds(points, energy),
    )


def require_echoes_inside(
    capture: Capture, prior: LosPrior, where: object, *, num_threads: int | None = None
) -> EchoPlaces:
    """Raise UserError if the echoes do not come from the box.

    where: named in the error: the mesh file, or --box.
    """
    places = locate_echoes(capture, prior, num_threads=num_threads)
    if places.n_echoes == 0:
        return places  # what was seen instead is find_glints' to say
    outside = places.in_front + places.beside
    if places.in_front > _MAX_IN_FRONT:
        what = (
            "the box is smaller than its content or lies elsewhere: "
            f"{100 * places.in_front:.0f} % of the echo energy comes from between the antennas "
            "and the box"
        )
    elif outside > _MAX_OUTSIDE:
        share = f"{100 * outside:.0f} % of the echo energy comes from outside"
        what = f"the box does not contain the scene: {share}"
    else:
        return places
    expected = f"a box around everything that reflects, not {_span(prior.bounds)}"
    got = f"strong echoes {_span(places.bounds_m)}"
    raise UserError(what=what, where=where, expected=expected, got=got)


def _strong_echoes(
    capture: Capture, prior: LosPrior, reach: float, num_threads: int | None
) -> Iterator[tuple[PoseImages, Echoes]]:
    """Images of each pose, and their peaks."""
    n_poses = len(capture.poses)
    target = prior.bounds.mean(axis=0)
    for index in sorted({int(i) for i in np.linspace(0, n_poses, _N_POSES, endpoint=False)}):
        pose = capture.poses[index]
        distance = float(np.linalg.norm(pose.phase_centers.mean(axis=0) - target))
        # Near enough to the box to be mistaken for its content, and away from the antennas,
        # where the transmitter leaks into the receiver.
        nearest = max(distance - reach - 0.1, 2.0 * capture.waveform.range_cell_m)
        span = (nearest, distance + reach + 0.1)
        images = pose_images(pose, capture.waveform, target, span, _SUBAPERTURES)
        echoes = images.echoes(_DYNAMIC_RANGE_DB, _NOISE_MARGIN_DB, num_threads=num_threads)
        if len(echoes.ranges_m):
            yield images, echoes


def _bounds(points: Floats, energy: Floats) -> Floats:
    strongest = np.argsort(energy)[::-1]
    n_kept = int(np.searchsorted(np.cumsum(energy[strongest]), 0.9 * energy.sum())) + 1
    kept = points[strongest[:n_kept]]
    return np.stack([kept.min(axis=0), kept.max(axis=0)])


def _span(bounds: Floats) -> str:
    return f"from {in_mm(bounds[0])} to {in_mm(bounds[1])} mm"
