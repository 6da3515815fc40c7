"""Motion of a parcel on a belt, from what two arrays on one line see one after the other.

One array sees smooth surfaces the same at any speed: its ranges over the recorded travel always fit
some surface. A second array at another station of the same line passes the same positions of the
parcel's frame later. There both see the same echoes, so that

    R_2 - R_1 = -(c_2 - c_1) . (u_1 + u_2) / 2        (to third order in c_2 - c_1)

for positions c, directions u and ranges R of two sub-apertures. Errors of the recorded travel s,
s (a + b s) along the belt and the rotation by p s, displace c_2 and c_1 by different amounts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Floats, Ints
from geraf2.imaging.peaks import PeakSet, collect_peaks
from geraf2.imaging.subapertures import SubapertureConfig
from geraf2.io.belt_file import BeltRecord, BeltStation
from geraf2.records import Pose, Waveform
from geraf2.scene import Capture, LosPrior

_PEAKS = SubapertureConfig(size_m=0.07, step_m=0.015, direction_oversampling=2.0)
_MARGIN_DB = 15.0
# Least distance of two stations [m]; largest distance of rows of both arrays [m].
_LEAST_APART_M, _SAME_ROW_M = 0.05, 0.003
# Largest distance of two sub-apertures [m], and difference of their directions.
_NEAR_M, _SAME_COSINE = 0.02, 0.06
# Largest misfit of a pair in each round [m].
_GATES_M = (0.02, 0.006, 0.003)
# Expected errors: of the speed, of its change [1/m], of the yaw [rad/m], of the delay [m].
SIGMAS = np.array([0.02, 0.05, 0.1, 0.002])
# Least range error of a pair [m]; neighbouring pairs that share an error.
_RANGE_SIGMA_M, _OVERLAP = 1e-4, 4.0
_LEAST_PAIRS = 20
# Largest error of the speed that profiles are searched for.
_MOST_WRONG = 0.15


@dataclass(frozen=True, kw_only=True)
class Motion:
    """True travel s (1 + scale + change s) of the recorded travel s, and yaw -turn s."""

    scale: float = 0.0
    """Share to be added to the recorded travel."""
    change_per_m: float = 0.0
    """Share to be added for each metre of travel [1/m]."""
    turn_rad_per_m: float = 0.0
    """Rotation of the arrays about the vertical, seen from the parcel [rad/m]."""
    scale_sigma: float = float(SIGMAS[0])
    change_sigma_per_m: float = float(SIGMAS[1])
    turn_sigma_rad_per_m: float = float(SIGMAS[2])
    n_pairs: int = 0
    """Pairs of echoes behind it; 0: nothing was estimated."""

    def __str__(self) -> str:
        if not self.n_pairs:
            return "motion as recorded: no second array sees the same line"
        return (
            f"travel {1e2 * self.scale:+z.3f} +- {1e2 * self.scale_sigma:.3f} %, yaw "
            f"{np.rad2deg(self.turn_rad_per_m):+z.2f} +- "
            f"{np.rad2deg(self.turn_sigma_rad_per_m):.2f} degrees a metre, {self.n_pairs} pairs"
        )

    def placed(self, nominal: Floats, recorded: Floats) -> Floats:
        """Positions in the parcel's frame, (n, 3) [m].

        nominal: where the arrays stand, (n, 3) [m]. recorded: positions in the record, (n, 3) [m].
        """
        travel = nominal[:, 0] - recorded[:, 0]
        travel = travel * (1.0 + self.scale + self.change_per_m * travel)
        x, y = nominal[:, 0] - travel, nominal[:, 1]
        cos, sin = np.cos(self.turn_rad_per_m * travel), -np.sin(self.turn_rad_per_m * travel)
        return np.stack([cos * x - sin * y, sin * x + cos * y, nominal[:, 2]], axis=1)


def corrected(pose: Pose, array: BeltStation, motion: Motion) -> Pose:
    """Plane of whole frames with its antennas where the motion puts them."""
    n_frames = pose.n_antennas // array.n_channels
    recorded = pose.phase_centers
    moved = motion.placed(np.tile(array.phase_centers_m, (n_frames, 1)), recorded)
    shift = moved - recorded
    path = moved.reshape(n_frames, -1, 3).mean(axis=1)
    slope = np.polyfit(path[:, 0], path[:, 1], 1)[0] if n_frames > 1 else 0.0
    cos, sin = np.array([1.0, slope]) / np.hypot(1.0, slope)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return replace(
        pose,
        tx_positions=pose.tx_positions + shift,
        rx_positions=pose.rx_positions + shift,
        axes=pose.axes @ turn.T,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Line:
    """Two arrays that pass the same positions, each as one plane of their common rows."""

    arrays: tuple[BeltStation, BeltStation]
    poses: tuple[Pose, Pose]


def common_lines(record: BeltRecord, poses: dict[str, Pose]) -> list[Line]:
    """Pairs of arrays on one line.

    record: the belt. poses: all frames of each array, by its name, antennas at midpoints.
    """
    found = []
    for one, other in combinations(record.arrays, 2):
        if abs(one.station_m - other.station_m) < _LEAST_APART_M:
            continue
        rows = [array.phase_centers_m[:, 1:] for array in (one, other)]
        near = [
            KDTree(rows[1 - k]).query(rows[k], distance_upper_bound=_SAME_ROW_M)[0] < np.inf
            for k in (0, 1)
        ]
        if min(int(keep.sum()) for keep in near) > 1:
            kept = tuple(
                _rows_of(array, poses[array.name], np.flatnonzero(keep))
                for array, keep in zip((one, other), near, strict=True)
            )
            arrays, planes = zip(*kept, strict=True)
            found.append(Line(arrays=arrays, poses=planes))
    return found


def _rows_of(array: BeltStation, pose: Pose, channels: Ints) -> tuple[BeltStation, Pose]:
    index = (np.arange(pose.n_antennas).reshape(-1, array.n_channels)[:, channels]).ravel()
    kept = replace(
        pose,
        signal=pose.signal[index],
        tx_positions=pose.tx_positions[index],
        rx_positions=pose.rx_positions[index],
    )
    parts = {
        name: tuple(getattr(array, name)[c] for c in channels)
        for name in ("tx_m", "rx_m", "delays_s")
    }
    return replace(array, **parts), kept


def find_motion(
    waveform: Waveform, lines: Sequence[Line], region: LosPrior, num_threads: int | None = None
) -> Motion:
    """Estimate the motion from pairs of arrays on one line.

    lines: of :func:`common_lines`. region: what contains the parcel.

    Returns the motion as recorded, with the expected errors, where too few echoes are seen twice.
    """
    if not lines:
        return Motion()
    motion = Motion(scale=_coarse_scale(lines[0]), n_pairs=1)
    for gate_m in _GATES_M:
        rows = [_pairs(waveform, line, motion, region, gate_m, num_threads) for line in lines]
        misfit, design = (np.concatenate(part) for part in zip(*rows, strict=True))
        if len(misfit) < _LEAST_PAIRS:
            return Motion()
        motion = _refined(motion, misfit, design)
    return motion


def _coarse_scale(line: Line) -> float:
    """Scale at which the range profiles of both arrays agree best, to some tenths of a percent."""
    profiles = []
    for array, pose in zip(line.arrays, line.poses, strict=True):
        signal = pose.signal.reshape(-1, array.n_channels, pose.signal.shape[1])
        window = np.hanning(signal.shape[2] + 2)[1:-1]
        power = (np.abs(np.fft.fft(window * (signal - signal.mean(axis=0)), axis=2)) ** 2).mean(1)
        power = np.sqrt(power)
        x = pose.phase_centers[:, 0].reshape(len(power), -1).mean(axis=1)
        order = np.argsort(x)
        profiles.append((x[order], power[order]))
    (x1, one), (x2, other) = profiles
    step = float(np.median(np.abs(np.diff(x1))))
    apart = line.arrays[1].station_m - line.arrays[0].station_m
    lags = np.arange(-_MOST_WRONG * abs(apart), _MOST_WRONG * abs(apart) + step, 0.5 * step)
    x = np.arange(max(x1[0], x2[0] - lags[0]), min(x1[-1], x2[-1] - lags[-1]), step)
    first = _interpolated(x, x1, one)
    scores = np.array([np.vdot(first, _interpolated(x + lag, x2, other)) for lag in lags])
    # The recorded distance of one position is -scale error times that of the stations.
    return float(lags[int(scores.argmax())]) / apart


def _interpolated(x: Floats, known: Floats, values: Floats) -> Floats:
    found = np.stack([np.interp(x, known, column) for column in values.T], axis=1)
    found -= found.mean(axis=0)
    return np.asarray(found / max(float(np.linalg.norm(found)), 1e-300))


def _pairs(
    waveform: Waveform,
    line: Line,
    motion: Motion,
    region: LosPrior,
    gate_m: float,
    num_threads: int | None,
) -> tuple[Floats, Floats]:
    """Misfits R_2 - R_1 + (c_2 - c_1) . u of pairs, (n,) [m], and derivatives, (n, 4)."""
    planes = tuple(
        corrected(pose, array, motion) for pose, array in zip(line.poses, line.arrays, strict=True)
    )
    capture = Capture(waveform=waveform, poses=planes)
    peaks = collect_peaks(capture, region, _PEAKS, _MARGIN_DB, num_threads=num_threads)
    one, other = (_true_directions(peaks.of_plane(k), planes[k]) for k in (0, 1))
    i, j = _near(one.centers, other.centers)
    misfit, mean = _misfit(one, i, other, j)
    keep = (np.abs(misfit) < gate_m) & (
        np.abs(one.directions[i] - other.directions[j]).max(axis=1) < _SAME_COSINE
    )
    i, misfit, mean = i[keep], misfit[keep], mean[keep]
    c1, c2 = one.centers[i], other.centers[j[keep]]
    moves = [
        _moves(array.station_m - c[:, 0], c) for array, c in zip(line.arrays, (c1, c2), strict=True)
    ]
    # A displacement d of the antenna changes the range by -u . d.
    design = -np.einsum("ni,nki->nk", mean, moves[1] - moves[0])
    return misfit, np.concatenate([design, np.ones((len(design), 1))], axis=1)


def _moves(travel: Floats, centers: Floats) -> Floats:
    """Displacements by scale, change and turn, (n, 3, 3)."""
    zero = np.zeros_like(travel)
    return np.stack(
        [
            np.stack([-travel, zero, zero], axis=1),
            np.stack([-(travel**2), zero, zero], axis=1),
            np.stack([travel * centers[:, 1], -travel * centers[:, 0], zero], axis=1),
        ],
        axis=1,
    )


def _misfit(one: PeakSet, i: Ints, other: PeakSet, j: Ints) -> tuple[Floats, Floats]:
    mean = 0.5 * (one.directions[i] + other.directions[j])
    apart = other.centers[j] - one.centers[i]
    return other.ranges_m[j] - one.ranges_m[i] + np.einsum("ni,ni->n", apart, mean), mean


def _near(one: Floats, other: Floats) -> tuple[Ints, Ints]:
    """Pairs of positions at most `_NEAR_M` apart."""
    found = KDTree(one).query_ball_tree(KDTree(other), _NEAR_M)
    counts = [len(part) for part in found]
    first = np.repeat(np.arange(len(one)), counts)
    return first, np.array([k for part in found for k in part], dtype=np.int64)


def _true_directions(peaks: PeakSet, pose: Pose) -> PeakSet:
    """Peaks whose direction, among its aliases, fits the range of a neighbouring sub-aperture."""
    period = float(peaks.periods[0, 0]) if len(peaks) else np.inf
    if not np.isfinite(period):
        return peaks
    i, j = _near(peaks.centers, peaks.centers)
    along = (peaks.centers[j] - peaks.centers[i]) @ pose.axes[1]
    keep = (np.abs(along) > 0.25 * _NEAR_M) & (
        np.abs(peaks.directions[i] - peaks.directions[j]).max(axis=1) < _SAME_COSINE
    )
    i, j, along = i[keep], j[keep], along[keep]
    misfit, _ = _misfit(peaks, i, peaks, j)
    best = np.rint(-misfit / (along * period))
    rest = np.abs(misfit + best * along * period)
    order = np.lexsort((rest, i))
    first = order[np.unique(i[order], return_index=True)[1]]
    first = first[(rest[first] < 0.1 * period * _NEAR_M) & (np.abs(best[first]) <= 2.0)]
    found = peaks.select(i[first])
    cosines = found.directions @ pose.axes[1:].T
    cosines[:, 0] += best[first] * period
    known = (cosines**2).sum(axis=1) < 0.95
    found, cosines = found.select(known), cosines[known]
    ahead = np.sqrt(1.0 - (cosines**2).sum(axis=1))
    return replace(found, directions=np.column_stack([ahead, cosines]) @ pose.axes)


def _refined(motion: Motion, misfit: Floats, design: Floats) -> Motion:
    """Robust least squares with the expected errors as prior."""
    solution, rest = np.zeros(4), misfit
    for _ in range(10):
        scale = max(1.4826 * float(np.median(np.abs(rest))), _RANGE_SIGMA_M)
        weight = 1.0 / (1.0 + (rest / (2.0 * scale)) ** 2) ** 2
        normal = (design.T * weight) @ design / (scale**2 * _OVERLAP) + np.diag(SIGMAS**-2.0)
        solution = np.linalg.solve(normal, (design.T * weight) @ misfit / (scale**2 * _OVERLAP))
        rest = misfit - design @ solution
    sigma = np.sqrt(np.diag(np.linalg.inv(normal)))
    return Motion(
        scale=motion.scale + float(solution[0]),
        change_per_m=motion.change_per_m + float(solution[1]),
        turn_rad_per_m=motion.turn_rad_per_m + float(solution[2]),
        scale_sigma=float(sigma[0]),
        change_sigma_per_m=float(sigma[1]),
        turn_sigma_rad_per_m=float(sigma[2]),
        n_pairs=len(misfit),
    )
