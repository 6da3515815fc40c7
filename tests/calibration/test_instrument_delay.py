from dataclasses import replace

import numpy as np
import pytest

from geraf2.calibration.instrument_delay import delay_from_reflector, delay_from_sharpness
from geraf2.errors import UserError
from geraf2.scene import Pose
from helpers.synthetic import TARGETS, point_capture

SEARCH = (-0.3, 0.3)


def blind(capture):
    return replace(capture, waveform=replace(capture.waveform, path_bias_m=0.03))


def noise_only(capture):
    rng = np.random.default_rng(0)

    def noisy(pose):
        parts = rng.standard_normal((2, *pose.signal.shape))
        return Pose(**{**vars(pose), "signal": (parts[0] + 1j * parts[1]).astype(np.complex64)})

    return replace(capture, poses=tuple(noisy(pose) for pose in capture.poses))


def test_a_reflector_gives_the_delay_to_half_a_millimetre():
    capture = point_capture(n_poses=4, targets=TARGETS[:1], n_side=12)
    found = delay_from_reflector(blind(capture), TARGETS[0], SEARCH)
    assert found.delay_m == pytest.approx(0.12, abs=5e-4)
    assert 0.0 < found.sigma_m < 5e-3
    assert found.quality.max() > 6.0


def test_sharpness_gives_the_delay_of_points_to_a_centimetre():
    capture = point_capture(n_poses=2, n_side=24)
    found = delay_from_sharpness(blind(capture), np.zeros(3), 0.06, (0.0, 0.25))
    assert found.delay_m == pytest.approx(0.12, abs=0.02)
    assert found.sigma_m >= 0.04


def test_noise_is_neither_a_reflector_nor_sharp():
    noise = noise_only(point_capture(4))
    with pytest.raises(UserError, match="reflector does not stand out"):
        delay_from_reflector(noise, TARGETS[0], SEARCH)
    with pytest.raises(UserError, match="no delay makes the image sharp"):
        delay_from_sharpness(noise, np.zeros(3), 0.1, (-0.05, 0.1))
