"""Coherent change of two scans of one content: echoes of one scan that the other does not have.

Both scans are imaged by the same blocks of antennas, as the content sees them. A phase for each
block and one linear across the content are fitted for each plane; the residual is compared with
the power of the echoes (docs/inspection.md#two-scans).
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from geraf2._types import Array, Bools, Floats, Ints
from geraf2.apps.inspection.workers import Workers
from geraf2.geometry.transforms import apply_rigid, inverse_rigid, rigid
from geraf2.ops import matched_filter
from geraf2.records import Waveform
from geraf2.scene import Capture

_BLOCK_M, _MIN_BLOCKS = 0.02, 2
"""Distance of the blocks of antennas, half their side [m], and their least number along a side."""
_CELL_M = 0.002
"""Side of the cells of which one peak is a position: half the resolution of a plane [m]."""
_WALL_M = 0.008
"""Distance to the walls below which nothing is compared: their bulges change [m]."""
_WALL_COSINE = float(np.cos(np.deg2rad(9.0)))
"""Cosine to a wall's normal above which the wall's echo lies in a block's beam."""
_N_FIT = 400
"""Most positions from which phases are fitted."""
_MAX_TURN, _N_TURNS_TRIED, _N_FINER, _N_SEARCHES = 0.04, 27, 9, 3
"""Largest turn between the scans that is sought [rad]; steps of the search, of its finer ones, and
number of searches."""
_N_ROUNDS, _N_WEIGHTS, _TURN_RAD, _MAX_ERROR_RAD = 2, 5, 0.003, 0.009
"""Rounds of the registration, steps of its weights, error of a plane's turn, and the median error
beyond which phases do not hold [rad]."""
_SHARE, _WALL_SHARE, _FLOOR = 0.015, 0.52, 0.013
"""Variance of the difference of unchanged echoes as a share of their power: in general, and where
a wall echoes; and as a share of the mean power of the plane. These and the wall's angle are the
likeliest for the unchanged pairs of boxes 10000 to 10007 (`bench/python/compare_pairs.py`)."""
_SCALE, _TAIL = 0.79, 4.5
"""Of the change T of unchanged echoes: T / _SCALE is F(2, 2 _TAIL). Likeliest for the unchanged
pairs of boxes 10000 to 10019."""
_SEEN, _MAX_CHANGE = 0.5, 1e3
"""Share of planes that show a change, and its largest T / _SCALE: its logarithm is uniform."""


class Signals(NamedTuple):
    """What a scan received, and its box."""

    capture: Capture
    """With the corrections of its run."""
    plane_middles: Floats
    """Middle of the antennas of each plane, (n_planes, 3) [m]."""
    box: tuple[Floats, Floats, Floats] | None
    """Axes (rows), sides and middle of the box [m]; None without one."""


class Spots(NamedTuple):
    """Positions with echoes, and whether these changed."""

    points: Floats
    """(n, 3), in the frame of the run [m]."""
    log_ratios: Floats
    """Log likelihood of a change over that of none, of all planes, (n,)."""
    gains: Floats
    """Shares by which the run's echo is the stronger one, weighted by the evidence, (n,)."""


class _Placed(NamedTuple):
    """Positions of the content, and where it lies in both scans."""

    pose: Floats
    """Moves the run into the frame of the reference, (4, 4)."""
    middle: Floats
    """Of the content, (3,) [m]."""
    points: Floats
    """(n_points, 3) [m]."""

    @property
    def points_there(self) -> Floats:
        """Positions in the frame of the reference, (n_points, 3) [m]."""
        return apply_rigid(self.pose, self.points)


class _Side(NamedTuple):
    """One scan of a plane."""

    signal: Array
    """With a Hann window over the chirp, (n_antennas, n_samples)."""
    antennas: tuple[Floats, Floats]
    weights: Floats
    """Of the antennas in each block, (n_blocks, n_antennas)."""
    waveform: Waveform

    def image(self, points: Floats) -> Array:
        """Image of each block, (n_blocks, n_points)."""
        images = []
        for weight in self.weights:
            used = np.flatnonzero(weight)
            own = len(used) * weight[used] / max(float(weight.sum()), 1e-30)
            signal = np.asarray(own[:, None] * self.signal[used], dtype=np.complex64)
            tx, rx = (positions[used] for positions in self.antennas)
            images.append(matched_filter(signal, tx, rx, points, self.waveform, num_threads=1))
        return np.array(images)

    def remove_phases(self, phasors: Array) -> "_Side":
        """Without the phases of the blocks (n_blocks,), linear between them."""
        screen = phasors @ self.weights
        screen /= np.maximum(np.abs(screen), 1e-30)
        return self._replace(signal=self.signal * np.conj(screen)[:, None])


