"""Echoes of the box's walls, and the instrument delay at which they lie on the prior.

A flat wall returns a flash along its normal, in a direction that does not depend on the delay. The
range minus the distance to the prior's wall is common to all near and far walls. Echoes of the
content have no such common offset (docs/math/calibration.md#delay-and-box).
"""

from dataclasses import replace

import numpy as np

from geraf2._types import Floats
from geraf2.echoes.flashes import OFFSET_SIGMA_M
from geraf2.echoes.wall_delay import MIN_WALL_ECHOES
from geraf2.errors import UserError
from geraf2.imaging.peaks import MAX_RANGE_SHIFT_M, KeptPeaks, PeakSet, box_spans, collect_peaks
from geraf2.scene import Capture, LosPrior

# Level of a wall's echo relative to the strongest peak; content may be 20 dB stronger.
_DYNAMIC_RANGE_DB = 26.0
# Half as many sub-apertures as for glints: walls have hundreds of echoes.
_STEP_M = 0.04
# Share of the near walls' largest density that replaces hidden far walls. It is enough to find a
# delay from near walls alone, and too small to interpret a far wall as a near one.
_MISSING_FAR_SHARE = 0.1
# Near walls alone are the first peak with this share of the highest.
_FIRST_PEAK_SHARE = 0.6


def wall_peaks(
    capture: Capture,
    prior: LosPrior,
    range_shift_m: tuple[float, float],
    peaks: KeptPeaks,
) -> PeakSet:
    """Peaks of all planes at the prior's distance, or shifted by an unknown delay.

    range_shift_m: largest shift towards (negative) and away from the antennas, one-way [m].
    peaks: of the capture; planes are imaged again for ranges beyond these.
    """
    if all(pose.n_antennas == 0 for pose in capture.poses):
        raise UserError(what="no plane has antennas")
    if max(-range_shift_m[0], range_shift_m[1]) <= MAX_RANGE_SHIFT_M:
        found = peaks.of(capture)
    else:
        found = collect_peaks(
            capture,
            prior,
            replace(peaks.subaperture, step_m=_STEP_M, direction_oversampling=2.0),
            peaks.noise_margin_db,
            reach_m=(-range_shift_m[0], range_shift_m[1]),
            num_threads=peaks.num_threads,
        )
    found = found.within(box_spans(capture.poses, prior) + np.array(range_shift_m))
    return found.select(found.levels_db >= -_DYNAMIC_RANGE_DB).thinned(_STEP_M)


def find_wall_offset(
    near: tuple[Floats, Floats],
    far: tuple[Floats, Floats],
    search_m: tuple[float, float],
    least: int = MIN_WALL_ECHOES,
) -> float:
    """Offset at which echoes of near and of far walls are densest together.

    The weight of an echo is the square root of its magnitude. In a count, many weak echoes would
    dominate, and in the power a single strong one. Densities of near and far walls are multiplied,
    so that neither decides alone.

    near: offsets of echoes from near walls, minus the wall's middle [m], and magnitudes, each (n,).
    far: those of far walls.
    search_m: smallest and largest offset [m].
    least: least number of near walls' echoes that agree.

    Raises UserError if fewer agree, or only at the edge of the search.
    """
    n_steps = max(2, round(4.0 * (search_m[1] - search_m[0]) / OFFSET_SIGMA_M) + 1)
    candidates = np.linspace(*search_m, n_steps)

    def density(offsets_m: Floats, magnitudes: Floats) -> Floats:
        scaled = (candidates[:, None] - offsets_m[None]) / OFFSET_SIGMA_M
        return np.asarray(np.exp(-0.5 * scaled**2) @ np.sqrt(magnitudes))

    of_near, of_far = density(*near), density(*far)
    score = np.sqrt(of_near * (of_far + _MISSING_FAR_SHARE * of_near.max(initial=0.0)))

    def count(kind: tuple[Floats, Floats], best: int) -> int:
        return int((np.abs(kind[0] - candidates[best]) < 0.01).sum())

    best = int(score.argmax())
    if count(far, best) < least:  # content, which may be as dense, is farther away
        rises, falls = np.diff(score, prepend=0.0) >= 0.0, np.diff(score, append=0.0) < 0.0
        peaks = np.flatnonzero(rises & falls & (score >= _FIRST_PEAK_SHARE * score[best]))
        best = int(peaks[0]) if len(peaks) else best
    n_near = count(near, best)
    if n_near < least or best in (0, n_steps - 1):  # a maximum at the edge is no peak
        raise walls_not_seen(n_near, search_m, least)
    return float(candidates[best])


def walls_not_seen(
    n_near: int, search_m: tuple[float, float], least: int = MIN_WALL_ECHOES
) -> UserError:
    """Error of a prior whose faces echo too rarely. n_near, least: echoes found and needed."""
    return UserError(
        what="the walls of the box do not stand out",
        expected=f"at least {least} echoes along the prior's faces at one offset between "
        f"{search_m[0]:g} and {search_m[1]:g} m",
        got=n_near,
        hint="check that the prior lies in the scan's frame and in metres; widen --delay-search "
        "LOW HIGH where the delay was not recorded; a scan that faces no wall needs a known delay "
        "and --no-delay",
    )
