"""Voxel domains: where their voxels lie."""

import numpy as np

from geraf2.scene import Grid


def test_a_centered_grid_has_its_voxels_evenly_about_the_centre():
    grid = Grid.centered((0.1, -0.2, 0.3), 0.01, (3, 4, 1))

    points = grid.points()
    np.testing.assert_allclose(points.mean(axis=0), (0.1, -0.2, 0.3), atol=1e-15)
    np.testing.assert_allclose(np.ptp(points, axis=0), (0.02, 0.03, 0.0), atol=1e-15)
    assert grid.shape == (3, 4, 1)
