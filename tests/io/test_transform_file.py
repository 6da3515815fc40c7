"""Transforms from files and from calibrated scenes."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geraf2.errors import UserError
from geraf2.io.manifest import CalibrationManifest
from geraf2.io.transform_file import read_transform
from geraf2.scene import save_capture
from helpers.synthetic import point_capture

RIGID = np.eye(4)
RIGID[:3, :3] = Rotation.from_euler("xyz", [0.3, -0.2, 1.1]).as_matrix()
RIGID[:3, 3] = [0.1, -0.2, 0.3]


WRITERS = {
    "move.txt": np.savetxt,
    "move.json": lambda path, matrix: path.write_text(json.dumps(matrix.tolist())),
    "move.npy": np.save,
}


@pytest.mark.parametrize("name", WRITERS)
def test_files(tmp_path, name):
    WRITERS[name](tmp_path / name, RIGID)
    rigid, scale = read_transform(tmp_path / name)
    np.testing.assert_allclose(rigid, RIGID, atol=1e-12)
    assert scale == 1.0


def test_a_scale_is_recognised(tmp_path):
    matrix = RIGID.copy()
    matrix[:3, :3] *= 0.02
    np.savetxt(tmp_path / "move.txt", matrix)
    rigid, scale = read_transform(tmp_path / "move.txt")
    np.testing.assert_allclose(rigid, RIGID, atol=1e-12)
    assert scale == pytest.approx(0.02, rel=1e-12)


def test_npy_is_not_unpickled(tmp_path):
    np.save(tmp_path / "move.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(UserError, match="cannot be read as a NumPy array"):
        read_transform(tmp_path / "move.npy")


def scene_with(folder, moves):
    records = tuple(
        CalibrationManifest.model_validate(
            {
                "scene": "scene",
                "prior": "los.ply",
                "software": "geraf2",
                "delay_from": "kept",
                "path_bias_before_m": 0.0,
                "path_bias_m": 0.0,
                "prior_to_capture": None if move is None else move.tolist(),
            }
        )
        for move in moves
    )
    save_capture(replace(point_capture(1), calibration=records), folder)


def test_calibrations_of_a_scene_add_up(tmp_path):
    second = np.eye(4)
    second[:3, 3] = [0.0, 0.0, 0.5]
    scene_with(tmp_path / "scene", [RIGID, None, second])
    for source in (tmp_path / "scene", tmp_path / "scene" / "scene.toml"):
        rigid, scale = read_transform(source)
        np.testing.assert_allclose(rigid, second @ RIGID, atol=1e-9)
        assert scale == 1.0


def test_a_scene_without_calibration_is_one_line(tmp_path):
    scene_with(tmp_path / "scene", [])
    with pytest.raises(UserError, match="holds no calibration"):
        read_transform(tmp_path / "scene")
