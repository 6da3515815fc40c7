"""Check that the line-of-sight prior lies in view of the radar; by geometry, without echoes."""

import numpy as np

from geraf2._types import Floats
from geraf2.errors import UserError
from geraf2.scene.checks import format_mm
from geraf2.scene.los import LosPrior
from geraf2.scene.summary import CaptureSummary

_SHARE_OF_POSES = 0.5


def require_prior_in_view(prior: LosPrior, summary: CaptureSummary, where: object) -> None:
    """Raise UserError unless the box has a likely size and most poses face it.

    summary: of the capture, see :func:`geraf2.scene.summary.summarize_capture`.
    where: named in the error: the mesh file, or --box.
    """
    _require_likely_unit(prior, summary, where)
    poses, center = summary.usable_poses, prior.bounds.mean(axis=0)
    radius = 0.5 * float(np.linalg.norm(prior.size_m))
    inside = [pose.name for pose in poses if _is_inside(pose.corners_m, prior.bounds)]
    if inside:
        raise UserError(
            what=f"the box contains the antennas of {len(inside)} planes (e.g. {inside[0]})",
            where=where,
            got=f"a box from {format_mm(prior.bounds[0])} to {format_mm(prior.bounds[1])} mm",
            hint="check its unit (metres) and frame",
        )
    n_seeing, farthest = 0, summary.waveform.unambiguous_range_m
    for pose in poses:
        line = center - pose.center
        along = float(line @ pose.axes[0])
        off_axis = float(np.linalg.norm(line - along * pose.axes[0]))
        reach = radius + 0.5 * float(pose.extent_m.max())
        n_seeing += along > 0 and off_axis < reach and along - radius < farthest
    if n_seeing < _SHARE_OF_POSES * len(poses):
        focus = summary.focus
        looked_at = "" if focus is None else f"; the planes look at {format_mm(focus)} mm"
        raise UserError(
            what="the box does not lie where the antennas look, probably in another frame",
            where=where,
            expected="a box in the capture's frame",
            got=f"a box around {format_mm(center)} mm, seen by {n_seeing} of {len(poses)} "
            f"planes{looked_at}",
        )


def _require_likely_unit(prior: LosPrior, summary: CaptureSummary, where: object) -> None:
    longest, standoff = max(prior.size_m), summary.standoff_m
    # Antennas scan a box from outside, so it is smaller than twice their distance.
    largest = 4.0 * max(standoff, float(np.nan_to_num(max(summary.aperture_m))))
    if longest > largest:
        format_mm, in_cm = (abs(np.log(longest / per_metre / standoff)) for per_metre in (1e3, 1e2))
        unit = "centimetres" if in_cm < format_mm else "millimetres"
        raise UserError(
            what=f"the box is {longest:.4g} m long, but the antennas stand {standoff:.3g} m from "
            "what they look at",
            where=where,
            hint=f"is it in {unit}? convert it to metres",
        )
    if longest < summary.waveform.center_wavelength_m:
        raise UserError(
            what=f"the box is {1e3 * longest:.3g} mm long, less than a wavelength",
            where=where,
            hint="convert it to metres",
        )


def _is_inside(points: Floats, bounds: Floats) -> bool:
    """Whether any of the points, (n, 3), lies between the bounds."""
    return bool(((points > bounds[0]) & (points < bounds[1])).all(axis=1).any())