class _View(NamedTuple):
    """One plane of both scans; the frame is that of the run."""

    here: _Side
    there: _Side
    middles: Floats
    """Of the blocks, (n_blocks, 3) [m]."""
    axes: Floats
    """Rows towards the antennas, horizontal and vertical, (3, 3)."""


def refine_turn(
    pose: Floats, here: Signals, there: Signals, peaks: tuple[Floats, Floats], workers: Workers
) -> Floats:
    """Pose of the run in the frame of the reference, its turn by the phases, (4, 4).

    pose: by the walls, (4, 4). peaks: positions of those of the run and of the reference, each in
    its own frame, (n, 3) [m].
    """
    number = _two_way_wavenumber(here)
    for _ in range(_N_ROUNDS):
        points, middle = _positions(here, pose, peaks)
        points = points[_choose_few(len(points))]
        if not len(points):
            break
        at = _Placed(pose, middle, points)

        def slopes(planes: tuple[int, int], at: _Placed = at) -> Floats:
            view = _view(here, there, planes, at)
            if view is None:
                return np.zeros((0, 5))
            one, other = view.here.image(at.points), view.there.image(at.points_there)
            found = fit_phases(one, other, at.points @ view.axes[1:].T, _MAX_TURN * number)
            # A turn w moves a position r by w x r, its path to the antennas by n . (w x r).
            design = np.cross(view.axes[1:], view.axes[0])
            return np.column_stack([design, found[0] / number, np.full(2, found[2] ** 2)])

        rows = np.concatenate(workers.each(slopes, _pairs(here, there, pose)))
        if not len(rows):
            break
        turn, error = _turn(rows[:, :3], rows[:, 3], rows[:, 4])
        if error > _MAX_ERROR_RAD:
            break
        rotation = Rotation.from_rotvec(turn).as_matrix()
        pose = pose @ rigid(rotation, middle - rotation @ middle)
    return pose


def compare_echoes(
    pose: Floats, here: Signals, there: Signals, peaks: tuple[Floats, Floats], workers: Workers
) -> Spots:
    """Compare the echoes of two scans at the positions of their peaks.

    pose, peaks: as for :func:`refine_turn`.
    """
    points, middle = _positions(here, pose, peaks)
    log_ratios, gains = np.zeros(len(points)), np.zeros(len(points))
    at, few = _Placed(pose, middle, points), _choose_few(len(points))
    walls = np.zeros((0, 3)) if here.box is None else here.box[0]
    most = _MAX_TURN * _two_way_wavenumber(here)

    def gains_of(planes: tuple[int, int]) -> list[float]:
        view = _view(here, there, planes, at)
        if view is None or not len(few):
            return []
        return [gain_of(view.here.image(points[few]), view.there.image(at.points_there[few]))]

    found = np.concatenate(workers.each(gains_of, _pairs(here, there, pose)))
    level = float(np.median(found)) if len(found) else 1.0

    def changes(planes: tuple[int, int]) -> tuple[Floats, Floats]:
        view = _view(here, there, planes, at)
        if view is None or not len(points):
            return np.zeros(len(points)), np.zeros(len(points))
        one, lateral = view.here.image(points), points @ view.axes[1:].T
        other = view.there.image(at.points_there[few])
        _, phasors, _ = fit_phases(one[:, few], other, lateral[few], most)
        other = view.there.remove_phases(phasors).image(at.points_there)
        slopes, phasors, _ = fit_phases(one[:, few], other[:, few], lateral[few], most)
        other = level * other * np.conj(phasors)[:, None] * np.exp(-1j * (lateral @ slopes))
        paths = view.middles[:, None] - points
        paths /= np.linalg.norm(paths, axis=2, keepdims=True)
        faces_wall = np.any(np.abs(paths @ walls.T) > _WALL_COSINE, axis=2)
        change, gain = change_of(one, other, faces_wall)
        return log_ratio(change), gain

    for ratio, gain in workers.each(changes, _pairs(here, there, pose)):
        log_ratios += ratio
        gains += np.maximum(ratio, 0.0) * gain
    return Spots(points, log_ratios, gains)


