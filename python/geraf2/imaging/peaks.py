"""Peaks of sub-aperture images, from which all later steps select.

A peak is a local maximum of a focused image over direction and range above the detection
threshold: a fixed ratio to the noise of its range bin, which is the median over the directions
(order-statistic CFAR). Images are not stored (docs/math/images.md#sub-aperture-images).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import product
from weakref import ReferenceType, ref

import numpy as np
from scipy.spatial.distance import cdist

from geraf2._types import Bools, Floats, Ints, Progress
from geraf2.imaging.bistatic import common_half_baseline, seen_from_midpoints
from geraf2.imaging.subapertures import PoseImages, SubapertureConfig, pose_images
from geraf2.ops.subaperture import subaperture_peaks
from geraf2.scene import Capture, LosPrior, Pose, Waveform

DETECTION_DB = 12.0
"""Detection threshold: least ratio of a peak to the noise of its range bin [dB]."""
REACH_M = (0.1, 0.05)
"""Distances in front of the prior's box and behind it within which peaks are collected [m]. Echoes
from there show that the prior is too small or displaced."""
LEAKAGE_CELLS = 2.0
"""Range cells within which the leakage from transmitter to receiver dominates."""
_BOX_MARGIN_M = 0.02
"""Margin around the prior's box for the blur of its walls' echoes [m]."""
MAX_RANGE_SHIFT_M = REACH_M[1]
"""Largest shift of ranges that does not require images of other ranges [m]."""
_SAME_LINE_M = 1e-6
"""Largest distance of sub-apertures on one line of their lattice [m]."""
_RIGID_M = 1e-8
"""Largest change of antenna positions in the plane that counts as a rigid motion [m]."""
_PER_PEAK = ("subapertures", "directions", "ranges_m", "magnitudes", "noise")


@dataclass(frozen=True, kw_only=True, eq=False)
class PeakSet:
    """Peaks of the sub-aperture images of several planes, as lines of sight with a range."""

    subapertures: Ints
    """Sub-aperture of each peak, an index into the arrays below, (n,)."""
    directions: Floats
    """Unit vectors from the centre of the sub-aperture to the reflector, (n, 3)."""
    ranges_m: Floats
    """One-way distance from that centre, corrected for the recorded instrument delay, (n,) [m]."""
    magnitudes: Floats
    """Magnitude of the image, (n,)."""
    noise: Floats
    """RMS noise of the range bin, (n,)."""
    subaperture_centers: Floats
    """Centre of each sub-aperture, (n_subapertures, 3) [m]."""
    subaperture_coordinates: Floats
    """Centre along the plane's horizontal and vertical axis, (n_subapertures, 2) [m]."""
    subaperture_planes: Ints
    """Plane of each sub-aperture, (n_subapertures,)."""
    tops: Floats
    """Magnitude of the strongest peak of each sub-aperture, 0 without peak, (n_subapertures,)."""
    periods: Floats
    """Periods of the horizontal and vertical direction cosine, (n_subapertures, 2); inf where no
    grating lobe is imaged."""

    def __len__(self) -> int:
        return len(self.ranges_m)

    @property
    def centers(self) -> Floats:
        """Centre of each peak's sub-aperture, (n, 3) [m]."""
        return self.subaperture_centers[self.subapertures]

    @property
    def planes(self) -> Ints:
        """Plane of each peak, (n,)."""
        return self.subaperture_planes[self.subapertures]

    @property
    def points(self) -> Floats:
        """Apparent positions of the reflectors, (n, 3) [m]."""
        return self.centers + self.ranges_m[:, None] * self.directions

    @property
    def strengths(self) -> Floats:
        """Magnitude times range, which is independent of a flat wall's distance, (n,)."""
        return np.asarray(self.magnitudes * self.ranges_m)

    @property
    def levels_db(self) -> Floats:
        """Magnitude relative to the strongest peak of the sub-aperture, (n,) [dB]."""
        return np.asarray(20.0 * np.log10(self.magnitudes / self.tops[self.subapertures]))

    @property
    def margins_db(self) -> Floats:
        """Magnitude relative to the noise of the range bin, (n,) [dB]."""
        return np.asarray(20.0 * np.log10(self.magnitudes / np.maximum(self.noise, 1e-300)))

    def select(self, keep: Bools | Ints) -> "PeakSet":
        """Peaks by mask or index; `tops` stay the same."""
        return replace(self, **{name: getattr(self, name)[keep] for name in _PER_PEAK})

    def within(self, spans_m: Floats) -> "PeakSet":
        """Peaks in a span of ranges of each plane, (n_planes, 2) [m]; `tops` are recomputed."""
        low, high = spans_m[self.planes].T
        found = self.select((self.ranges_m > low) & (self.ranges_m < high))
        tops = np.zeros(len(self.tops))
        np.maximum.at(tops, found.subapertures, found.magnitudes)
        return replace(found, tops=tops)

    def of_plane(self, number: int) -> "PeakSet":
        """Peaks of one plane."""
        return self.select(self.planes == number)

    def thinned(self, step_m: float) -> "PeakSet":
        """Peaks of sub-apertures that are about `step_m` [m] apart, including the outermost ones.

        Overlapping neighbours have the same echoes, and their noise is not independent.
        """
        return self.select(self.spaced(step_m)[self.subapertures])

    def spaced(self, step_m: float) -> Bools:
        """Whether each sub-aperture is one of those about `step_m` [m] apart, (n_subapertures,)."""
        keep = np.zeros(len(self.tops), dtype=bool)
        for number in np.unique(self.subaperture_planes):
            own = np.flatnonzero(self.subaperture_planes == number)
            keep[own] = _select_spaced(self.subaperture_coordinates[own], step_m)
        return keep


