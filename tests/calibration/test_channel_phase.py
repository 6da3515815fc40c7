from dataclasses import replace

import numpy as np
import pytest

from geraf2.calibration.channel_phase import (
    estimate_channel_phases,
    interleaved_channels,
    offset_channels,
)
from geraf2.echoes.echo_phases import collect_phases
from geraf2.errors import UserError
from geraf2.imaging.peaks import KeptPeaks
from helpers.carton import PRIOR, carton_capture

N_CHANNELS = 5


@pytest.fixture(scope="module")
def capture():
    return carton_capture(n_poses=4)


@pytest.fixture(scope="module")
def channels(capture):
    return [interleaved_channels(pose, N_CHANNELS) for pose in capture.poses]


def found(capture, channels):
    return estimate_channel_phases(collect_phases(capture, KeptPeaks(PRIOR).of(capture)), channels)


def test_channels_are_distinguished_by_their_offsets(capture):
    assert offset_channels(capture.poses) is None
    spread = []
    for pose in capture.poses:
        offset = 0.0019 * interleaved_channels(pose, 4)[:, None] * pose.axes[1]
        spread.append(replace(pose, rx_positions=pose.rx_positions + offset))
    index = offset_channels(tuple(spread))
    assert index is not None
    for pose, own in zip(spread, index, strict=True):
        assert len(np.unique(own)) == 4
        assert np.array_equal(own[::4], np.full(len(own[::4]), own[0]))
        assert len(own) == pose.n_antennas


def test_a_channel_that_is_never_seen_is_named(capture):
    lonely = [np.zeros(pose.n_antennas, dtype=np.int64) for pose in capture.poses]
    lonely[0][0] = 1
    with pytest.raises(UserError, match="channel 1 has too few antennas"):
        found(capture, lonely)