def fit_phases(
    one: Array, other: Array, lateral: Floats, most: float
) -> tuple[Floats, Array, float]:
    """Phases of one image against another: linear over the points, and constant over each block.

    one, other: (n_blocks, n_points). lateral: (n_points, 2) [m]. most: largest slope [rad/m].
    Returns the slopes (2,) [rad/m], phasors of the blocks (n_blocks,), and the share of the
    amplitudes that is in phase then.
    """
    product = other * np.conj(one)
    # By amplitude rather than power, so that no single echo decides.
    product /= np.sqrt(np.abs(one) ** 2 + np.abs(other) ** 2) + 1e-30
    slopes, steps = np.zeros(2), np.linspace(-most, most, _N_TURNS_TRIED)
    for _ in range(_N_SEARCHES):
        waves = [np.exp(-1j * np.outer(slopes[i] + steps, lateral[:, i])) for i in (0, 1)]
        found = np.sum([np.abs((waves[0] * row) @ waves[1].T) for row in product], axis=0)
        best = np.unravel_index(np.argmax(found), found.shape)
        slopes = slopes + steps[np.array(best)]
        steps = np.linspace(-1.0, 1.0, _N_FINER) * (steps[1] - steps[0])
    sums = (product * np.exp(-1j * (lateral @ slopes))).sum(axis=1)
    size = np.abs(sums)
    share = float(size.sum() / max(float(np.abs(product).sum()), 1e-30))
    return slopes, sums / np.maximum(size, 1e-30), share


def gain_of(one: Array, other: Array) -> float:
    """Amplitude of one image over that of another, as receivers may have other gains.

    one, other: (n_blocks, n_points). The median ratio, weighted by both amplitudes: echoes that
    only one of them has count little.
    """
    sizes = np.abs(one).ravel(), np.abs(other).ravel()
    ratios = sizes[0] / np.maximum(sizes[1], 1e-30)
    order = np.argsort(ratios)
    weights = np.cumsum((sizes[0] * sizes[1])[order])
    return float(ratios[order[np.searchsorted(weights, 0.5 * weights[-1])]])


def change_of(one: Array, other: Array, faces_wall: Bools) -> tuple[Floats, Floats]:
    """Change T between two images at each position, and gain, (n_points,) each.

    one, other: of the run and of the reference, in phase, (n_blocks, n_points). faces_wall: where
    a wall's echo lies in the beam. An echo at the position adds the same d to each block, and v is
    the variance without one: T = |sum d / v|^2 / sum 1 / v. The gain is the difference of
    |sum image / v|^2 as a share of the sum of both.
    """
    power = 0.5 * (np.abs(one) ** 2 + np.abs(other) ** 2)
    variance = np.where(faces_wall, _WALL_SHARE, _SHARE) * power + _FLOOR * power.mean() + 1e-30
    total = (1.0 / variance).sum(axis=0)
    sums = [(image / variance).sum(axis=0) for image in (one, other)]
    squares = np.abs(sums[0]) ** 2, np.abs(sums[1]) ** 2
    gain = (squares[0] - squares[1]) / np.maximum(squares[0] + squares[1], 1e-30)
    return np.abs(sums[0] - sums[1]) ** 2 / total, gain


def log_ratio(change: Floats) -> Floats:
    """Log density of T, where half of the planes show a change, over that where none does.

    change: of all positions of a plane, (n,). Its median is that of no change at least: where
    phases do not hold, it is larger, and shows nothing.
    """
    usual = _TAIL * (2.0 ** (1.0 / _TAIL) - 1.0)
    t = change / max(_SCALE, float(np.median(change)) / usual)
    same = (1.0 + t / _TAIL) ** -(_TAIL + 1.0)
    shown = np.where(t < 1.0, 0.0, 1.0 / (np.clip(t, 1.0, _MAX_CHANGE) * np.log(_MAX_CHANGE)))
    return np.asarray(np.log(1.0 - _SEEN + _SEEN * shown / same))


