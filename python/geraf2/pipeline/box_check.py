"""Box of a run by its radar: the prior if none is given, else a check of the given one."""

from dataclasses import dataclass, replace
from itertools import permutations
from typing import Any

import numpy as np

from geraf2._types import Floats, Ints
from geraf2.calibration.box_finder import MIN_CONTENT, find_box
from geraf2.calibration.corrections import with_delay
from geraf2.calibration.cuboid_search import DelayUnknownError
from geraf2.calibration.found_box import (
    FoundBox,
    NoBoxError,
    NoCuboidError,
    Seen,
    WallsNotFoundError,
)
from geraf2.calibration.free_air import content_region
from geraf2.constants import NORMAL_95
from geraf2.errors import UserError
from geraf2.io.belt_file import MOTION_KEY
from geraf2.io.run_folder import RunFolder
from geraf2.pipeline.events import Listener
from geraf2.pipeline.prior import add_walls
from geraf2.scene import Capture, LosPrior
from geraf2.scene.summary import CaptureSummary

BY_RADAR, STATED = "the box by radar", "the box of the scene"
"""Names in messages of a found box, and of one that the scene states."""
BOX_STAGE = "box"
"""Name of the step in progress messages."""
# Differences from the prior that calibration corrects: size, centre [m], rotation [degrees].
_SIZE_M, _CENTER_M, _TURN_DEG = 0.004, 0.008, 3.0
# Least difference of a side that means another box [m].
_OTHER_BOX_M = 0.03
# Largest typical expected error of content without a box: half a range cell of 4 GHz [m].
_MAX_ERROR_M = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxCheck:
    """Prior of a run, and the box that the scan shows."""

    prior: LosPrior
    found: FoundBox | None
    """None if the scan shows no walls."""
    text: str
    """Summary in one line."""
    is_new: bool = False
    """Whether the prior is the found box, or was corrected by it."""
    is_warning: bool = False
    """Whether the user is warned: the prior was corrected, or no box was found."""
    name: str = BY_RADAR
    """Name of the prior in messages."""
    delay_m: float = 0.0
    """Change of the recorded delay with which it was found, on the two-way path [m]."""

    def place(self, capture: Capture) -> Capture:
        """Capture with the walls of a new prior; without walls if the prior is rotated."""
        if not self.is_new:
            return capture
        return replace(capture, walls=() if self.prior.is_turned else self.prior.walls)

    def numbers(self) -> dict[str, Any]:
        """Entry of run.json."""
        return {"by_radar": self.text, **(self.found.numbers() if self.found else {})}


def stated_box(capture: Capture) -> tuple[LosPrior, str] | None:
    """Carton that the scene states, the first hypothesis of the box, and its name.

    None for a parcel of a belt, whose walls are known and whose place on it is not.
    """
    if not capture.walls or MOTION_KEY in capture.provenance:
        return None
    outer = capture.walls[0]
    return LosPrior.from_box(outer.size_m, outer.center_m, walls=capture.walls), STATED


def box_from_radar(
    capture: Capture,
    summary: CaptureSummary,
    listener: Listener,
    num_threads: int | None,
    *,
    keep_delay: bool = False,
) -> BoxCheck:
    """Find the box if no prior is given; without walls, the region of the content.

    keep_delay: as of `find_box`.
    """
    with listener.step(BOX_STAGE):
        try:
            found = find_box(
                capture, summary=summary, keep_delay=keep_delay, num_threads=num_threads
            )
        except WallsNotFoundError as error:
            capture = with_delay(capture, error.delay_change_m)
            prior = content_region(capture, summary=summary, num_threads=num_threads)
            sides = _in_mm(np.asarray(prior.size_m), np.arange(3))
            text = (
                f"no walls of a box are seen ({error.seen}): all within {sides} mm is treated as "
                "content in free air; if it is in a box, give --box X Y Z or --los MESH"
            )
            delay_m = error.delay_change_m
            return BoxCheck(
                prior=prior, found=None, text=text, is_new=True, is_warning=True, delay_m=delay_m
            )
    return _by_radar(capture, found, str(found))


def _by_radar(
    capture: Capture, found: FoundBox, text: str, *, is_warning: bool = False
) -> BoxCheck:
    prior = add_walls(found.prior, capture.walls)
    return _with_delay(
        BoxCheck(prior=prior, found=found, text=text, is_new=True, is_warning=is_warning)
    )


