"""Check that the echoes come from inside the box of the prior.

Between the antennas and the outside of a closed box there is nothing but air, and the box is
what the scan looks at. So echoes from in front of the box mean that it is too small or that it
lies elsewhere, and echoes mostly from beside it that it does not contain the scene.
"""

from dataclasses import dataclass

import numpy as np

from geraf2._types import Bools, Floats
from geraf2.errors import UserError
from geraf2.geometry.triangles import unit_normals
from geraf2.imaging.peaks import PeakSet, grating_lobes
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Capture, LosPrior
from geraf2.scene.checks import in_mm

# A prior may be off by a centimetre (it costs little), and a strong echo is placed to a few mm.
_MARGIN_M = 0.015
# Measured on a figure in a 0.22 m carton: the right box, or one up to 10 mm off, has no energy in
# front or outside; a box of 0.18 m has 41 % in front, one of 0.10 m 22 % and 43 % outside, one of
# 0.05 m 9 % and 66 %. Antennas 4 mm apart see the flash of a bulged wall in a wrong direction, too:
# a fifth of the energy of a right box. Peaks that may be such grating lobes do not count.
# A turntable or stand adds to what is outside, never to what is in front.
_MAX_IN_FRONT = 0.15
_MAX_OUTSIDE = 0.35
# Cosine to the wall's normal of its specular return; a bulged, turned wall is 15 degrees off.
_SQUARE = 0.966
# Side lobes and far clutter are weaker than this [dB].
_DYNAMIC_RANGE_DB = 15.0


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
    capture: Capture, prior: LosPrior, peaks: PeakSet, *, num_threads: int | None = None
) -> EchoPlaces:
    """Shares of the strong echoes' energy inside, in front of, and beside the prior.

    peaks: of the capture's planes, those in front of the box and behind it included.
    """
    strong = peaks.select(peaks.levels_db >= -_DYNAMIC_RANGE_DB)
    if not len(strong):
        return EchoPlaces(
            n_echoes=0, inside=0.0, in_front=0.0, beside=0.0, bounds_m=np.full((2, 3), np.nan)
        )
    scene = MeshScene(prior.vertices, prior.faces, num_threads=num_threads)
    points, energy = strong.points, strong.magnitudes**2
    near = -scene.signed_distance(points) > -_MARGIN_M
    hit, _ = scene.closest_hit(strong.centers, strong.directions)
    before = np.flatnonzero(~near & (strong.ranges_m < hit) & np.isfinite(hit))
    flashes = _maybe_flashes(capture, prior, strong.select(before), scene)
    front = np.zeros(len(strong), dtype=bool)
    near[before], front[before] = flashes, ~flashes
    total = float(energy.sum())
    return EchoPlaces(
        n_echoes=len(energy),
        inside=float(energy[near].sum()) / total,
        in_front=float(energy[front].sum()) / total,
        beside=float(energy[~near & ~front].sum()) / total,
        bounds_m=_bounds(points, energy),
    )


def _maybe_flashes(capture: Capture, prior: LosPrior, peaks: PeakSet, scene: MeshScene) -> Bools:
    """Which peaks may be grating lobes of the specular return of a wall, (n,)."""
    normals = unit_normals(prior.vertices[prior.faces])
    found = np.zeros(len(peaks), dtype=bool)
    for number in np.unique(peaks.planes):
        own = np.flatnonzero(peaks.planes == number)
        of_plane = peaks.select(own)
        periods = of_plane.periods[of_plane.subapertures[0]]
        for others in grating_lobes(of_plane.directions, capture.poses[number].axes, periods):
            known = np.asarray(np.isfinite(others).all(axis=1))
            some, ahead = of_plane.select(known), others[known]
            path, face = scene.closest_hit(some.centers, ahead)
            square = np.abs(np.einsum("ij,ij->i", normals[face], ahead)) > _SQUARE
            found[own[known]] |= square & (np.abs(path - some.ranges_m) < _MARGIN_M)
    return found


def require_echoes_inside(
    capture: Capture,
    prior: LosPrior,
    peaks: PeakSet,
    where: object,
    *,
    num_threads: int | None = None,
) -> EchoPlaces:
    """Raise UserError if the echoes do not come from the box.

    peaks: of the capture's planes.
    where: named in the error: the mesh file, or --box.
    """
    places = locate_echoes(capture, prior, peaks, num_threads=num_threads)
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


def _bounds(points: Floats, energy: Floats) -> Floats:
    strongest = np.argsort(energy)[::-1]
    n_kept = int(np.searchsorted(np.cumsum(energy[strongest]), 0.9 * energy.sum())) + 1
    kept = points[strongest[:n_kept]]
    return np.stack([kept.min(axis=0), kept.max(axis=0)])


def _span(bounds: Floats) -> str:
    return f"from {in_mm(bounds[0])} to {in_mm(bounds[1])} mm"