def grating_lobes(directions: Floats, axes: Floats, periods: Floats) -> list[Floats]:
    """Directions of the grating lobes of a coarse raster, (n, 3) each.

    directions: unit vectors, (n, 3). axes: of the plane. periods: of both direction cosines, (2,).
    NaN where no direction is one period away.
    """
    shifts = [(0.0, -period, period) if np.isfinite(period) else (0.0,) for period in periods]
    cosines = directions @ axes[1:].T
    return [directions_at(cosines + shift, axes) for shift in product(*shifts) if any(shift)]


def directions_at(cosines: Floats, axes: Floats) -> Floats:
    """Directions in front of the plane from cosines along its last two axes, (n, 2) -> (n, 3).

    NaN where no direction has such cosines.
    """
    ahead2 = 1.0 - (cosines**2).sum(axis=1)
    ahead = np.sqrt(np.where(ahead2 >= 0.0, ahead2, np.nan))
    return np.asarray(np.column_stack([ahead, cosines]) @ axes)


def join_peaks(parts: Sequence[PeakSet]) -> PeakSet:
    """Join sets of peaks, in order."""
    if not parts:
        nothing, index = np.zeros(0), np.zeros(0, dtype=np.int64)
        return PeakSet(
            subapertures=index,
            directions=np.zeros((0, 3)),
            ranges_m=nothing,
            magnitudes=nothing,
            noise=nothing,
            subaperture_centers=np.zeros((0, 3)),
            subaperture_coordinates=np.zeros((0, 2)),
            subaperture_planes=index,
            tops=nothing,
            periods=np.zeros((0, 2)),
        )
    first = np.cumsum([0, *(len(part.tops) for part in parts[:-1])])
    columns = {
        entry.name: np.concatenate([getattr(part, entry.name) for part in parts])
        for entry in fields(PeakSet)
    }
    columns["subapertures"] += np.repeat(first, [len(part) for part in parts])
    return PeakSet(**columns)


def box_spans(poses: Iterable[Pose], prior: LosPrior) -> Floats:
    """Spans of ranges of the prior's box from each plane, (n_planes, 2) [m]."""
    return np.array([_box_span(pose, prior) for pose in poses]).reshape(-1, 2)


def _box_span(pose: Pose, prior: LosPrior) -> tuple[float, float]:
    if pose.n_antennas == 0:
        return 0.0, 0.0
    distance = np.linalg.norm(prior.corners[None] - pose.phase_centers[::7, None], axis=2)
    center = pose.phase_centers.mean(axis=0)
    nearest = float(((prior.corners - center) @ pose.axes[0]).min())
    return max(nearest - _BOX_MARGIN_M, 1e-3), float(distance.max()) + _BOX_MARGIN_M