def _with_delay(check: BoxCheck) -> BoxCheck:
    """Add the delay that the box was found with."""
    found = check.found
    if found is None or not found.delay_change_m:
        return check
    text = f"{check.text}; {found.delay}"
    return replace(check, text=text, delay_m=found.delay_change_m, is_warning=True)


def check_prior(
    capture: Capture,
    prior: LosPrior,
    name: str,
    summary: CaptureSummary,
    listener: Listener,
    num_threads: int | None,
    *,
    keep_delay: bool = False,
) -> BoxCheck:
    """Compare a given prior with the box of the scan, and correct a cuboid that differs.

    name: of the prior in errors. keep_delay: as of `find_box`.

    One pair of planes may be flat content or multipath, which is a warning.
    Raises UserError if the scan shows two sides of another box than a given one, or if it shows
    that box at another delay than the recorded one. A box that only the scene states is replaced
    by another cuboid.
    """
    what = STATED if name == STATED else "the prior"
    unchecked = f"{what} could not be checked, and is used as it is"
    kept = BoxCheck(prior=prior, found=None, text="", name=name)
    with listener.step(BOX_STAGE):
        try:
            found = find_box(
                capture,
                expected=prior,
                summary=summary,
                keep_delay=keep_delay,
                num_threads=num_threads,
            )
        except NoBoxError as error:
            is_other = isinstance(error, NoCuboidError)
            seen = str(error).partition(",")[0] if is_other else "too few walls are seen squarely"
            return replace(
                kept,
                text=f"{seen}: {unchecked}",
                is_warning=is_other and prior.cuboid is not None,
                delay_m=error.delay_change_m,
            )
        except DelayUnknownError:
            if prior.cuboid is not None:
                raise
            return replace(kept, text=f"the delay is not known: {unchecked}")
    if prior.cuboid is None:
        return _with_delay(
            replace(kept, found=found, text=f"{found}; {what} is no cuboid and is not compared")
        )
    kept = replace(kept, delay_m=found.delay_change_m)
    return _compare(capture, found, kept, Difference.measure(found, *prior.cuboid), what)


def _compare(
    capture: Capture, found: FoundBox, kept: BoxCheck, difference: "Difference", what: str
) -> BoxCheck:
    """Check of a cuboid: kept, corrected, or replaced by the found box; UserError for another one.

    what: the prior in texts.
    """
    given, own = (
        _in_mm(sizes, difference.both) for sizes in (difference.given_size_m, found.size_m)
    )
    if difference.is_other and difference.is_within and found.content_share < MIN_CONTENT:
        return replace(kept, text=f"planes of {own} mm within {what} are content")
    if difference.is_other and len(difference.both) == 1:
        text = (
            f"planes {own} mm apart are no walls of {what}, whose side is {given} mm; it is kept, "
            "since no other walls were seen"
        )
        return replace(kept, text=text, is_warning=True)
    if difference.is_other and kept.name == STATED:
        text = f"{found}; the scene states sides of {given} mm, which the scan contradicts"
        return _by_radar(capture, found, text, is_warning=True)
    if difference.is_other:
        raise UserError(
            what="the scan shows another box than the prior",
            where=kept.name,
            expected=f"sides of {given} mm",
            got=f"{own} mm by the walls' echoes",
            hint="leave the prior out, or keep it with --trust-los",
        )
    if not difference.text:
        off_m = (found.size_m - difference.given_size_m)[difference.both]
        text = f"no two opposite faces are seen: {what}'s sides were not compared"
        if len(off_m):
            most = 1e3 * float(np.abs(off_m).max())
            text = f"{what} agrees: sides of {given} mm differ by at most {most:.1f} mm"
        return _with_delay(replace(kept, found=found, text=text))
    corrected = difference.correct(found)
    text = f"{what} is off by {difference.text} and was corrected: {corrected}"
    return replace(_by_radar(capture, corrected, text, is_warning=True), name=kept.name)


