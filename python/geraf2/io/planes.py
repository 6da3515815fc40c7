"""Rectangles that the antennas of a run covered, one for each of its planes, in `planes.json`."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geraf2._types import Floats
from geraf2.errors import UserError
from geraf2.io.atomic import write_json_atomic
from geraf2.io.regular import RECORD_BYTES, read_regular
from geraf2.io.text import parse_json


@dataclass(frozen=True, kw_only=True, eq=False)
class ScannedPlanes:
    """Rectangles of a run's antennas, and the wavelength that they were scanned at."""

    corners_m: Floats
    """Corners of each plane in turn, (n_planes, 4, 3) [m]."""
    wavelength_m: float | None = None
    """At mid-band [m]; None where it is not recorded."""


def save_planes(planes: ScannedPlanes, path: Path) -> None:
    """Write them; corners are rounded to a micrometre."""
    corners = np.round(planes.corners_m, 6).tolist()
    values = {"corners_m": corners, "wavelength_m": planes.wavelength_m}
    write_json_atomic(path, {"format": "geraf2-planes", "version": 1, **values})


def load_planes(path: Path) -> ScannedPlanes:
    """Planes of a run; none where there is no such file. UserError where it cannot be read."""
    try:
        stored = parse_json(read_regular(path, RECORD_BYTES))
        corners = np.asarray(stored["corners_m"], dtype=np.float64)
        corners = corners.reshape(len(stored["corners_m"]), 4, 3)
        wavelength = stored.get("wavelength_m")
        wavelength_m = None if wavelength is None else float(wavelength)
        good = bool((np.abs(corners) < np.inf).all())
        good &= wavelength_m is None or 0.0 < wavelength_m < np.inf
    except FileNotFoundError:
        return ScannedPlanes(corners_m=np.zeros((0, 4, 3)))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        good = False
    if not good:
        raise UserError(
            what="cannot be read as the planes of a run",
            where=path,
            hint="remove the file, or run 'geraf2 reconstruct' again",
        )
    return ScannedPlanes(corners_m=corners, wavelength_m=wavelength_m)
