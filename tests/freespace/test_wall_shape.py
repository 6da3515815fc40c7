"""The path to a bulged wall and back, against the least of all paths, searched."""

import numpy as np

from geraf2.freespace.wall_shape import path_shape

WAVELENGTH_M = 0.0038
WALL_M = 0.506
HALF_M = 0.106


def bulge(positions, height_m):
    return height_m * np.cos(0.5 * np.pi * positions / HALF_M)


def searched(feet, height_m):
    """Two-way path over that to a flat wall, where the ray arrives, and the gain, along one axis.

    Gain: the flash of a mirror is 1 / sqrt(1 - D w''), with w'' the wall's curvature.
    """
    x = np.linspace(-HALF_M, HALF_M, 6001)
    path = (x - feet[:, None]) ** 2 / WALL_M - 2.0 * bulge(x, height_m)
    at = path.argmin(axis=1)
    curvature = -((0.5 * np.pi / HALF_M) ** 2) * bulge(x[at], height_m)
    return path.min(axis=1), x[at], 1.0 / np.sqrt(1.0 - WALL_M * curvature)


def made(height_m, seed=0):
    rng = np.random.default_rng(seed)
    u, v = np.meshgrid(np.arange(-0.06, 0.061, 0.004), np.arange(-0.08, 0.081, 0.004))
    feet = np.stack([u.ravel(), v.ravel()], axis=1)
    one, other = (searched(feet[:, k], height_m) for k in range(2))
    path, gain = one[0] + other[0], one[2] * other[2]
    noise = 0.02 * (rng.normal(size=path.shape) + 1j * rng.normal(size=path.shape))
    response = gain * np.exp(-2j * np.pi / WAVELENGTH_M * path + 0.4j) + noise
    return feet, response, path, np.stack([one[1], other[1]], axis=1), gain


def test_path_direction_and_gain_are_those_of_the_curved_mirror():
    for height_m in (-0.0015, 0.001):
        feet, response, path, hit, gain = made(height_m)
        shape = path_shape(feet, response, WAVELENGTH_M)
        inner = (np.abs(feet) < [0.05, 0.07]).all(axis=1)
        left = (shape.length_m - path)[inner]
        assert np.ptp(left) < 1e-4
        arrives = feet - 0.5 * WALL_M * shape.slope
        np.testing.assert_allclose(arrives[inner], hit[inner], atol=1.2e-3)
        np.testing.assert_allclose(
            shape.gain(np.full(len(feet), WALL_M))[inner], gain[inner], rtol=0.1
        )


def test_a_flat_wall_is_flat_and_a_shadow_does_not_bend_it():
    feet, response, *_ = made(0.0)
    assert path_shape(feet, response, WAVELENGTH_M).rms_m < 1e-5
    feet, response, path, *_ = made(0.001)
    noise = response - np.exp(1j * np.angle(response))
    shadowed = np.where(np.abs(feet[:, 0]) < 0.025, noise, response)
    shape = path_shape(feet, shadowed, WAVELENGTH_M)
    lit = (np.abs(feet[:, 0]) > 0.025) & (np.abs(feet) < [0.05, 0.07]).all(axis=1)
    assert np.ptp((shape.length_m - path)[lit]) < 2e-4


def test_too_few_antennas_give_none():
    feet, response, *_ = made(0.0)
    assert path_shape(feet[:9], response[:9], WAVELENGTH_M) is None
