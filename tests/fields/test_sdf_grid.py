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


def test_saving_and_loading_keeps_everything(linear_field, tmp_path):
    linear_field.save(tmp_path / "sdf.npz")
    back = SdfGrid.load(tmp_path / "sdf.npz")
    assert back.grid == linear_field.grid
    np.testing.assert_array_equal(back.values, linear_field.values)


def test_a_missing_or_broken_file_is_a_user_error(linear_field, tmp_path):
    with pytest.raises(UserError, match=r"sdf\.npz: cannot read the arrays"):
        SdfGrid.load(tmp_path / "sdf.npz")
    np.savez(tmp_path / "other.npz", values=np.zeros((2, 2, 2)))
    with pytest.raises(UserError, match="lacks the array origin_m, spacing_m"):
        SdfGrid.load(tmp_path / "other.npz")
    linear_field.save(tmp_path / "cut.npz")
    whole = (tmp_path / "cut.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(UserError, match="cannot read the arrays"):
        SdfGrid.load(tmp_path / "cut.npz")
    np.savez(tmp_path / "flat.npz", values=np.zeros(3), origin_m=np.zeros(3), spacing_m=0.1)
    with pytest.raises(UserError, match="array values is not what geraf2 writes"):
        SdfGrid.load(tmp_path / "flat.npz")


def test_pickled_objects_are_not_loaded(tmp_path):
    values = np.array([{"a": 1}], dtype=object)
    np.savez(tmp_path / "sdf.npz", values=values, origin_m=np.zeros(3), spacing_m=0.1)
    with pytest.raises(UserError, match="allow_pickle"):
        SdfGrid.load(tmp_path / "sdf.npz")