def collect_peaks(
    capture: Capture,
    prior: LosPrior,
    subaperture: SubapertureConfig,
    noise_margin_db: float,
    *,
    planes: Iterable[int] | None = None,
    reach_m: tuple[float, float] = REACH_M,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> PeakSet:
    """Peaks of each plane around the prior's box; every plane is imaged once.

    prior: outside of the box; images are focused on its centre.
    subaperture: size and sampling of the images.
    noise_margin_db: detection threshold relative to the noise of the range bin [dB].
    planes: indices of the planes to image; all when None.
    reach_m: distances in front of the box and behind it within which peaks are collected [m].

    Returns peaks whose planes are indices of the capture's poses.
    """
    peaks = KeptPeaks(prior, subaperture, noise_margin_db, reach_m=reach_m, num_threads=num_threads)
    return peaks.of(capture, planes, progress=progress)


def _peaks_of(
    images: PoseImages, number: int, noise_margin_db: float, num_threads: int | None
) -> PeakSet:
    """Peaks of a plane's images."""
    pose, bins, centers = images.pose, images.bins, images.centers
    found = subaperture_peaks(
        pose.signal,
        pose.tx_positions,
        pose.rx_positions,
        images.waveform,
        images.subapertures,
        bins,
        thresholds_db=(np.inf, noise_margin_db),
        num_threads=num_threads,
    )
    tops = np.zeros(len(centers))
    np.maximum.at(tops, found.subapertures, found.magnitudes)
    directions, ranges_m = directions_at(found.cosines, pose.axes), found.ranges_m
    half_m = common_half_baseline(pose.tx_positions, pose.rx_positions)
    if half_m is not None:
        own = found.subapertures
        positions = centers[own], images.subapertures.focus[own]
        ranges_m, directions = seen_from_midpoints(
            ranges_m, directions, *positions, half_m, pose.axes
        )
    return PeakSet(
        subapertures=found.subapertures,
        directions=directions,
        ranges_m=ranges_m,
        magnitudes=found.magnitudes,
        noise=found.noise,
        subaperture_centers=centers,
        subaperture_coordinates=centers @ pose.axes[1:].T,
        subaperture_planes=np.full(len(centers), number, dtype=np.int64),
        tops=tops,
        periods=np.tile([bins.horizontal.period, bins.vertical.period], (len(centers), 1)),
    )


def _select_spaced(points: Floats, step_m: float) -> Bools:
    """Select points of a lattice, (n, 2) [m], about a step apart along both axes, (n,)."""
    keep = np.ones(len(points), dtype=bool)
    for along in points.T:
        lines, line = np.unique(np.rint(along / _SAME_LINE_M), return_inverse=True)
        n_steps = np.ceil(_SAME_LINE_M * (lines[-1] - lines[0]) / step_m - 1e-3)
        chosen = np.linspace(0, len(lines) - 1, min(len(lines), int(n_steps) + 1))
        keep &= np.isin(line, np.rint(chosen).astype(np.int64))
    return keep


@dataclass(frozen=True, kw_only=True, eq=False)
class _Kept:
    """Peaks of a plane, with the antenna geometry and delay of their images."""

    signal: "ReferenceType[object]"
    tx: Floats
    rx: Floats
    axes: Floats
    bias_m: float
    peaks: PeakSet


class KeptPeaks:
    """Peaks of the planes of a capture, which are imaged on first use.

    A corrected capture gets corrected peaks. A change of the delay shifts ranges by half of it, and
    a rigid motion of a plane moves its peaks. Planes with other samples, or with antennas that
    moved relative to each other, are imaged again. Only peaks are stored.
    """

    def __init__(
        self,
        prior: LosPrior,
        subaperture: SubapertureConfig | None = None,
        noise_margin_db: float = DETECTION_DB,
        *,
        reach_m: tuple[float, float] = REACH_M,
        num_threads: int | None = None,
    ) -> None:
        self.prior, self.subaperture = prior, subaperture or SubapertureConfig()
        self.noise_margin_db, self.num_threads = noise_margin_db, num_threads
        self.reach_m = reach_m
        self.n_imaged = 0
        """Images of planes so far."""
        self._kept: dict[int, _Kept] = {}

    def of(
        self,
        capture: Capture,
        planes: Iterable[int] | None = None,
        *,
        progress: Progress | None = None,
    ) -> PeakSet:
        """Peaks of some planes of a capture, all when None; `planes` are the capture's indices."""
        self._kept = {k: kept for k, kept in self._kept.items() if kept.signal() is not None}
        chosen = list(range(len(capture.poses)) if planes is None else planes)
        parts = []
        for done, number in enumerate(chosen, start=1):
            pose = capture.poses[number]
            if pose.n_antennas == 0:
                continue
            found = self._corrected(pose, capture.waveform, number)
            if found is None:
                found = self._imaged(pose, capture.waveform, number)
            self._kept[id(pose.signal)] = _Kept(
                signal=ref(pose.signal),
                tx=pose.tx_positions,
                rx=pose.rx_positions,
                axes=pose.axes,
                bias_m=capture.waveform.path_bias_m,
                peaks=found,
            )
            parts.append(found)
            if progress is not None:
                progress(done / len(chosen))
        return join_peaks(parts)

    def about(self, prior: LosPrior, tolerance_m: float = 0.0) -> "KeptPeaks":
        """Peaks around another prior: these if no corner moved farther [m], else none yet."""
        found = KeptPeaks(
            prior,
            self.subaperture,
            self.noise_margin_db,
            reach_m=self.reach_m,
            num_threads=self.num_threads,
        )
        before, after = self.prior.corners, prior.corners
        if before.shape == after.shape and cdist(before, after).min(axis=1).max() <= tolerance_m:
            found.prior, found._kept = self.prior, self._kept
        found.n_imaged = self.n_imaged
        return found

    def _imaged(self, pose: Pose, waveform: Waveform, number: int) -> PeakSet:
        self.n_imaged += 1
        near, far = _box_span(pose, self.prior)
        low = max(near - self.reach_m[0], min(near, LEAKAGE_CELLS * waveform.range_cell_m))
        high = max(far, min(far + self.reach_m[1], low + waveform.unambiguous_range_m))
        focus = self.prior.bounds.mean(axis=0)
        images = pose_images(pose, waveform, focus, (low, high), self.subaperture)
        return _peaks_of(images, number, self.noise_margin_db, self.num_threads)

    def _corrected(self, pose: Pose, waveform: Waveform, number: int) -> PeakSet | None:
        kept = self._kept.get(id(pose.signal))
        if kept is None or kept.signal() is not pose.signal:
            return None
        shift_m = 0.5 * (waveform.path_bias_m - kept.bias_m)
        rotation, origin, moved_to = (
            kept.axes.T @ pose.axes,
            kept.tx.mean(axis=0),
            pose.tx_positions,
        )
        same = kept.tx is pose.tx_positions and kept.rx is pose.rx_positions
        pairs = ((kept.tx, pose.tx_positions), (kept.rx, pose.rx_positions))
        if abs(shift_m) > MAX_RANGE_SHIFT_M or not (
            same
            or all(_is_rigid(before - origin, after, rotation, moved_to) for before, after in pairs)
        ):
            return None
        peaks = kept.peaks
        centers, directions = peaks.subaperture_centers, peaks.directions
        if not same:
            centers = (centers - origin) @ rotation + moved_to.mean(axis=0)
            directions = directions @ rotation
        return replace(
            peaks,
            directions=directions,
            ranges_m=peaks.ranges_m - shift_m,
            subaperture_centers=centers,
            subaperture_planes=np.full(len(peaks.tops), number, dtype=np.int64),
        )


def _is_rigid(before: Floats, after: Floats, rotation: Floats, moved_to: Floats) -> bool:
    """Whether rotated and translated positions equal those after."""
    if before.shape != after.shape:
        return False
    return bool(
        np.abs(before @ rotation + moved_to.mean(axis=0) - after).max(initial=0.0) < _RIGID_M
    )
