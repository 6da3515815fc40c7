from dataclasses import replace

import numpy as np
import pytest

from geraf2.calibration.instrument_delay import delay_from_reflector
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


def test_noise_is_no_reflector():
    noise = noise_only(point_capture(4))
    with pytest.raises(UserError, match="reflector does not stand out"):
        delay_from_reflector(noise, TARGETS[0], SEARCH)
