"""Region of content without a box, from the positions of its echoes."""

import numpy as np

from geraf2.calibration.box_search import leaking, scene_peaks
from geraf2.errors import UserError
from geraf2.geometry.transforms import triple
from geraf2.scene import Capture, LosPrior
from geraf2.scene.summary import CaptureSummary, summarize_capture

# Share of the amplitude beyond each side of the region: multipath, clutter, grating lobes.
_OUTSIDE = 0.02
SLACK_M = 0.04
"""Margin for parts without an echo [m], a property of the simulated population of objects; also of
a face that nothing bounds beyond a cube with the largest known side."""
# Limit of the region over the planes' distance, so that it ends before the antennas.
_MAX_REACH = 0.75


def content_region(
    capture: Capture, *, summary: CaptureSummary | None = None, num_threads: int | None = None
) -> LosPrior:
    """Return a cuboid around nearly all echoes, along the frame's axes, without walls.

    capture: scan of content in free air. summary: of it, if already computed.
    num_threads: all cores when None.

    Raises UserError if there is no echo, or if the planes face no common point.

    >>> capture, truth = geraf2.examples.small_capture()
    >>> region = content_region(capture)
    >>> [side > 0.1 for side in region.size_m]
    [True, True, True]
    """
    summary = summary or summarize_capture(capture)
    focus, reach = summary.focus, summary.standoff_m
    if focus is None or not np.isfinite(reach):
        raise _without_echoes(got="planes that face no common point")
    found = scene_peaks(focus, reach, num_threads).of(capture)
    found = found.select(~leaking(capture, found, reach))
    if not len(found):
        raise _without_echoes(got="no echo above the noise")
    sides = np.zeros((2, 3))
    for k in range(3):
        order = np.argsort(found.points[:, k])
        inner = np.cumsum(found.strengths[order]) / found.strengths.sum()
        low, high = np.searchsorted(inner, [_OUTSIDE, 1.0 - _OUTSIDE])
        along = found.points[order, k] - focus[k]
        sides[:, k] = along[low] - SLACK_M, along[min(high, len(along) - 1)] + SLACK_M
    sides = np.clip(sides, -_MAX_REACH * reach, _MAX_REACH * reach)
    if not (sides[1] > sides[0]).all():
        raise _without_echoes(got="echoes beside the point that the planes face")
    return LosPrior.from_box(triple(sides[1] - sides[0]), triple(focus + 0.5 * sides.sum(axis=0)))


def _without_echoes(got: str) -> UserError:
    return UserError(
        what="the content's region is not found in the scan",
        expected="echoes between planes that face each other",
        got=got,
        hint="give it with --box X Y Z",
    )
