"""Clouds of points with normals, written and read again."""

import numpy as np
import pytest

from geraf2.errors import UserError
from geraf2.io.points import cloud_bytes, read_cloud


def test_a_cloud_comes_back_with_its_columns(tmp_path):
    rng = np.random.default_rng(0)
    positions, normals = rng.normal(size=(2, 7, 3))
    columns = {"probability": rng.random(7), "label": np.arange(7, dtype=np.uint8)}
    path = tmp_path / "peaks.ply"
    path.write_bytes(cloud_bytes(positions, normals, columns, ["label 0 clutter"]))
    found = read_cloud(path)
    assert found.positions == pytest.approx(positions, abs=1e-6)
    assert found.normals == pytest.approx(normals, abs=1e-6)
    assert found.columns["probability"] == pytest.approx(columns["probability"], abs=1e-6)
    assert (found.columns["label"] == columns["label"]).all()


@pytest.mark.parametrize(
    "change", [lambda data: data[:-5], lambda data: b"", lambda data: data.replace(b"nz", b"qq")]
)
def test_another_file_is_one_error_with_its_name(tmp_path, change):
    path = tmp_path / "peaks.ply"
    path.write_bytes(change(cloud_bytes(np.zeros((2, 3)), np.ones((2, 3)), {})))
    with pytest.raises(UserError, match=r"peaks\.ply: cannot be read as points with normals"):
        read_cloud(path)
