"""Samples of separate transmitters and receivers, as antennas at their midpoints would record.

Half the path of a channel with the half baseline h is, seen from its midpoint,

    q(r) = r + (h^2 - (h . u)^2) / (2 r) + O(h^4 / 8 r^3),

so the excess depends on range and direction. Range profiles are stretched by it in the direction of
the belt's middle line; of another direction u' the error (h . (u' - u)) (h . (u' + u)) / (2 r) is
left, 0.1 mm for h = 2 cm, r = 0.35 m and 20 degrees. Stretching moves the band by h^2 / 2 r^2 of
the carrier: a share of the bandwidth is lost, not the phase.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Floats
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.imaging.bistatic import common_half_baseline
from geraf2.io.belt_file import BeltRecord, BeltStation
from geraf2.records import Pose, Waveform

_OVERSAMPLING = 4
# Nearer echoes are leakage, whose excess is not that of the far field [m].
_MIN_RANGE_M = 0.1
# Largest displacement onto a raster [m]; its error 24 degrees off the middle is 0.4 of it.
_MAX_MOVED_M = 4e-3
# Excess up to which a midpoint is as good: 19 degrees of two-way phase at 77 GHz is 0.1 mm [m].
NEGLIGIBLE_M = 1e-5
# Half sides of a parcel's content over the distance of the array; points along each.
_CONTENT, _N_CONTENT = 0.3, 5
# Rms error of the half path at which an array loses a fifth of its power (Marechal) [wavelengths].
_MAX_ERROR = 1.0 / 28.0


def excess_m(tx: Floats, rx: Floats, ranges_m: Floats) -> Floats:
    """Half path via a point of the middle line, less the midpoint's range, (n, n_ranges) [m].

    tx, rx: (n, 3) [m]. ranges_m: from the midpoint towards the line y = z = 0, (n_ranges,) [m].
    """
    middles = 0.5 * (tx + rx)
    toward = -middles * [0.0, 1.0, 1.0]
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    far = np.maximum(ranges_m, _MIN_RANGE_M)
    points = middles[:, None] + far[:, None] * toward[:, None]
    paths = [np.linalg.norm(points - ends[:, None], axis=2) for ends in (tx, rx)]
    return np.asarray(0.5 * (paths[0] + paths[1]) - far)


def midpoint_error_m(array: BeltStation) -> float:
    """Rms error of the range from the midpoints, over channels and content [m].

    Of the half path via points of a cube about the middle of the belt, less that which
    :func:`stretch_matrices` subtracts. Its half sides are 0.3 times the distance of the array.
    """
    tx, rx = np.array(array.tx_m), np.array(array.rx_m)
    middles = 0.5 * (tx + rx)
    half_m = _CONTENT * float(np.linalg.norm(middles[:, 1:].mean(axis=0)))
    along = np.linspace(-half_m, half_m, _N_CONTENT)
    points = np.stack(np.meshgrid(array.station_m + along, along, along), axis=-1).reshape(-1, 3)
    range_, *paths = (np.linalg.norm(points - end[:, None], axis=2) for end in (middles, tx, rx))
    known = [excess_m(t[None], r[None], own)[0] for t, r, own in zip(tx, rx, range_, strict=True)]
    return float(np.sqrt(np.mean((0.5 * (paths[0] + paths[1]) - range_ - known) ** 2)))


def _is_common(array: BeltStation) -> bool:
    """Whether images take account of the channels' baseline."""
    return common_half_baseline(np.array(array.tx_m), np.array(array.rx_m)) is not None


def list_wide_baselines(record: BeltRecord, waveform: Waveform) -> Iterator[str]:
    """Yield a line for each array whose midpoints err by more than 1/28 of the wavelength."""
    max_m = _MAX_ERROR * waveform.center_wavelength_m
    for array in record.arrays:
        error_m = 0.0 if _is_common(array) else midpoint_error_m(array)
        if error_m > max_m:
            apart = np.linalg.norm(np.subtract(array.tx_m, array.rx_m), axis=1).max()
            yield (
                f"array {array.name}: baselines of up to {1e3 * apart:.0f} mm that differ, ranges "
                f"from the midpoints err by {1e3 * error_m:.2f} mm, expected at most "
                f"{1e3 * max_m:.2f} mm"
            )


def stretch_matrices(array: BeltStation, waveform: Waveform) -> NDArray[np.complex64] | None:
    """Matrices that turn samples into those at the midpoints, (n_channels, n_samples, n_samples).

    None where transmitters and receivers are so close that midpoints are exact, or where all
    channels have one baseline, of which images take account (:mod:`geraf2.imaging.bistatic`).
    """
    n = waveform.n_samples
    ranges = waveform.unambiguous_range_m * np.arange(_OVERSAMPLING * n) / (_OVERSAMPLING * n)
    excess = excess_m(np.array(array.tx_m), np.array(array.rx_m), ranges)
    if np.abs(excess).max() < NEGLIGIBLE_M or _is_common(array):
        return None
    k = 2.0 * np.pi * waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    back = np.exp(-2j * np.outer(k, ranges)) / len(ranges)
    matrices = [back @ np.exp(2j * np.outer(ranges + own, k)) for own in excess]
    # The delay turns both sides alike: exp(-j k_t b) A exp(j k_t' b).
    delay = np.exp(-1j * k * waveform.path_bias_m)
    return np.asarray(delay[:, None] * np.array(matrices) * delay.conj(), dtype=np.complex64)


def move_to_midpoints(pose: Pose, matrices: NDArray[np.complex64] | None) -> Pose:
    """Plane of whole frames with transmitter and receiver of each channel at its midpoint."""
    if matrices is None:
        return pose
    n_channels, n_samples, _ = matrices.shape
    frames = pose.signal.reshape(-1, n_channels, n_samples).transpose(1, 2, 0)
    signal = (matrices @ frames).transpose(2, 0, 1).reshape(-1, n_samples)
    middles = pose.phase_centers
    return replace(
        pose, signal=np.ascontiguousarray(signal), tx_positions=middles, rx_positions=middles
    )


def move_to_raster(pose: Pose, n_channels: int, waveform: Waveform) -> Pose:
    """Plane of whole frames with antennas on a raster, at most 4 mm from where they were.

    Transmitters that take turns, an encoder's errors and a parcel that turns displace them. The
    samples are corrected for the frame's origin, the middle of the parcel: a displacement d errs by
    d . (u - u_0) in another direction. The same plane where no raster is near.
    """
    local = (pose.phase_centers @ pose.axes.T).reshape(-1, n_channels, 3)
    frames = np.arange(len(local)) - 0.5 * (len(local) - 1)
    along = local[..., 1].mean(axis=1)
    step = frames @ (along - along.mean()) / max(float(frames @ frames), 1.0)
    raster = np.empty_like(local)
    raster[..., 0] = local[..., 0].mean()
    raster[..., 1] = (along.mean() + step * frames)[:, None]
    raster[..., 2] = local[..., 2].mean(axis=0)
    positions = (raster.reshape(-1, 3)) @ pose.axes
    moved = positions - pose.phase_centers
    if np.abs(moved).max() > _MAX_MOVED_M:
        return pose
    ends = [pose.tx_positions, pose.rx_positions]
    path = np.sum(
        [np.linalg.norm(at, axis=1) - np.linalg.norm(at + moved, axis=1) for at in ends], 0
    )
    turns = path[:, None] * waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    signal = (pose.signal * np.exp(2j * np.pi * turns)).astype(np.complex64)
    tx, rx = (at + moved for at in ends)
    return replace(pose, signal=signal, tx_positions=tx, rx_positions=rx)
