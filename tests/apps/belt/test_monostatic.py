import numpy as np
import pytest

from geraf2.apps.belt.monostatic import (
    list_wide_baselines,
    midpoint_error_m,
    move_to_midpoints,
    stretch_matrices,
)
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.io.belt_file import BeltStation
from geraf2.records import Pose
from geraf2.simulation.belt import belt_record
from geraf2.simulation.belt_spec import BeltArraySpec, BeltSpec
from geraf2.simulation.spec import AWR1843


def cascade(**changes) -> BeltStation:
    spec = BeltArraySpec(side="left", row_m=0.004, **changes)
    return belt_record(BeltSpec(arrays=(spec,))).arrays[0]


def echo(tx, rx, point):
    """Samples of a point, from the definition of the signal."""
    path = np.linalg.norm(tx - point, axis=1) + np.linalg.norm(rx - point, axis=1)
    path += AWR1843.path_bias_m
    turns = path[:, None] * AWR1843.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    return np.exp(-2j * np.pi * turns).astype(np.complex64)


def phase_errors(array, point, shift=0.0):
    tx, rx = (np.array(x) - [shift, 0.0, 0.0] for x in (array.tx_m, array.rx_m))
    pose = Pose(signal=echo(tx, rx, point), tx_positions=tx, rx_positions=rx, axes=np.eye(3))
    moved = move_to_midpoints(pose, stretch_matrices(array, AWR1843))
    assert np.array_equal(moved.tx_positions, moved.rx_positions)
    middle = echo(moved.tx_positions, moved.rx_positions, point)
    # The window keeps what a sharp end of the chirp spreads out of the sum.
    window = np.hanning(AWR1843.n_samples + 2)[1:-1]
    before = (window * pose.signal * middle.conj()).sum(axis=1)
    after = (window * moved.signal * middle.conj()).sum(axis=1)
    return np.angle(before), np.angle(after), np.abs(after) / window.sum()


# Stretching by h^2 / 2 r^2 moves the band: of 3.6 GHz 1.2 are lost at h = 4.1 cm, r = 0.23 m.
@pytest.mark.parametrize(("depth", "least"), [(-0.12, 0.95), (0.0, 0.9), (0.12, 0.55)])
def test_a_point_on_the_middle_line_is_seen_as_from_the_midpoints(depth, least):
    before, after, size = phase_errors(cascade(), np.array([0.0, depth, 0.0]))
    assert np.abs(before).max() > 1.0
    # u' - u of a point off the reference is at most 0.04 here: 0.05 mm, 0.16 rad at 3.9 mm.
    assert np.abs(after).max() < 0.16
    assert size.min() > least


def test_images_take_account_of_one_baseline_of_all_channels():
    tx, rx = (tuple((0.005 * k + end, 0.0) for k in range(-9, 10)) for end in (0.1, -0.1))
    array = cascade(tx_m=tx, rx_m=rx)
    assert stretch_matrices(array, AWR1843) is None
    record = belt_record(BeltSpec(arrays=(BeltArraySpec(side="left", tx_m=tx, rx_m=rx),)))
    assert list(list_wide_baselines(record, AWR1843)) == []
    mixed = BeltArraySpec(side="left", tx_m=tx, rx_m=tuple((2.0 * a, b) for a, b in rx))
    (line,) = list_wide_baselines(belt_record(BeltSpec(arrays=(mixed,))), AWR1843)
    assert "baselines of up to 345 mm that differ" in line


def test_the_error_of_midpoints_grows_with_the_square_of_their_distance():
    def error_m(half):
        rows = 0.005 * np.arange(-30, 31)
        tx, rx = (tuple((row + end, 0.0) for row in rows) for end in (half, -half))
        return midpoint_error_m(cascade(tx_m=tx, rx_m=rx))

    assert error_m(0.0) == pytest.approx(0.0, abs=1e-12)
    assert error_m(0.04) == pytest.approx(4.0 * error_m(0.02), rel=0.05)
    assert error_m(0.02) == pytest.approx(5.5e-5, rel=0.1)
