"""Vibration of a parcel across the travel, from the phases of its echoes frame by frame.

All channels of an array record a frame at one time, so that a vibration moves them alike in the
parcel's frame. It is a spline along the travel of each array, in its looking direction.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geraf2._types import Ints
from geraf2.calibration.autofocus import (
    DRIFT_SIZE_M,
    AutofocusConfig,
    focus_antennas,
    with_displacements,
)
from geraf2.echoes.echo_phases import collect_phases
from geraf2.imaging.peaks import PeakSet, collect_peaks
from geraf2.imaging.subapertures import SubapertureConfig
from geraf2.records import Pose, Waveform
from geraf2.scene import Capture, LosPrior

_PEAKS = SubapertureConfig(step_m=0.03, direction_oversampling=2.0)
_MARGIN_DB = 18.0
# Distance of the spline's knots: four for the 2 cm of a vibration of 25 Hz at 0.5 m/s [m].
_KNOT_M = 0.005
_SIGMA_M = 3e-4
# Strongest echoes that are used in each piece of travel, and its length [m].
_N_STRONG, _PIECE_M = 8, 0.03
_MIN_ECHOES = 20


def remove_vibration(
    poses: dict[str, Pose],
    n_channels: Sequence[int],
    waveform: Waveform,
    region: LosPrior,
    num_threads: int | None = None,
) -> dict[str, Pose]:
    """Planes of whole arrays without the vibration that raises the coherence of held-out echoes.

    n_channels: of each array.
    """
    capture = Capture(waveform=waveform, poses=tuple(poses.values()))
    peaks = collect_peaks(capture, region, _PEAKS, _MARGIN_DB, num_threads=num_threads)
    found = {}
    for number, ((name, pose), n_at_once) in enumerate(zip(poses.items(), n_channels, strict=True)):
        one, own = replace(capture, poses=(pose,)), peaks.of_plane(number)
        own = replace(own, subaperture_planes=np.zeros_like(own.subaperture_planes))
        strong = own.select(_strongest_peaks(own, pose))
        echoes = list(collect_phases(one, strong, size_m=DRIFT_SIZE_M, n_echoes=len(strong)))
        n = max(4, round(float(np.ptp(pose.phase_centers[:, 0])) / _KNOT_M))
        config = AutofocusConfig(n_coefficients=n, sigma_m=_SIGMA_M, n_at_once=n_at_once)
        drift = focus_antennas(one, echoes, config)
        if len(echoes) >= _MIN_ECHOES and drift.gain.is_sure:
            one = with_displacements(one, drift.coefficients_m, n_at_once)
        found[name] = one.poses[0]
    return found


def _strongest_peaks(peaks: PeakSet, pose: Pose) -> Ints:
    """Return the indices of the strongest peaks of each piece of travel, (n,)."""
    piece = np.floor(peaks.centers @ pose.axes[1] / _PIECE_M)
    order = np.lexsort((-peaks.magnitudes, piece))
    _, first = np.unique(piece[order], return_index=True)
    rank = np.arange(len(order)) - np.repeat(first, np.diff([*first, len(order)]))
    return np.sort(order[rank < _N_STRONG])
