"""Rigid and similarity transforms from files."""

from pathlib import Path
from typing import Any

import numpy as np

from geraf2._types import Floats
from geraf2.errors import UserError
from geraf2.geometry.transforms import require_rigid
from geraf2.io.arrays import read_npy
from geraf2.io.container import MANIFEST_NAME, read_scene_manifest
from geraf2.io.text import parse_json, read_text

# Below this, a scale is rounding; above, it was meant.
_SCALE_TOLERANCE = 1e-3


def read_transform(path: Path) -> tuple[Floats, float]:
    """Read a 4 x 4 similarity transform, columns times (x, y, z, 1).

    path: text with 16 numbers, a JSON list of rows, a .npy file, or a calibrated scene (its folder
        or scene.toml), whose calibrations hold the prior's frame in the capture's.

    Returns rigid transform (4, 4), translation in metres, and the scale that goes before it.
    """
    path = Path(path)
    if path.is_dir() or path.name == MANIFEST_NAME:
        return _from_scene(path if path.is_dir() else path.parent), 1.0
    matrix = _read_matrix(path)
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    if not np.isfinite(scale) or scale <= 0.0:
        raise UserError(
            what="must be a transform without a mirror image",
            where=path,
            expected="a determinant above 0",
            got=f"{np.linalg.det(matrix[:3, :3]):.4g}",
        )
    if abs(scale - 1.0) < _SCALE_TOLERANCE:
        scale = 1.0
    rigid = matrix.copy()
    rigid[:3, :3] /= scale
    return require_rigid(rigid, path), scale


def _from_scene(folder: Path) -> Floats:
    manifest = read_scene_manifest(folder)
    moves = [c.prior_to_capture for c in manifest.calibration if c.prior_to_capture is not None]
    if not moves:
        raise UserError(
            what="the scene holds no calibration of the prior's frame",
            where=folder / MANIFEST_NAME,
            hint="make one with 'geraf2 calibrate', or give a file with a 4 x 4 matrix",
        )
    transform = np.eye(4)
    for move in moves:
        transform = require_rigid(np.array(move), folder / MANIFEST_NAME) @ transform
    return transform


def _read_matrix(path: Path) -> Floats:
    try:
        if path.suffix == ".npy":
            values: Any = read_npy(path)
        elif path.suffix == ".json":
            values = parse_json(read_text(path))
        else:
            values = [float(part) for part in read_text(path).replace(",", " ").split()]
        matrix = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, RecursionError) as error:
        raise UserError(what=f"cannot be read as a matrix: {error}", where=path) from error
    if matrix.size != 16 or not np.isfinite(matrix).all():
        what = "must hold a 4 x 4 matrix"
        raise UserError(what, where=path, expected="16 finite numbers", got=matrix.size)
    return matrix.reshape(4, 4)
