"""Agreement of the planes of a scan: whether their echoes lie on common surfaces.

Two points of a smooth surface satisfy (p_i - p_j) . (n_i + n_j) / 2 = 0 to third order. Strong
echoes of different planes that lie near each other therefore have a small offset along their mean
normal, whatever the surface is. Where the recorded geometry is wrong, the offset is that of two
points at random: uniform between minus and plus their distance. The share of pairs that lie on a
common surface is thus known for the recorded geometry, and for each rival of it, without a
reconstruction (docs/math/verdict.md#planes-that-agree).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Floats, Ints
from geraf2.echoes.noise import ECHO_NOISE, normal_density
from geraf2.imaging.peaks import PeakSet
from geraf2.scene import Pose

_REACH_M = 0.035
"""Largest distance of a pair [m]: specular points of planes 15 degrees apart on a body of 25 cm."""
_ALIKE = 0.76
"""Least cosine between the normals of a pair."""
_STRONG_DB = -15.0
"""Least level of an echo relative to the strongest of its image: side lobes lie below [dB]."""
_MAX_ECHOES = 3000
"""Largest number of echoes that are compared; more have the same sub-aperture's errors."""
_PAIRS_AT_ONCE = 1 << 14
"""Pairs that are compared together: their arrays stay in the cache."""
_ROUNDS = 12
MIN_PLANES = 4
"""Least number of planes whose agreement is compared."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaneAgreement:
    """Share of pairs of echoes of different planes that lie on one surface."""

    share: float
    """Of all pairs: about .4 or more in a sound scan, near 0 where the geometry is wrong."""
    of_planes: Floats
    """Of the pairs of each plane; NaN where a plane has none, (n_planes,)."""
    log_likelihood: Floats
    """Mean logarithm of the density of a plane's offsets over that of a scan without agreement,
    0 where a plane has no pairs, (n_planes,)."""
    n_pairs: Ints
    """Pairs of each plane, (n_planes,)."""


def plane_agreement(peaks: PeakSet, n_planes: int) -> PlaneAgreement:
    """Agreement of the planes.

    peaks: of all planes, walls and content. n_planes: of the capture.
    """
    i, j, density = _pairs(strong_echoes(peaks))
    return _agreement(i, j, density, n_planes)


def strong_echoes(peaks: PeakSet) -> PeakSet:
    """Strong peaks that are compared, of all planes alike."""
    strong = peaks.select(peaks.levels_db >= _STRONG_DB)
    step = max(1, -(-len(strong) // _MAX_ECHOES))
    return strong.select(np.arange(0, len(strong), step))


def _pairs(echoes: PeakSet) -> tuple[Ints, Ints, Floats]:
    """Planes of each pair, and the density of its offset on a common surface over that without."""
    points, normals, planes = echoes.points, -echoes.directions, echoes.planes
    near = KDTree(points).query_pairs(_REACH_M, output_type="ndarray")

    def compared(pairs: Ints) -> tuple[Ints, Ints, Floats]:
        i, j = pairs[planes[pairs[:, 0]] != planes[pairs[:, 1]]].T
        cosine = np.einsum("ij,ij->i", normals.take(i, axis=0), normals.take(j, axis=0))
        alike = cosine > _ALIKE
        i, j, cosine = i[alike], j[alike], cosine[alike]
        step = points.take(j, axis=0) - points.take(i, axis=0)
        distance = np.sqrt(np.einsum("ij,ij->i", step, step))
        both = normals.take(i, axis=0) + normals.take(j, axis=0)
        offset = np.einsum("ij,ij->i", step, both) / np.sqrt(2.0 + 2.0 * cosine)
        sigma = np.sqrt(ECHO_NOISE.offset_variance(distance))
        density = normal_density(offset, sigma) * 2.0 * np.maximum(distance, sigma)
        return planes[i], planes[j], density

    parts = [compared(part) for part in np.array_split(near, len(near) // _PAIRS_AT_ONCE + 1)]
    i, j, density = (np.concatenate(column) for column in zip(*parts, strict=True))
    return i, j, density


def _agreement(i: Ints, j: Ints, density: Floats, n_planes: int) -> PlaneAgreement:
    count = np.bincount(i, minlength=n_planes) + np.bincount(j, minlength=n_planes)

    def of_planes(values: Floats) -> Floats:
        total = np.bincount(i, values, n_planes) + np.bincount(j, values, n_planes)
        return np.asarray(total / np.maximum(count, 1))

    share = 0.3
    for _ in range(_ROUNDS if len(density) else 0):  # expectation and maximisation
        belongs = share * density / (share * density + 1.0 - share)
        share = float(belongs.mean())
    if not len(density):
        nothing = np.zeros(n_planes)
        return PlaneAgreement(
            share=0.0, of_planes=nothing * np.nan, log_likelihood=nothing, n_pairs=count
        )
    belongs = share * density / (share * density + 1.0 - share)
    likelihood = np.log(share * density + 1.0 - share)
    return PlaneAgreement(
        share=share,
        of_planes=np.where(count > 0, of_planes(belongs), np.nan),
        log_likelihood=of_planes(likelihood),
        n_pairs=count,
    )


@dataclass(frozen=True, kw_only=True)
class Rival:
    """Another geometry of the scan, against the recorded one."""

    share: float
    """Share of pairs of echoes that lie on one surface, as in `PlaneAgreement`."""
    sigmas: float
    """Mean gain of log likelihood of the planes over its standard error: positive where the rival
    explains the echoes better."""

    @classmethod
    def of(cls, recorded: PlaneAgreement, other: PlaneAgreement) -> "Rival":
        """Compare a rival with the recorded geometry, plane by plane."""
        used = (recorded.n_pairs > 0) | (other.n_pairs > 0)
        gain = (other.log_likelihood - recorded.log_likelihood)[used]
        if len(gain) < MIN_PLANES:
            return cls(share=other.share, sigmas=0.0)
        error = float(gain.std(ddof=1)) / np.sqrt(len(gain))
        return cls(share=other.share, sigmas=float(gain.mean() / max(error, 1e-9)))


def with_axes_reversed(
    peaks: PeakSet, poses: Sequence[Pose], *, horizontal: bool = False, vertical: bool = False
) -> PeakSet:
    """Peaks as of planes whose raster runs the other way along one axis or both.

    A turntable in the wrong sense is the same, seen in a mirror: planes at the angles -a instead
    of a are planes at a with reversed horizontal axes, mirrored as a whole.
    """
    centers, directions = peaks.subaperture_centers.copy(), peaks.directions.copy()
    for number in np.unique(peaks.subaperture_planes):
        own, middle = peaks.subaperture_planes == number, poses[number].phase_centers.mean(axis=0)
        of_own = own[peaks.subapertures]
        for turned, axis in zip((horizontal, vertical), poses[number].axes[1:], strict=True):
            if turned:
                centers[own] -= 2.0 * np.outer((centers[own] - middle) @ axis, axis)
                directions[of_own] -= 2.0 * np.outer(directions[of_own] @ axis, axis)
    return replace(peaks, subaperture_centers=centers, directions=directions)


def as_recorded_at(peaks: PeakSet, poses: Sequence[Pose], moved: Mapping[int, int]) -> PeakSet:
    """Peaks of planes that were recorded in the places of other ones: {plane: place}."""
    centers, directions = peaks.subaperture_centers.copy(), peaks.directions.copy()
    for plane, place in moved.items():
        own = peaks.subaperture_planes == plane
        turn = poses[plane].axes.T @ poses[place].axes
        start, end = (poses[n].phase_centers.mean(axis=0) for n in (plane, place))
        centers[own] = (peaks.subaperture_centers[own] - start) @ turn + end
        of_own = own[peaks.subapertures]
        directions[of_own] = peaks.directions[of_own] @ turn
    return replace(peaks, subaperture_centers=centers, directions=directions)