def require_determined(run: RunFolder) -> None:
    """Raise UserError if content in free air has no certain surface: walls may be part of it."""
    mesh = run.stages["mesh"].numbers if "mesh" in run.stages else {}
    error_mm = mesh.get("expected_error_median_mm", 0.0)
    if "size_m" not in run.stages[BOX_STAGE].numbers and error_mm > 1e3 * _MAX_ERROR_M:
        raise UserError(
            what="no walls of a box are seen, and the content has no certain surface",
            where=run.place,
            expected=f"a typical expected error below {1e3 * _MAX_ERROR_M:.0f} mm",
            got=f"{error_mm:.0f} mm",
            hint="give the outside of the box with --box X Y Z or --los MESH",
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Difference:
    """Difference between a given cuboid and a found one, along the axes of the found one."""

    given_size_m: Floats
    """(3,) [m]."""
    given_offsets_m: Floats
    """Distances of the given box's faces, as in `FoundBox`, (3, 2) [m]."""
    both: Ints
    """Axes with both faces seen at a right angle."""
    is_other: bool
    """Whether a side differs by more than `_OTHER_BOX_M`."""
    is_within: bool
    """Whether all found sides are shorter."""
    off_m: Floats
    """Largest difference of a side, and distance of the centres, (2,) [m]."""
    text: str
    """Size of the differences; empty if the prior agrees."""

    @classmethod
    def measure(
        cls, found: FoundBox, axes: Floats, size_m: Floats, center_m: Floats
    ) -> "Difference":
        """Compare with the axes, size and centre of the given cuboid."""
        square = found.seen == Seen.SQUARELY
        both, either = np.flatnonzero(square.all(axis=1)), np.flatnonzero(square.any(axis=1))
        order = min(
            permutations(range(3)),
            key=lambda o: _misfit(found, axes[list(o)], size_m[list(o)], both),
        )
        size, axes = size_m[list(order)], axes[list(order)]
        middle = found.axes @ center_m
        offsets = np.stack([0.5 * size - middle, 0.5 * size + middle], axis=1)
        tolerance = NORMAL_95 * found.size_sigma_m
        off_size = found.size_m - size
        center = 0.5 * (found.offsets_m[:, 1] - found.offsets_m[:, 0]) - middle
        turn = np.rad2deg(np.arccos(np.clip(np.abs((found.axes * axes).sum(axis=1)), 0.0, 1.0)))
        turn_deg = float(turn[either].max(initial=0.0))
        parts = []
        if len(both) and (np.abs(off_size[both]) > _SIZE_M + tolerance[both]).any():
            parts.append(f"{1e3 * np.abs(off_size[both]).max():.1f} mm of size")
        if turn_deg > _TURN_DEG + NORMAL_95 * found.yaw_sigma_deg:
            parts.append(f"{turn_deg:.1f} degrees of rotation")
        shift = float(np.linalg.norm(center[both]))
        if shift > _CENTER_M:
            parts.append(f"{1e3 * shift:.1f} mm of position")
        return cls(
            given_size_m=size,
            given_offsets_m=offsets,
            both=both,
            is_within=bool((off_size[both] < 0.0).all()),
            is_other=bool((np.abs(off_size[both]) > _OTHER_BOX_M).any()),
            off_m=np.array([np.abs(off_size[both]).max(initial=0.0), shift]),
            text=", ".join(parts),
        )

    def correct(self, found: FoundBox) -> FoundBox:
        """Found box, whose unseen faces are the given ones, as uncertain as the seen ones are off.

        Along an axis with one face seen the given size determines the other one.
        """
        is_seen = found.seen != Seen.NOT
        offsets, off = self.given_offsets_m.copy(), np.full((3, 2), self.off_m.sum())
        for k in np.flatnonzero(is_seen.any(axis=1) & ~is_seen.all(axis=1)):
            side = int(is_seen[k].argmax())
            offsets[k, 1 - side] = self.given_size_m[k] - found.offsets_m[k, side]
            off[k] = self.off_m[0]
        bounds = offsets[..., None] + off[..., None] * [-1.0, 1.0]
        return replace(
            found,
            offsets_m=np.where(is_seen, found.offsets_m, offsets + off),
            bounds_m=np.where(is_seen[..., None], found.bounds_m, bounds),
        )


def _misfit(found: FoundBox, axes: Floats, size_m: Floats, both: Ints) -> float:
    """Misfit of an assignment of the axes: degrees of rotation plus millimetres of size."""
    cosine = np.clip(np.abs((found.axes * axes).sum(axis=1)), 0.0, 1.0)
    size = 1e3 * np.abs(found.size_m - size_m)[both].max(initial=0.0)
    return float(np.rad2deg(np.arccos(cosine)).max() + size)


def _in_mm(lengths_m: Floats, axes: Ints) -> str:
    return " x ".join(f"{1e3 * lengths_m[k]:.0f}" for k in axes)
