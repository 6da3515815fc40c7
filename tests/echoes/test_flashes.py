"""Flashes of walls among peaks of content, and the delay that unknown walls show."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.echoes.flashes import (
    ANGLE_SIGMA_RAD,
    OFFSET_SIGMA_M,
    WallMiddles,
    find_flashes,
    learn_wall_delay,
)
from geraf2.echoes.wall_faces import WallFaces
from geraf2.imaging.peaks import PeakSet
from geraf2.scene import LosPrior
from helpers.synthetic import waveform_of

FACES = WallFaces.of(LosPrior.from_box((0.2, 0.2, 0.2)))
WAVEFORM = waveform_of()


def peaks_along(ranges_m, angles_rad=0.0):
    """Peaks 40 cm before the middle of a box, along x or at an angle to it."""
    n = len(ranges_m)
    rng = np.random.default_rng(1)
    sideways, angle = rng.uniform(-0.05, 0.05, (n, 2)), np.broadcast_to(angles_rad, n)
    return PeakSet(
        subapertures=np.arange(n),
        directions=np.stack([-np.cos(angle), np.sin(angle), np.zeros(n)], axis=1),
        ranges_m=np.asarray(ranges_m),
        magnitudes=rng.uniform(0.5, 1.0, n),
        noise=np.zeros(n),
        subaperture_centers=np.column_stack([np.full(n, 0.4), sideways]),
        subaperture_coordinates=sideways,
        subaperture_planes=np.zeros(n, dtype=np.int64),
        tops=np.ones(n),
        periods=np.full((n, 2), np.inf),
    )


def echoes_of(thickness_m, permittivity, bias_m, *, n=40, walls=("near", "far")):
    """Echoes as a slab's two faces give them, with 0.1 mm of scatter, and some of the content."""
    rng = np.random.default_rng(0)
    optical = np.sqrt(permittivity) * thickness_m
    ranges = {
        "near": 0.3 + 0.5 * optical + bias_m,
        "far": 0.5 + 1.5 * optical - 2.0 * thickness_m + bias_m,
    }
    parts = [ranges[name] + 1e-4 * rng.standard_normal(n) for name in walls]
    return peaks_along(np.concatenate([*parts, rng.uniform(0.35, 0.45, n)]))


def learned(peaks):
    return learn_wall_delay(peaks, FACES, WAVEFORM)


def test_a_flash_is_an_echo_within_three_sigmas_of_a_wall():
    """Offsets and angles in standard deviations; the twin is the ellipse."""
    middles = WallMiddles(depths_m=(0.0, 0.0), sigmas_m=(0.0, 0.0, 0.0))
    off, angle = (part.ravel() for part in np.meshgrid(np.arange(-4, 5), np.arange(0, 5)))
    turn = ANGLE_SIGMA_RAD * angle
    for middle_m, far in ((0.3, 0), (0.5, 1)):
        peaks = peaks_along(middle_m / np.cos(turn) + OFFSET_SIGMA_M * off, turn)
        found = find_flashes(peaks, FACES, middles)
        assert set(found.index) == set(np.flatnonzero(off**2 + angle**2 < 9))
        assert set(found.far) == {far}


@pytest.mark.parametrize("permittivity", [1.4, 1.6, 1.8])
@pytest.mark.parametrize("bias_m", [-0.001, 0.0, 0.0015])
def test_both_walls_give_the_delay_and_the_constant_error(permittivity, bias_m):
    expected = (np.sqrt(permittivity) - 1.0) * 0.004 + bias_m
    assert learned(echoes_of(0.004, permittivity, bias_m)) == pytest.approx(expected, abs=4e-4)


def test_the_near_wall_alone_counts_half():
    found = learned(echoes_of(0.004, 16 / 9, 0.0, walls=("near",)))
    assert found == pytest.approx((4 / 3 - 1.0) * 0.004, abs=4e-4)


def test_without_flashes_there_is_no_delay():
    assert learned(echoes_of(0.004, 1.6, 0.0, walls=())) == 0.0
    assert learned(echoes_of(0.004, 1.6, 0.0, walls=("far",))) == 0.0
    assert learned(echoes_of(0.004, 1.6, 0.0, n=11, walls=("near",))) == 0.0
    assert learned(echoes_of(0.004, 1.6, 0.0, n=0)) == 0.0
    both = echoes_of(0.004, 1.6, 0.0)
    aside = both.subaperture_centers + np.array([0.0, 1.0, 0.0])
    assert learned(replace(both, subaperture_centers=aside)) == 0.0


@pytest.mark.parametrize("shift_m", [-0.009, -0.006, 0.0])
def test_the_shift_of_faces_that_cancel_is_no_delay(shift_m):
    """Near and far echoes both lie before their middles; no board delays by less than nothing."""
    found = learned(echoes_of(0.004, 1.6, shift_m))
    assert found == pytest.approx((np.sqrt(1.6) - 1.0) * 0.004, abs=1.5e-3)
