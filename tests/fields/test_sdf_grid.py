import numpy as np
import pytest

from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.scene import Grid


@pytest.fixture
def linear_field():
    grid = Grid(origin_m=(0.1, -0.2, 0.3), spacing_m=0.01, shape=(4, 5, 6))
    values = (grid.points() @ [1.0, -2.0, 0.5]).reshape(grid.shape).astype(np.float32)
    return SdfGrid(grid=grid, values=values)


def test_sampling_a_linear_field_is_exact_between_the_voxels(linear_field):
    rng = np.random.default_rng(0)
    points = rng.uniform((0.1, -0.2, 0.3), (0.13, -0.16, 0.35), (50, 3))
    # float32 samples of up to 0.7: an ulp is 6e-8
    np.testing.assert_allclose(linear_field.sample(points), points @ [1.0, -2.0, 0.5], atol=2e-7)


def test_pickled_objects_are_not_loaded(tmp_path):
    values = np.array([{"a": 1}], dtype=object)
    np.savez(tmp_path / "sdf.npz", values=values, origin_m=np.zeros(3), spacing_m=0.1)
    with pytest.raises(UserError, match="allow_pickle"):
        SdfGrid.load(tmp_path / "sdf.npz")