def _positions(here: Signals, pose: Floats, peaks: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Positions of peaks within the box, one for each cell, (n, 3) [m], and the box's middle."""
    back = inverse_rigid(pose[:3, :3], pose[:3, 3])
    points = np.concatenate([peaks[0], apply_rigid(back, peaks[1])])
    middle = points.mean(axis=0) if len(points) else np.zeros(3)
    if here.box is not None:
        axes, sides, middle = here.box
        inside = np.abs((points - middle) @ axes.T) < 0.5 * sides - _WALL_M
        points = points[inside.all(axis=1)]
    cells = np.floor(points / _CELL_M).astype(np.int64)
    return points[np.unique(cells, axis=0, return_index=True)[1]], middle


def _choose_few(n: int) -> Ints:
    return np.random.default_rng(0).permutation(n)[:_N_FIT]


def _two_way_wavenumber(scan: Signals) -> float:
    """Phase of a path there and back [rad/m]."""
    return 4.0 * np.pi / scan.capture.waveform.center_wavelength_m


def _pairs(here: Signals, there: Signals, pose: Floats) -> list[tuple[int, int]]:
    """Planes of the run, each with that of the reference that is nearest."""
    nearest = KDTree(there.plane_middles).query(apply_rigid(pose, here.plane_middles))[1]
    return [(plane, int(other)) for plane, other in enumerate(nearest)]


def _view(here: Signals, there: Signals, planes: tuple[int, int], at: _Placed) -> _View | None:
    """Blocks of two planes that see the content alike; None where these are too few."""
    poses = here.capture.poses[planes[0]], there.capture.poses[planes[1]]
    back, middle = inverse_rigid(at.pose[:3, :3], at.pose[:3, 3]), at.middle
    centres = poses[0].phase_centers, apply_rigid(back, poses[1].phase_centers)
    axes = poses[0].axes.copy()
    axes[0] *= np.sign((centres[0].mean(axis=0) - middle) @ axes[0])
    local = [(centre - middle) @ axes.T for centre in centres]
    if min(float(xyz[:, 0].min()) for xyz in local) <= 0.0:
        return None
    # Antennas as the content's middle sees them, on the first plane.
    distance = float(local[0][:, 0].mean())
    seen = [distance * xyz[:, 1:] / xyz[:, :1] for xyz in local]
    low = np.max([own.min(axis=0) for own in seen], axis=0)
    high = np.min([own.max(axis=0) for own in seen], axis=0)
    n = np.rint((high - low) / _BLOCK_M).astype(np.int64)
    if n.min() <= _MIN_BLOCKS:
        return None
    step = (high - low) / n
    lines = [low[i] + step[i] * np.arange(1, n[i]) for i in (0, 1)]
    blocks = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
    sides = []
    for pose, own, scan in zip(poses, seen, (here, there), strict=True):
        window = np.hanning(pose.signal.shape[1] + 2)[1:-1]
        weights = np.maximum(1.0 - np.abs(own - blocks[:, None]) / step, 0.0).prod(axis=2)
        antennas = pose.tx_positions, pose.rx_positions
        signal = pose.signal * (window / window.mean())
        sides.append(_Side(signal, antennas, weights, scan.capture.waveform))
    return _View(sides[0], sides[1], middle + distance * axes[0] + blocks @ axes[1:], axes)


def _turn(design: Floats, slopes: Floats, weights: Floats) -> tuple[Floats, float]:
    """Turn (3,) [rad] with design @ turn near slopes (n,), with less regard to those far off."""
    # Also returns the median error [rad].
    own, turn = weights, np.asarray(np.zeros(3))
    for _ in range(_N_WEIGHTS):
        turn = np.asarray(np.linalg.lstsq(design * own[:, None], slopes * own, rcond=None)[0])
        own = weights / np.sqrt(1.0 + ((slopes - design @ turn) / _TURN_RAD) ** 2)
    return turn, float(np.median(np.abs(slopes - design @ turn)))
