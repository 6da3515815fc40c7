"""Positions of the antennas of a run: a rectangle for each of its planes, in `planes.json`."""

import json
from pathlib import Path

import numpy as np

from geraf2._types import Floats
from geraf2.errors import UserError
from geraf2.io.atomic import write_json_atomic


def save_planes(corners_m: Floats, path: Path) -> None:
    """Write the corners of each plane in turn, (n_planes, 4, 3) [m]."""
    rounded = np.round(corners_m, 6).tolist()
    write_json_atomic(path, {"format": "geraf2-planes", "version": 1, "corners_m": rounded})


def load_planes(path: Path) -> Floats:
    """Corners of each plane in turn, (n_planes, 4, 3) [m]; none where there is no such file."""
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))["corners_m"]
        corners = np.asarray(stored, dtype=np.float64).reshape(len(stored), 4, 3)
        good = bool((np.abs(corners) < np.inf).all())
    except FileNotFoundError:
        return np.zeros((0, 4, 3))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        good = False
    if not good:
        raise UserError(
            what="cannot be read as the planes of a run",
            where=path,
            hint="remove the file, or run 'geraf2 reconstruct' again",
        )
    return corners
