import numpy as np
import pytest

from geraf2.calibration.autofocus import (
    focus_antennas,
    trajectory_basis,
    with_displacements,
)
from geraf2.echoes.echo_phases import collect_phases
from geraf2.imaging.peaks import KeptPeaks
from helpers.carton import PRIOR, carton_capture


def drift_m(n, number):
    """Slow, 0.4 mm rms, along the looking direction."""
    position = np.arange(n) / n
    return 0.00056 * np.sin(2.0 * np.pi * (1.7 * position + 0.3 * number))


def estimate(capture):
    return focus_antennas(capture, collect_phases(capture, KeptPeaks(PRIOR).of(capture)))


def unexplained(errors, pose):
    """Residual without shift, tilt and bend of the whole plane: these a surface
    elsewhere would explain as well."""
    h, v = ((pose.phase_centers - pose.phase_centers.mean(axis=0)) @ pose.axes[1:].T).T / 0.1
    modes = np.stack([np.ones_like(h), h, v, h * h, h * v, v * v], axis=1)
    return errors - modes @ np.linalg.lstsq(modes, errors, rcond=None)[0]


def test_a_slow_drift_is_found_but_for_what_surfaces_explain():
    capture = carton_capture(
        n_poses=4, errors=lambda number, axes, n: drift_m(n, number)[:, None] * axes[0]
    )
    found = estimate(capture)
    assert found.gain.is_sure
    assert found.coherence_after > found.coherence_before
    before, after = [], []
    for number, pose in enumerate(capture.poses):
        true = drift_m(pose.n_antennas, number)
        before.append(unexplained(true, pose))
        after.append(unexplained(true - found.displacements(number, pose.n_antennas), pose))
    assert np.std(after) < 0.6 * np.std(before)
    moved = with_displacements(capture, found.coefficients_m).poses[1]
    shift = moved.tx_positions - capture.poses[1].tx_positions
    assert shift @ moved.axes[0] == pytest.approx(found.displacements(1, moved.n_antennas))
    assert shift @ moved.axes[1] == pytest.approx(0.0, abs=1e-12)


def test_correct_positions_do_not_change():
    assert not estimate(carton_capture(n_poses=4)).gain.is_sure


def test_the_splines_sum_to_one():
    assert trajectory_basis(50, 7).sum(axis=1) == pytest.approx(1.0)
