import numpy as np
import pytest

from geraf2.errors import UserError
from geraf2.fields import SdfGrid


def test_pickled_objects_are_not_loaded(tmp_path):
    values = np.array([{"a": 1}], dtype=object)
    np.savez(tmp_path / "sdf.npz", values=values, origin_m=np.zeros(3), spacing_m=0.1)
    with pytest.raises(UserError, match="allow_pickle"):
        SdfGrid.load(tmp_path / "sdf.npz")
