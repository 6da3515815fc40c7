"""Selection of planes by turntable angle, such as held-out planes."""

from dataclasses import replace
from typing import Any

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
    """Find the planes at turntable angles [degrees]; UserError if there is none."""
    if not angles_deg:
        return []
    twice = [a for a in angles_deg if sum(_angle_between(a, b) < 1e-6 for b in angles_deg) > 1]
    if twice:
        raise UserError(what=f"the plane at {twice[0]:g} degrees is named twice", where=where)
    known = [np.nan if pose.angle_deg is None else pose.angle_deg for pose in capture.poses]
    found: list[int] = []
    for angle in angles_deg:
        away = _angle_between(np.asarray(known), angle)
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


def quarter_planes(capture: Capture, where: object) -> list[int]:
    """Find the planes nearest to 0, 90, 180 and 270 degrees; UserError without any angle."""
    known = np.array([np.nan if p.angle_deg is None else p.angle_deg for p in capture.poses])
    if np.isnan(known).all():
        raise UserError(what="no plane has a turntable angle", where=where)
    return sorted(
        {int(np.nanargmin(_angle_between(known, angle))) for angle in (0.0, 90.0, 180.0, 270.0)}
    )


def _angle_between(a: Any, b: float) -> Any:
    """Smallest angle between directions [degrees]."""
    return np.abs((a - b + 180.0) % 360.0 - 180.0)
