"""Motion of a parcel on a belt, from what two arrays on one line see one after the other.

One array sees smooth surfaces the same at any speed: its ranges over the recorded travel always fit
some surface. A second array at another station of the same line passes the same positions of the
parcel's frame later. There both see the same echoes, so that

    R_2 - R_1 = -(c_2 - c_1) . (u_1 + u_2) / 2        (to third order in c_2 - c_1)

for positions c, directions u and ranges R of two sub-apertures. Errors of the recorded travel s,
s (a + b s) along the belt and the rotation by p s, displace c_2 and c_1 by different amounts.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from geraf2._types import Floats, Ints
from geraf2.apps.belt.monostatic import move_to_raster
from geraf2.echoes.echo_phases import response_at
from geraf2.imaging.peaks import PeakSet, collect_peaks
from geraf2.imaging.subapertures import SubapertureConfig
from geraf2.io.belt_file import BeltRecord, BeltStation
from geraf2.records import Pose, Waveform
from geraf2.scene import Capture, LosPrior

_STEP_M = 0.01
# Side of a sub-aperture over that of the region of the parcel: 7 cm at 0.35 m. A larger one would
# defocus echoes that are far from its normal.
_SIZE = 0.14
_MARGIN_DB = 15.0
# Least distance of two stations [m]; largest distance of rows of both arrays [m].
_MIN_APART_M, _SAME_ROW_M = 0.05, 0.003
# Largest distance of two sub-apertures [m], and difference of their directions.
_NEAR_M, _SAME_COSINE = 0.012, 0.06
# Distance of sub-apertures whose ranges show an alias: 4 mm of raster and 1 cm make 5 mm [m].
_ALIAS_M = (0.01, 0.03)
# Largest misfit of a pair, in the first round and in the last [m].
_MAX_MISFIT_M, _GATE_M, _N_ROUNDS = 0.015, 0.003, 20
# Expected errors: of the speed, of its change [1/m], of the yaw [rad/m], of the delay [m].
SIGMAS = np.array([0.02, 0.01, 0.1, 0.002])
# Least range error of a pair [m]; neighbouring pairs that share an error.
_RANGE_SIGMA_M, _OVERLAP = 1e-4, 4.0
_MIN_PAIRS = 20
# Peaks whose phases are compared, and rounds of that.
_N_PHASES, _N_PHASE_ROUNDS = 400, 3
# Grid of speeds and yaws, less than a radian apart at the usual errors, and its rounds.
_N_GRID, _N_GRID_ROUNDS = 121, 3
# Largest error of the speed that profiles are searched for.
_MAX_WRONG = 0.15


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

    def place_antennas(self, nominal: Floats, recorded: Floats) -> Floats:
        """Positions in the parcel's frame, (n, 3) [m].

        nominal: where the arrays stand, (n, 3) [m]. recorded: positions in the record, (n, 3) [m].
        """
        travel = nominal[:, 0] - recorded[:, 0]
        travel = travel * (1.0 + self.scale + self.change_per_m * travel)
        x, y = nominal[:, 0] - travel, recorded[:, 1]
        cos, sin = np.cos(self.turn_rad_per_m * travel), -np.sin(self.turn_rad_per_m * travel)
        return np.stack([cos * x - sin * y, sin * x + cos * y, recorded[:, 2]], axis=1)


def correct_plane(pose: Pose, array: BeltStation, motion: Motion) -> Pose:
    """Plane of whole frames with its antennas where the motion puts them."""
    n_frames = pose.n_antennas // array.n_channels
    recorded = pose.phase_centers
    nominal = np.tile(array.phase_centers_m, (n_frames, 1))
    return pose.moved(motion.place_antennas(nominal, recorded) - recorded)


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
    for *pair, rows in pairs_on_a_line(record):
        kept = tuple(
            _select_rows(array, poses[array.name], own)
            for array, own in zip(pair, rows, strict=True)
        )
        arrays, planes = zip(*kept, strict=True)
        found.append(Line(arrays=arrays, poses=planes))
    return found


def pairs_on_a_line(
    record: BeltRecord,
) -> Iterator[tuple[BeltStation, BeltStation, tuple[Ints, Ints]]]:
    """Yield arrays that pass the same positions, and which channels of each do."""
    for one, other in combinations(record.arrays, 2):
        if abs(one.station_m - other.station_m) < _MIN_APART_M:
            continue
        rows = [array.phase_centers_m[:, 1:] for array in (one, other)]
        near = [
            KDTree(rows[1 - k]).query(rows[k], distance_upper_bound=_SAME_ROW_M)[0] < np.inf
            for k in (0, 1)
        ]
        if min(int(keep.sum()) for keep in near) > 1:
            yield one, other, (np.flatnonzero(near[0]), np.flatnonzero(near[1]))


def _select_rows(array: BeltStation, pose: Pose, channels: Ints) -> tuple[BeltStation, Pose]:
    index = (np.arange(pose.n_antennas).reshape(-1, array.n_channels)[:, channels]).ravel()
    parts: dict[str, Any] = {
        name: tuple(getattr(array, name)[c] for c in channels)
        for name in ("tx_m", "rx_m", "delays_s")
    }
    return replace(array, **parts), pose.select(index)


def find_motion(
    waveform: Waveform, lines: Sequence[Line], region: LosPrior, num_threads: int | None = None
) -> Motion:
    """Estimate the motion from pairs of arrays on one line.

    lines: of :func:`common_lines`. region: what contains the parcel.

    Returns the motion as recorded, with the expected errors, where too few echoes are seen twice.
    """
    if not lines:
        return Motion()
    first = Motion(scale=_coarse_scale(lines[0]))
    seen = [_find_peaks(waveform, line, first, region, num_threads) for line in lines]
    pairs = [_pairs(line, *peaks) for line, peaks in zip(lines, seen, strict=True)]
    motion = _fit(first, pairs, np.geomspace(_MAX_MISFIT_M, _GATE_M, _N_ROUNDS))
    if not motion.n_pairs:
        return motion
    size_m, wavelength_m = _SIZE * region.size_m[0], waveform.center_wavelength_m

    def phases(at: Motion) -> list[tuple[Floats, Floats]]:
        return [
            _phase_misfits(waveform, line, (first, at), peaks[0], size_m)
            for line, peaks in zip(lines, seen, strict=True)
        ]

    # By ranges a change of the speed is mistaken for an error of speed and yaw, and the reverse.
    motion = replace(motion, change_per_m=0.0)
    for _ in range(_N_GRID_ROUNDS):
        motion = find_most_coherent(motion, phases(motion), wavelength_m)
    # Phases are unambiguous within a quarter of the wavelength.
    gates = np.full(_N_ROUNDS, 0.22 * wavelength_m)
    for _ in range(_N_PHASE_ROUNDS):
        motion = _fit(motion, phases(motion), gates)
    return motion


def find_most_coherent(
    motion: Motion, rows: Sequence[tuple[Floats, Floats]], wavelength_m: float
) -> Motion:
    """Motion whose speed and yaw, within four standard errors, make the most phases agree.

    Ranges leave errors of several periods of the phase: a fit of phases would end at any of them.
    """
    wavenumber = 4.0 * np.pi / wavelength_m
    half_widths = (4.0 * motion.scale_sigma, 4.0 * motion.turn_sigma_rad_per_m)
    steps = [np.linspace(-half, half, _N_GRID) for half in half_widths]
    score = np.zeros((_N_GRID, _N_GRID))
    for misfit, design in rows:
        scale, turn = (
            np.exp(-1j * wavenumber * np.outer(design[:, k], step))
            for k, step in zip((0, 2), steps, strict=True)
        )
        score += np.abs((scale * np.exp(1j * wavenumber * misfit)[:, None]).T @ turn)
    i, j = np.unravel_index(int(score.argmax()), score.shape)
    return replace(
        motion,
        scale=motion.scale + float(steps[0][i]),
        turn_rad_per_m=motion.turn_rad_per_m + float(steps[1][j]),
    )


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
    lags = np.arange(-_MAX_WRONG * abs(apart), _MAX_WRONG * abs(apart) + step, 0.5 * step)
    x = np.arange(max(x1[0], x2[0] - lags[0]), min(x1[-1], x2[-1] - lags[-1]), step)
    first = _interpolate(x, x1, one)
    scores = np.array([np.vdot(first, _interpolate(x + lag, x2, other)) for lag in lags])
    # The recorded distance of one position is -scale error times that of the stations.
    return float(lags[int(scores.argmax())]) / apart


def _interpolate(x: Floats, known: Floats, values: Floats) -> Floats:
    found = np.stack([np.interp(x, known, column) for column in values.T], axis=1)
    found -= found.mean(axis=0)
    return np.asarray(found / max(float(np.linalg.norm(found)), 1e-300))


def _find_peaks(
    waveform: Waveform, line: Line, first: Motion, region: LosPrior, num_threads: int | None
) -> tuple[PeakSet, PeakSet]:
    """Peaks of both arrays, on their recorded raster at the scale that was found first."""
    planes = tuple(
        move_to_raster(correct_plane(pose, array, first), array.n_channels, waveform)
        for pose, array in zip(line.poses, line.arrays, strict=True)
    )
    capture = Capture(waveform=waveform, poses=planes)
    images = SubapertureConfig(
        size_m=_SIZE * region.size_m[0], step_m=_STEP_M, direction_oversampling=2.0
    )
    peaks = collect_peaks(capture, region, images, _MARGIN_DB, num_threads=num_threads)
    one, other = (_true_directions(peaks.of_plane(k), planes[k]) for k in (0, 1))
    return one, other


def _pairs(line: Line, one: PeakSet, other: PeakSet) -> tuple[Floats, Floats]:
    """Misfits R_2 - R_1 + (c_2 - c_1) . u of pairs, (n,) [m], and derivatives, (n, 4)."""
    i, j = _near_pairs(one.centers, other.centers, _NEAR_M)
    misfit, mean = _misfit(one, i, other, j)
    keep = (np.abs(misfit) < _MAX_MISFIT_M) & (
        np.abs(one.directions[i] - other.directions[j]).max(axis=1) < _SAME_COSINE
    )
    i, j = i[keep], j[keep]
    return misfit[keep], _design(line, one.centers[i], other.centers[j], mean[keep])


def _design(line: Line, one: Floats, other: Floats, directions: Floats) -> Floats:
    """Return the derivatives of R_2 - R_1 by scale, change, turn and delay, (n, 4)."""
    # one, other: positions of both arrays' sub-apertures, (n, 3) [m]. directions: (n, 3).
    moves = [
        _moves(array.station_m - c[:, 0], c)
        for array, c in zip(line.arrays, (one, other), strict=True)
    ]
    # A displacement d of the antenna changes the range by -u . d.
    design = -np.einsum("ni,nki->nk", directions, moves[1] - moves[0])
    return np.concatenate([design, np.ones((len(design), 1))], axis=1)


def _phase_misfits(
    waveform: Waveform, line: Line, motions: tuple[Motion, Motion], peaks: PeakSet, size_m: float
) -> tuple[Floats, Floats]:
    """R_2 - R_1 by the phases of both arrays at the strongest peaks, (n,) [m], and derivatives."""
    # motions: in whose frame the peaks are, and at which both arrays are focused. size_m: of the
    # sub-apertures.
    first, motion = motions
    margins = peaks.margins_db
    strong = peaks.select(np.sort(np.argsort(-margins, kind="stable")[:_N_PHASES]))
    array = line.arrays[0]
    recorded = strong.centers.copy()
    recorded[:, 0] = array.station_m - (array.station_m - recorded[:, 0]) / (1.0 + first.scale)
    nominal = recorded.copy()
    nominal[:, 0] = array.station_m
    centers = motion.place_antennas(nominal, recorded)
    points = strong.points + centers - strong.centers
    sums = [
        _focus(waveform, correct_plane(pose, own, motion), centers, points, size_m)
        for own, pose in zip(line.arrays, line.poses, strict=True)
    ]
    both = sums[1] * sums[0].conj()
    wavenumber = 2.0 * np.pi / waveform.center_wavelength_m
    directions = (points - centers) / strong.ranges_m[:, None]
    keep = np.abs(both) > 0.0
    misfit = -np.angle(both) / (2.0 * wavenumber)
    return misfit[keep], _design(line, centers, centers, directions)[keep]


def _focus(
    waveform: Waveform, pose: Pose, centers: Floats, points: Floats, size_m: float
) -> NDArray[np.complex128]:
    """Sum the antennas around each centre, focused on its point, (n,)."""
    antennas = pose.phase_centers
    near = KDTree(antennas).query_ball_point(centers, 0.5 * size_m)
    sums = np.zeros(len(centers), dtype=np.complex128)
    for number, own in enumerate(near):
        if len(own) < _MIN_PAIRS:
            continue
        apart = np.linalg.norm(antennas[own] - centers[number], axis=1) / size_m
        path = np.linalg.norm(pose.tx_positions[own] - points[number], axis=1)
        path += np.linalg.norm(pose.rx_positions[own] - points[number], axis=1)
        path += waveform.path_bias_m
        weight = np.cos(np.pi * apart) ** 2
        sums[number] = weight @ response_at(pose.signal[own], path, waveform)
    return sums


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


def _near_pairs(one: Floats, other: Floats, max_m: float) -> tuple[Ints, Ints]:
    """Pairs of positions at most so far apart [m]."""
    found = KDTree(one).query_ball_tree(KDTree(other), max_m)
    counts = [len(part) for part in found]
    first = np.repeat(np.arange(len(one)), counts)
    return first, np.array([k for part in found for k in part], dtype=np.int64)


def _true_directions(peaks: PeakSet, pose: Pose) -> PeakSet:
    """Peaks whose direction, among its aliases, fits the range of a neighbouring sub-aperture."""
    period = float(peaks.periods[0, 0]) if len(peaks) else np.inf
    if not np.isfinite(period):
        return peaks
    i, j = _near_pairs(peaks.centers, peaks.centers, _ALIAS_M[1])
    along = (peaks.centers[j] - peaks.centers[i]) @ pose.axes[1]
    keep = (np.abs(along) > _ALIAS_M[0]) & (
        np.abs(peaks.directions[i] - peaks.directions[j]).max(axis=1) < _SAME_COSINE
    )
    i, j, along = i[keep], j[keep], along[keep]
    misfit, _ = _misfit(peaks, i, peaks, j)
    best = np.rint(-misfit / (along * period))
    rest = np.abs(misfit + best * along * period)
    keep = (rest < 0.2 * period * _ALIAS_M[0]) & (np.abs(best) <= 2.0)
    i, best = i[keep], best[keep]
    # The alias that most neighbours confirm.
    pairs, first, counts = np.unique(
        np.stack([i, best], axis=1), axis=0, return_index=True, return_counts=True
    )
    order = np.lexsort((-counts, pairs[:, 0]))
    chosen = order[np.unique(pairs[order, 0], return_index=True)[1]]
    first = first[chosen]
    found = peaks.select(i[first])
    cosines = found.directions @ pose.axes[1:].T
    cosines[:, 0] += best[first] * period
    known = (cosines**2).sum(axis=1) < 0.95
    found, cosines = found.select(known), cosines[known]
    ahead = np.sqrt(1.0 - (cosines**2).sum(axis=1))
    return replace(found, directions=np.column_stack([ahead, cosines]) @ pose.axes)


def _fit(first: Motion, rows: Sequence[tuple[Floats, Floats]], gates_m: Floats) -> Motion:
    """Robust least squares with the expected errors as prior; a limit of misfit for each round."""
    misfit, design = (np.concatenate(part) for part in zip(*rows, strict=True))
    known = np.array([first.scale, first.change_per_m, first.turn_rad_per_m, 0.0])
    # The first scale is that of the profiles, wherever the speed lies.
    known[0] *= first.n_pairs > 0
    step = np.zeros(4)
    for gate_m in gates_m:
        rest = misfit - design @ step
        kept = np.abs(rest) < gate_m
        if int(kept.sum()) < _MIN_PAIRS:
            return Motion()
        scale = max(1.4826 * float(np.median(np.abs(rest[kept]))), _RANGE_SIGMA_M)
        weight = kept / (1.0 + (rest / (2.0 * scale)) ** 2) ** 2
        weight /= scale**2 * _OVERLAP
        normal = (design.T * weight) @ design + np.diag(SIGMAS**-2.0)
        step = np.linalg.solve(normal, (design.T * weight) @ misfit - SIGMAS**-2.0 * known)
    sigma = np.sqrt(np.diag(np.linalg.inv(normal)))
    return Motion(
        scale=first.scale + float(step[0]),
        change_per_m=first.change_per_m + float(step[1]),
        turn_rad_per_m=first.turn_rad_per_m + float(step[2]),
        scale_sigma=float(sigma[0]),
        change_sigma_per_m=float(sigma[1]),
        turn_sigma_rad_per_m=float(sigma[2]),
        n_pairs=int(kept.sum()),
    )
