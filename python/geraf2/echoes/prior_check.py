"""Check that the echoes come from inside the box of the prior.

There is only air between the antennas and a closed box, and the scan is aimed at the box. Echoes
from in front of the box therefore show that it is too small or displaced. Echoes mostly from beside
it show that it does not contain the scene.
"""

from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from geraf2._types import Bools, Floats
from geraf2.echoes.flashes import (
    MAX_ANGLE_RAD,
    MAX_OFFSET_M,
    OFFSET_SIGMA_M,
    WallMiddles,
    find_flashes,
)
from geraf2.echoes.wall_delay import PAIR_SHARES, pair_distance_m
from geraf2.echoes.wall_faces import WallFaces
from geraf2.errors import UserError
from geraf2.imaging.peaks import LEAKAGE_CELLS, PeakSet, grating_lobes
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Capture, LosPrior
from geraf2.scene.checks import format_mm

# Largest shares of the echo energy in front of the box, and outside of it, where a turntable or a
# stand may add to it. Properties of a radar in front of a carton; a box that is right within 10 mm
# has no such energy.
# Possible grating lobes of a bulged wall's flash do not count, nor the nearer one of the two echoes
# of a wall whose faces cancel.
_MAX_IN_FRONT = 0.15
_MAX_OUTSIDE = 0.35
# Level above side lobes and far clutter, relative to the strongest peak [dB].
_DYNAMIC_RANGE_DB = 15.0


@dataclass(frozen=True, kw_only=True)
class EchoLocations:
    """Locations of the strong echoes as shares of their energy."""

    n_echoes: int
    inside: float
    """Share in the box or within the margin of its surface."""
    in_front: float
    """Share on a line of sight into the box, but before it, without possible grating lobes of a
    wall's flash."""
    beside: float
    """Share on a line of sight that misses the box, or behind it."""
    bounds_m: Floats
    """Bounding box of the strongest echoes with 90 % of the energy, (2, 3) [m]."""


def locate_echoes(
    capture: Capture, prior: LosPrior, peaks: PeakSet, *, num_threads: int | None = None
) -> EchoLocations:
    """Shares of the strong echoes' energy inside, in front of, and beside the prior.

    peaks: of the capture's planes, including those in front of the box and behind it.
    """
    is_leakage = peaks.ranges_m < LEAKAGE_CELLS * capture.waveform.range_cell_m
    strong = peaks.select((peaks.levels_db >= -_DYNAMIC_RANGE_DB) & ~is_leakage)
    if not len(strong):
        return EchoLocations(
            n_echoes=0, inside=0.0, in_front=0.0, beside=0.0, bounds_m=np.full((2, 3), np.nan)
        )
    scene = MeshScene(prior.vertices, prior.faces, num_threads=num_threads)
    points, energy = strong.points, strong.magnitudes**2
    near = -scene.signed_distance(points) > -MAX_OFFSET_M
    hit, _ = scene.closest_hit(strong.centers, strong.directions)
    before = np.flatnonzero(~near & (strong.ranges_m < hit) & np.isfinite(hit))
    half_m = _half_pairs_m(strong, pair_distance_m(capture.waveform))[before]
    flashes = _maybe_flashes(capture, prior, strong.select(before), half_m)
    front = np.zeros(len(strong), dtype=bool)
    near[before], front[before] = flashes, ~flashes
    total = float(energy.sum())
    return EchoLocations(
        n_echoes=len(energy),
        inside=float(energy[near].sum()) / total,
        in_front=float(energy[front].sum()) / total,
        beside=float(energy[~near & ~front].sum()) / total,
        bounds_m=_bounds(points, energy),
    )


def _half_pairs_m(peaks: PeakSet, pair_m: float) -> Floats:
    """Half the distance to an echo behind each peak that may be its wall's other one, (n,) [m].

    0 without such an echo. pair_m: distance of each echo from the wall, without loss [m].
    """
    half = np.zeros(len(peaks))
    for number in np.unique(peaks.subapertures):
        own = np.flatnonzero(peaks.subapertures == number)
        behind = 0.5 * (peaks.ranges_m[own] - peaks.ranges_m[own, None])
        apart = behind > PAIR_SHARES[0] * pair_m - OFFSET_SIGMA_M
        apart &= behind < PAIR_SHARES[-1] * pair_m + OFFSET_SIGMA_M
        apart &= peaks.directions[own] @ peaks.directions[own].T > np.cos(MAX_ANGLE_RAD)
        half[own] = np.where(apart, behind, 0.0).max(axis=1)
    return half


def _maybe_flashes(capture: Capture, prior: LosPrior, peaks: PeakSet, half_m: Floats) -> Bools:
    """Mask of peaks that may be a wall's specular return, or its grating lobe, (n,).

    half_m: distance by which each may be nearer than its wall, (n,) [m].
    """
    faces, middles = WallFaces.of(prior), WallMiddles.of(capture.walls, capture.waveform)
    found = np.zeros(len(peaks), dtype=bool)
    for number in np.unique(peaks.planes):
        own = np.flatnonzero(peaks.planes == number)
        of_plane = peaks.select(own)
        periods = of_plane.periods[of_plane.subapertures[0]]
        lobes = grating_lobes(of_plane.directions, capture.poses[number].axes, periods)
        for others in chain([of_plane.directions], lobes):
            known = np.asarray(np.isfinite(others).all(axis=1))
            maybe = replace(of_plane.select(known), directions=others[known])
            for behind_m in (0.0, half_m[own[known]]):
                seen = replace(maybe, ranges_m=maybe.ranges_m + behind_m)
                found[own[known][find_flashes(seen, faces, middles).index]] = True
    return found


def require_echoes_inside(
    capture: Capture,
    prior: LosPrior,
    peaks: PeakSet,
    where: object,
    *,
    num_threads: int | None = None,
) -> EchoLocations:
    """Raise UserError if the echoes do not come from the box.

    peaks: of the capture's planes.
    where: source of the box for the error: the mesh file, or --box.
    """
    found = locate_echoes(capture, prior, peaks, num_threads=num_threads)
    if found.n_echoes == 0:
        return found  # find_glints reports the reason
    outside = found.in_front + found.beside
    if found.in_front > _MAX_IN_FRONT:
        what = (
            "the box is smaller than its content or lies elsewhere: "
            f"{100 * found.in_front:.0f} % of the echo energy comes from between the antennas "
            "and the box"
        )
    elif outside > _MAX_OUTSIDE:
        share = f"{100 * outside:.0f} % of the echo energy comes from outside"
        what = f"the box does not contain the scene: {share}"
    else:
        return found
    expected = f"a box around everything that reflects, not {_span(prior.bounds)}"
    got = f"strong echoes {_span(found.bounds_m)}"
    raise UserError(what=what, where=where, expected=expected, got=got)


def _bounds(points: Floats, energy: Floats) -> Floats:
    strongest = np.argsort(energy)[::-1]
    n_kept = int(np.searchsorted(np.cumsum(energy[strongest]), 0.9 * energy.sum())) + 1
    kept = points[strongest[:n_kept]]
    return np.stack([kept.min(axis=0), kept.max(axis=0)])


def _span(bounds: Floats) -> str:
    return f"from {format_mm(bounds[0])} to {format_mm(bounds[1])} mm"
