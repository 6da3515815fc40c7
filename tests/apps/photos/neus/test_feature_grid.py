import numpy as np
import pytest
import torch
from scipy.interpolate import RegularGridInterpolator

from geraf2.apps.photos.neus.feature_grid import FeatureGrid
from geraf2.scene import Grid

GRID = Grid(origin_m=(-0.1, 0.2, 0.0), spacing_m=0.05, shape=(5, 4, 6))


def random_grid(active, n_features=3, seed=0):
    features = FeatureGrid(GRID, active, n_features)
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        features.table.copy_(torch.randn(features.table.shape, generator=generator))
    return features


def random_points(n, reach=1.0, seed=0):
    low = np.asarray(GRID.origin_m)
    size = GRID.spacing_m * (np.asarray(GRID.shape) - 1)
    unit = np.random.default_rng(seed).random((n, 3))
    return low + size * (0.5 + reach * (unit - 0.5))


def dense(features):
    table, rows = features.table.detach().numpy(), features.rows.numpy()
    return table[rows].reshape(*GRID.shape, -1)


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_features_are_trilinear_and_inactive_nodes_share_row_zero(share):
    active = np.random.default_rng(1).random(GRID.shape) < share
    features = random_grid(active)
    assert features.table.shape[0] == 1 + active.sum()
    points = random_points(50)
    expected = RegularGridInterpolator(GRID.axes_m, dense(features))(points)
    found = features(torch.from_numpy(points).float()).detach().numpy()
    np.testing.assert_allclose(found, expected, atol=1e-5)
