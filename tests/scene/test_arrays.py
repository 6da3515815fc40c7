import numpy as np
import pytest

from geraf2.errors import UserError
from geraf2.scene.arrays import ARRAYS, column, find_array


def phase_centers(array):
    tx, rx = (np.array(positions) for positions in (array.tx_offsets_m, array.rx_offsets_m))
    return 0.5 * (tx[:, None] + rx).reshape(-1, 3)


def test_the_cascade_has_86_positions_in_azimuth_and_four_heights():
    array = ARRAYS["awr2243-cascade"]
    half = 0.5 * 299792458.0 / array.design_hz
    centers = phase_centers(array.sweep())
    assert len(centers) == 192
    steps = np.round(centers[:, 1] / (0.5 * half) - (centers[:, 1] / (0.5 * half)).min())
    assert sorted(set(steps)) == [0, 1, 4, 6]
    in_line = np.unique(np.round(centers[steps == 0][:, 2] / (0.5 * half)))
    assert len(in_line) == 86  # TI: 86 virtual antennas in azimuth
    assert np.ptp(in_line) == 85
    assert centers.mean(axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


def test_a_column_has_its_phase_centres_a_pitch_apart():
    centers = phase_centers(column(8, 0.004))
    assert np.diff(centers[:, 2]) == pytest.approx(0.004)
    assert centers.mean(axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


def test_an_unknown_board_is_named():
    with pytest.raises(UserError, match="did you mean 'iwr1843'"):
        find_array("iwr1844")
