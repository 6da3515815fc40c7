"""Echoes of coarse rasters: back in the direction from which they came."""

import numpy as np
import pytest

from geraf2.echoes.ambiguity import outvoted, periods_off, votes_for_periods
from geraf2.echoes.glints import find_glints
from geraf2.scene import LosPrior
from specular import BOX_M, raster, sphere_capture

PERIOD = 3.8e-3 / (2 * 8e-3)
RADIUS_M = 0.02


def echoes_of(center, radius, turns=(0, 0)):
    """Sub-aperture middles 2 cm apart, exact ranges to a sphere, cosines less some periods."""
    steps = 0.02 * (np.arange(5) - 2)
    places = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    way = np.asarray(center) - np.column_stack([np.zeros(25), places])
    far = np.linalg.norm(way, axis=1)
    cosines = way[:, 1:] / far[:, None] - PERIOD * np.array(turns)
    return places, cosines, far - radius


@pytest.mark.parametrize("radius", [-0.1, 0.0, 0.02, 0.2])
@pytest.mark.parametrize("turns", [(0, 0), (1, 0), (0, -1), (-2, 1)])
def test_ranges_say_by_how_many_periods_a_direction_is_off(turns, radius):
    places, cosines, ranges = echoes_of((0.4, 0.05, -0.03), radius, turns)
    for axis in (0, 1):
        votes = votes_for_periods(places, cosines, ranges, np.ones(25), axis, PERIOD)
        found, votes = periods_off(votes)
        assert votes.min() > 1.9
        assert (found == turns[axis]).all()


def test_wrapped_cosines_on_both_sides_of_the_edge_are_told():
    places, cosines, ranges = echoes_of((0.4, 0.06, 0.0), RADIUS_M)
    wrapped = cosines[:, 0] - PERIOD * np.rint(cosines[:, 0] / PERIOD)
    assert (wrapped < 0).any()
    assert (wrapped > 0).any()
    seen = np.column_stack([wrapped, cosines[:, 1]])
    found, _ = periods_off(votes_for_periods(places, seen, ranges, np.ones(25), 0, PERIOD))
    assert seen[:, 0] + PERIOD * found == pytest.approx(cosines[:, 0])


def test_echoes_by_themselves_stay_where_they_are():
    places, cosines, ranges = echoes_of((0.4, 0.05, -0.03), RADIUS_M, (1, 0))
    rng = np.random.default_rng(0)
    scattered = ranges + rng.uniform(-0.2, 0.2, len(ranges))
    votes = votes_for_periods(places, cosines, scattered, np.ones(25), 0, PERIOD)
    assert not periods_off(votes)[0].any()
    weaker = 10.0 ** (-np.arange(25))  # each 20 dB below the one before: of something else
    found, votes = periods_off(votes_for_periods(places, cosines, ranges, weaker, 0, PERIOD))
    assert not found.any()
    assert not votes.any()


def test_echoes_that_those_around_put_elsewhere_are_outvoted_alone():
    votes = np.zeros((40, 5))
    votes[:, 2], votes[:, 3] = 0.3, 0.5  # more for another direction, one echo by itself too few
    votes[20:, 2] = 0.6
    votes[0] = [0.0, 0.0, 0.9, 0.0, 0.0]  # whom those around outvote
    votes[20] = [0.0, 0.0, 0.0, 1.2, 0.0]  # who outvotes nobody
    rng = np.random.default_rng(0)
    places = rng.uniform(-0.003, 0.003, (40, 3))
    places[20:] += 0.1
    assert (outvoted(places, votes)[:20] == 1).all()
    assert not outvoted(places, votes)[20:].any()
    far = 0.1 * np.arange(120).reshape(40, 3)
    assert not outvoted(far, votes).any()


@pytest.mark.parametrize("height_m", [-0.08, 0.0])
def test_a_raster_a_little_too_coarse_leaves_no_ghost(height_m):
    """At 5 mm a ball on the floor is seen in a ghost's direction, too, one in the middle not."""
    center = [0.0, 0.0, height_m]
    capture = sphere_capture([center], [RADIUS_M], n_poses=4, places=raster(41, 0.005))
    found = find_glints(capture, LosPrior.from_box((BOX_M,) * 3))
    distance = np.linalg.norm(found.positions - center, axis=1) - RADIUS_M
    assert len(found) > 40
    assert np.abs(distance).max() < 3e-3


def test_a_sphere_beyond_the_raster_s_directions_is_found_where_it_is():
    """At 8 mm cosines beyond 0.12 wrap around; the sphere lies at 0.17."""
    center = [0.0, 0.0, 0.065]
    capture = sphere_capture([center], [RADIUS_M], n_poses=4, places=raster(19, 0.008))
    told = []
    found = find_glints(capture, LosPrior.from_box((BOX_M, BOX_M, BOX_M)), tell=told.append)
    assert told[0].startswith("ghosts of sparse sampling: of ")
    offset = np.linalg.norm(found.positions - center, axis=1) - RADIUS_M
    assert len(found) >= 20
    assert np.abs(offset).max() < 2e-3
