"""Held-out planes: left out of a reconstruction, and found again to score it."""

from dataclasses import replace

import numpy as np

from geraf2.errors import UserError
from geraf2.scene import Capture

_TOLERANCE_DEG = 0.5


def keep_planes(capture: Capture, hold_out: tuple[float, ...], where: object) -> Capture:
    """Capture without the planes at these turntable angles [degrees]."""
    if not hold_out:
        return capture
    left_out = set(planes_at(capture, hold_out, where))
    kept = tuple(pose for number, pose in enumerate(capture.poses) if number not in left_out)
    if not kept:
        raise UserError(what="--hold-out leaves no plane", where=where)
    return replace(capture, poses=kept)


def planes_at(capture: Capture, angles_deg: tuple[float, ...], where: object) -> list[int]:
    """Find the planes at turntable angles [degrees]; UserError where there is none."""
    if not angles_deg:
        return []
    known = [np.nan if pose.angle_deg is None else pose.angle_deg for pose in capture.poses]
    found: list[int] = []
    for angle in angles_deg:
        away = np.abs((np.asarray(known) - angle + 180.0) % 360.0 - 180.0)
        matches = np.flatnonzero(away <= _TOLERANCE_DEG)
        if matches.size == 0:
            listed = ", ".join("unknown" if np.isnan(a) else f"{a:g}" for a in known[:8])
            raise UserError(
                what=f"no plane at {angle:g} degrees",
                where=where,
                expected=f"one of {listed}{', ...' if len(known) > 8 else ''}",
            )
        found += [int(index) for index in matches]
    return sorted(set(found))
