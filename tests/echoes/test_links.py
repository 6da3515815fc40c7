"""Glints that hang together: surfaces do, scatterers do not."""

import numpy as np
import pytest

from geraf2.echoes.links import LinkConfig, linked_to_strong, smooth_pairs, spread
from glint_sets import glints_at
from specular import fibonacci_sphere


def ellipsoid(n=4000, radii=(0.02, 0.03, 0.05), strengths=1.0):
    """Points and normals of an ellipsoid."""
    unit = fibonacci_sphere(n)
    normals = unit / np.asarray(radii)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return glints_at(unit * radii, normals, strengths)


def scatterer(place, n=60, strength=0.08, seed=0):
    """Peaks of one point: at one place within 0.7 mm, seen from all around."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    normals = np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], axis=1)
    return glints_at(place + 4e-4 * rng.standard_normal((n, 3)), normals, strength)


def test_an_ellipsoid_hangs_together_from_one_strong_glint():
    body = ellipsoid()
    # From strong at one end to 20 dB weaker at the other: no link spans 12 dB.
    fade = 10.0 ** (-(body.positions[:, 2].max() - body.positions[:, 2]) / 0.1)
    body = glints_at(body.positions, body.normals, fade)
    assert linked_to_strong(body, 36, LinkConfig(strong_db=3.0)).all()
    assert not linked_to_strong(body, 36, LinkConfig(strong_db=3.0, reach_m=0.0003)).all()


def test_weak_points_in_the_air_are_dropped_and_the_surface_stays():
    body = ellipsoid(strengths=1.0)
    cloud = scatterer(np.array([0.06, 0.0, 0.0]))
    kept = linked_to_strong(body.join(cloud), 36)
    assert kept[: len(body)].all()
    assert not kept[len(body) :].any()


def test_with_few_planes_less_counts_as_strong():
    body, cloud = ellipsoid(), scatterer(np.array([0.06, 0.0, 0.0]))  # 22 dB down
    assert linked_to_strong(body.join(cloud), 11).all()
    assert not linked_to_strong(body.join(cloud), 12).all()


def test_a_strong_point_is_kept():
    body = ellipsoid()
    flash = glints_at([[0.08, 0.0, 0.0]], [[1.0, 0.0, 0.0]], 0.9)
    assert linked_to_strong(body.join(flash), 36).all()


def test_chords_of_a_sphere_of_any_radius_fit_and_steps_do_not():
    for radius in (0.005, 0.05, 0.5):
        directions = np.array([[1.0, 0.0, 0.0], [np.cos(0.01), np.sin(0.01), 0.0]])
        pair = glints_at(radius * directions, directions, 1.0)
        assert len(smooth_pairs(pair, reach_m=0.008, chord_m=1e-9)[0]) == 1
    step = glints_at([[0.0, 0.0, 0.0], [0.002, 0.001, 0.0]], [[1.0, 0.0, 0.0]] * 2, 1.0)
    assert len(smooth_pairs(step, reach_m=0.008, chord_m=1.9e-3)[0]) == 0
    assert len(smooth_pairs(step, reach_m=0.008, chord_m=2.1e-3)[0]) == 1


def test_the_sides_of_a_thin_plate_are_not_linked():
    pair = glints_at([[0.002, 0, 0], [-0.002, 0, 0]], [[1.0, 0, 0], [-1.0, 0, 0]], [1.0, 0.01])
    assert linked_to_strong(pair, 36).tolist() == [True, False]


def test_spreading_goes_one_step_a_round():
    pairs = (np.array([0, 1, 2]), np.array([1, 2, 3]))
    known = np.array([False, False, False, True])
    for n_rounds in range(5):
        expected = np.arange(4) >= 3 - n_rounds
        np.testing.assert_array_equal(spread(known, pairs, n_rounds), expected)


def test_no_glints_no_links():
    nothing = ellipsoid(10).select(np.zeros(10, dtype=bool))
    assert len(linked_to_strong(nothing, 36)) == 0


@pytest.mark.parametrize("name", ["strong_db", "reach_m", "chord_m", "angle_rad"])
def test_a_limit_that_is_not_positive_is_refused(name):
    with pytest.raises(ValueError, match=name):
        LinkConfig(**{name: -1.0})
