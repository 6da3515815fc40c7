"""Deviation of peaks from the planes they share with neighbours, and what is subtracted for it."""

import numpy as np
import pytest

from geraf2.echoes.noise import ECHO_NOISE, tangent_deviation
from helpers.specular import fibonacci_sphere


def test_points_of_a_smooth_surface_do_not_deviate():
    directions = fibonacci_sphere(3000)
    deviation = tangent_deviation(0.04 * directions, directions)
    assert deviation.max() < 1e-9  # exact on a sphere


def test_a_point_between_two_surfaces_deviates_by_its_height():
    """A merged echo 2 mm outside of a plane that its neighbours lie on."""
    grid = np.stack(np.meshgrid(*[np.linspace(-0.008, 0.008, 9)] * 2), axis=-1).reshape(-1, 2)
    positions = np.column_stack([grid, np.zeros(len(grid))])
    positions = np.vstack([positions, [0.001, 0.001, 0.002]])
    normals = np.tile([0.0, 0.0, 1.0], (len(positions), 1))
    deviation = tangent_deviation(positions, normals)
    assert deviation[-1] == pytest.approx(0.002)
    assert deviation[:-1].max() < 1e-12


def test_a_point_without_neighbours_has_the_usual_deviation():
    far = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]])
    deviation = tangent_deviation(far, np.array([[0.0, 0.0, 1.0]] * 2))
    assert deviation[0] == deviation[1] > 0.0


def test_merged_and_weak_echoes_err_more():
    deviation, strength = np.array([0.0, 0.002, 0.0]), np.array([1.0, 1.0, 0.1])
    position_m, normal_rad = ECHO_NOISE.of_glints(deviation, strength)
    assert position_m[1] > position_m[0] == position_m[2] > 0.0
    assert normal_rad.argmin() == 0 < normal_rad[0]
    near, far = np.array([0.0]), np.array([0.02])
    assert ECHO_NOISE.offset_variance(far) > ECHO_NOISE.offset_variance(near)
