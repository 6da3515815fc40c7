"""The box around the content, from a scan alone."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from geraf2._types import Floats, Ints
from geraf2.calibration.box_edges import (
    content_reach,
    find_edge,
    flash_reach,
    within,
)
from geraf2.calibration.box_search import (
    COARSE,
    FACING_COSINE,
    LEVEL_STEP_DB,
    MIN_REACH_M,
    MIN_SIDE_M,
    N_LEVELS,
    Flashes,
    RoughFaces,
    explained,
    leaking,
    scene_peaks,
    upward,
    with_lobes,
)
from geraf2.calibration.corrections import with_delay
from geraf2.calibration.cuboid_search import MAX_PATH_M, BoxSearch, delay_odds, rough_faces
from geraf2.calibration.found_box import (
    SKEW_RAD,
    FoundBox,
    NoBoxError,
    NoCuboidError,
    Seen,
    WallsNotFoundError,
    face_names,
)
from geraf2.calibration.free_air import SLACK_M
from geraf2.calibration.leakage import find_leakage, without_leakage
from geraf2.calibration.wall_alignment import AlignmentConfig, WallProblem
from geraf2.constants import NORMAL_95
from geraf2.echoes.flashes import MAX_OFFSET_M, OFFSET_SIGMA_M, WallMiddles
from geraf2.echoes.wall_faces import N_MODES
from geraf2.errors import UserError
from geraf2.geometry.transforms import rigid
from geraf2.imaging.peaks import KeptPeaks, PeakSet
from geraf2.ops._threads import limit_blas_threads
from geraf2.scene import Capture, LosPrior
from geraf2.scene.summary import CaptureSummary, is_delay_given, summarize_capture

BOX_VERSION = 11
"""Increase when the same capture gives another box."""
# Expected errors of the faces before the fit, by their flashes.
_ROUGH = AlignmentConfig(translation_sigma_m=0.0, wall_sigma_m=OFFSET_SIGMA_M, min_echoes=3)
# Least share and number of the sub-apertures facing a wall in which a seen wall echoes.
_SEEN_SHARE, _MIN_FLASHES = 0.5, 2
# Largest curvature of a wall, 0 for a plane and 1 for a point, and least extent of antennas [m].
_MAX_CURVED, _MIN_SPREAD_M = 0.4, 0.02
# Largest share of energy outside of the walls: grating lobes and multipath.
_MAX_OUTSIDE = 0.3
# Least number of walls that are seen squarely: flat content looks like one wall.
_MIN_WALLS = 2
# Least number of sub-apertures with walls that are no cuboid's: four overlap, and four count.
_MIN_BESIDE = 16
# Standard deviation of a yaw of which nothing is known: uniform over a quarter turn [rad].
_ANY_YAW_RAD = 0.5 * np.pi / np.sqrt(12.0)
MIN_CONTENT = 0.02
"""Share of the energy from within below which planes belong to a body, not to walls."""


@limit_blas_threads
def find_box(
    capture: Capture,
    *,
    expected: LosPrior | None = None,
    summary: CaptureSummary | None = None,
    keep_delay: bool = False,
    num_threads: int | None = None,
) -> FoundBox:
    """Find the box around the content from the scan alone: a cuboid at any yaw.

    Parameters
    ----------
    capture
        The scan.
    expected
        A cuboid whose orientation is preferred if the scan allows several, and by whose near walls
        a delay that was not recorded is found.
    summary
        Of the capture, if already computed.
    keep_delay
        Use the recorded instrument delay, even if near and far walls agree at another one.
    num_threads
        All cores when None.

    Returns
    -------
    FoundBox
        The cuboid in the capture's frame [m]. Faces that no antenna sees at a right angle have an
        interval. Without any bound but the seen walls, they get a margin.

    Raises
    ------
    WallsNotFoundError
        A UserError: no walls are found, or antennas are within them.
    NoCuboidError
        The walls are those of another shape.
    DelayUnknownError
        No delay was recorded, and the scan does not show it.

    Examples
    --------
    >>> capture, truth = geraf2.examples.small_capture()
    >>> box = geraf2.find_box(capture)
    >>> [round(side, 2) for side in box.size_m[:2].tolist()]
    [0.16, 0.16]
    """
    summary = summary or summarize_capture(capture)
    focus, reach = summary.focus, summary.standoff_m
    if focus is None or not np.isfinite(reach):
        raise WallsNotFoundError(seen="the planes face no common point")
    if reach < MIN_REACH_M:
        raise WallsNotFoundError(seen=f"the planes meet {1e3 * reach:.0f} mm in front of them")
    capture = _shifted(capture, -focus)
    is_recorded = keep_delay or is_delay_given(capture)
    farther_m = 0.0 if is_recorded else 0.5 * MAX_PATH_M
    peaks = scene_peaks(np.zeros(3), reach, num_threads, farther_m)
    like = None if expected is None or expected.cuboid is None else expected.cuboid[0]
    seen = _SeenWalls.of(capture, peaks, reach, farther_m)
    box = expected and expected.move(rigid(np.eye(3), -focus))
    delay = delay_odds(seen.search, box, is_recorded=is_recorded)
    change_m = 0.0 if keep_delay else delay.change_m
    if change_m:
        seen = _SeenWalls.of(with_delay(capture, change_m), peaks, reach, farther_m)
    try:
        found = _find(seen, like)
    except NoBoxError as error:
        error.delay_change_m = change_m
        raise
    return replace(found.moved(focus), delay=delay, delay_change_m=change_m)


def _find(seen: "_SeenWalls", like: Floats | None) -> FoundBox:
    """Find the likeliest box that no echo contradicts."""
    contradicted = list[tuple[FoundBox, WallsNotFoundError]]()
    for start, corrected in seen.boxes(like):
        try:
            return _finished(seen.capture, start, corrected)
        except WallsNotFoundError as error:
            contradicted.append((start, error))
    likeliest, reason = contradicted[0]
    _require_cuboid(seen.flashes, likeliest.normals.reshape(6, 3))
    raise reason


def _require_cuboid(flashes: Flashes, sides: Floats) -> None:
    """Raise NoCuboidError where walls stand beside a cuboid's sides. sides: normals, (n, 3)."""
    along, beside = flashes.walls_beside(sides)
    if beside >= max(_MIN_BESIDE, along):
        raise NoCuboidError


def _finished(capture: Capture, box: FoundBox, peaks: PeakSet) -> FoundBox:
    """Box after the fit, with bounds for its unseen faces."""
    if not box.size_m.min() > MIN_SIDE_M:
        raise WallsNotFoundError(seen=f"planes only {1e3 * box.size_m.min():.0f} mm apart")
    box = _refined(capture, box, peaks)
    if 0 < (box.seen == Seen.SQUARELY).sum() < _MIN_WALLS:
        raise WallsNotFoundError(seen="one flat surface, which may be content")
    box = replace(box, content_share=_content_share(box, peaks))
    return _bounded(capture, box, peaks)


def _shifted(capture: Capture, shift_m: Floats) -> Capture:
    """Capture in a frame with a shifted origin."""
    return replace(capture, poses=tuple(pose.moved(shift_m) for pose in capture.poses))


@dataclass(frozen=True, kw_only=True, eq=False)
class _SeenWalls:
    """Peaks of a scan as flashes of walls, and the search for a box among them."""

    capture: Capture
    """The scan without leakage."""
    kept: PeakSet
    """Peaks that may belong to walls."""
    lobes: PeakSet
    """The same, also in the directions whose grating lobes they may be."""
    index: Ints
    """Peak of each direction."""
    flashes: Flashes
    middles: WallMiddles
    search: BoxSearch

    @classmethod
    def of(
        cls, capture: Capture, peaks: KeptPeaks, reach_m: float, farther_m: float
    ) -> "_SeenWalls":
        """Peaks that are no leakage. farther_m: as of `scene_peaks` [m]."""
        inner = LosPrior.from_box((reach_m, reach_m, reach_m))
        capture = without_leakage(capture, find_leakage(capture, inner))
        found = peaks.of(capture)
        kept = found.select(~leaking(capture, found, reach_m + 0.5 * farther_m))
        share = 10.0 ** (-N_LEVELS * LEVEL_STEP_DB / 20.0)
        kept = kept.select(kept.strengths > share * kept.strengths.max(initial=0.0))
        if not len(kept):
            raise WallsNotFoundError(seen="no echo above the noise")
        lobes, index = with_lobes(capture, kept)
        flashes = Flashes.of(capture, kept, lobes, index)
        return cls(
            capture=capture,
            kept=kept,
            lobes=lobes,
            index=index,
            flashes=flashes,
            middles=WallMiddles.of(capture.walls, capture.waveform),
            search=BoxSearch(flashes, upward(capture), reach_m, capture.waveform),
        )

    def boxes(self, like: Floats | None) -> Iterator[tuple[FoundBox, PeakSet]]:
        """Boxes before the fit, the likeliest first, with corrected peaks."""
        found = [r for r in rough_faces(self.search, like) if not np.isnan(r.offsets_m).all()]
        if not found:
            _require_cuboid(self.flashes, np.outer([-1.0, 1.0], self.search.up))
            n = len(self.kept)
            raise WallsNotFoundError(seen=f"{n} echoes, none of a plane that is seen squarely")
        for rough in found:
            corrected = explained(self.kept, self.lobes, self.index, rough, self.middles)
            yield _initial_box(rough, corrected, self.middles), corrected


def _initial_box(rough: RoughFaces, peaks: PeakSet, middles: WallMiddles) -> FoundBox:
    """Box whose unseen faces get the mean offset of the seen ones, until they are bounded.

    The seen walls extend to all apertures that see their flashes.
    """
    unseen = np.isnan(rough.offsets_m)
    half = float(np.nanmean(rough.offsets_m))
    opposite = np.nan_to_num(rough.offsets_m[:, ::-1], nan=half)
    offsets = np.where(unseen, 2.0 * half - opposite, rough.offsets_m)
    for k, side in np.argwhere(unseen):
        foot = flash_reach(peaks, rough.normals, rough.offsets_m, ~unseen, (k, side), middles)
        offsets[k, side] = max(offsets[k, side], foot + COARSE.size_m)
    return FoundBox(
        axes=rough.axes,
        turn_sigma_rad=np.full(3, _ROUGH.rotation_sigma_rad),
        offsets_m=offsets,
        sigmas_m=np.where(unseen, np.inf, _ROUGH.wall_sigma_m),
        bounds_m=np.zeros((3, 2, 2)),
        seen=np.where(unseen, Seen.NOT, Seen.SQUARELY).astype(np.int64),
    )


def _refined(capture: Capture, box: FoundBox, peaks: PeakSet) -> FoundBox:
    """Box after one joint estimate of delay, orientation and each wall's distance."""
    try:
        problem = WallProblem(capture, box.prior, _ROUGH, peaks)
    except UserError as error:
        raise WallsNotFoundError(str(error).partition(", expected")[0]) from error
    shapes = problem.parts["shapes"].reshape(-1, N_MODES)[:, 0]
    fit = problem.fit(("delay", "frame"))
    found, echoes = problem.result(fit), problem.walls_of(fit.values, 1.0)
    turn = found.prior_to_capture[:3, :3]
    axes, offsets, widths = box.axes @ turn.T, box.offsets_m.copy(), box.sigmas_m.copy()
    seen = box.seen.copy()
    rows = np.full((3, 2), -1, dtype=np.int64)
    for wall, normal in enumerate(problem.faces.normals):
        face = np.unravel_index((box.normals @ normal).argmax(), (3, 2))
        own = echoes.index[echoes.walls == wall]
        row, outward = shapes[wall], turn @ normal
        middle = found.center_m + turn @ (problem.faces.centers[wall] - found.center_m)
        offsets[face] = (middle + fit.values[row] * outward) @ outward
        widths[face], rows[face] = np.sqrt(fit.covariance[row, row]), row
        seen[face] = Seen.SQUARELY if _is_seen(problem, own, wall) else Seen.NOT
    n_pairs = int((seen[:2] == Seen.SQUARELY).any(axis=1).sum())
    skew = (SKEW_RAD / np.sqrt(2.0 * n_pairs) if n_pairs else _ANY_YAW_RAD) * axes[2]
    common = fit.covariance[rows[:, 0], rows[:, 1]] / widths.prod(axis=1)
    is_pair = ((seen == Seen.SQUARELY) & (rows >= 0)).all(axis=1)
    return replace(
        box,
        axes=axes,
        turn_sigma_rad=np.hypot(found.rotation_sigma_rad, skew),
        offsets_m=offsets,
        sigmas_m=np.where(seen == Seen.SQUARELY, widths, np.inf),
        correlations=np.where(is_pair, common, 0.0),
        seen=seen,
    )


def _is_seen(problem: WallProblem, echoes: Ints, wall: int) -> bool:
    """Whether a wall is flat and echoes in most sub-apertures that face it at a right angle.

    echoes: peaks that are interpreted as the wall's.
    """
    peaks, normal = problem.echoes, problem.faces.normals[wall]
    own = np.unique(peaks.subapertures[echoes])
    if len(own) < _MIN_FLASHES or _curvature(peaks.select(echoes)) > _MAX_CURVED:
        return False
    centers = peaks.subaperture_centers
    ahead = problem.axes[peaks.subaperture_planes][:, 0] @ normal
    feet = centers - np.outer((centers - centers[own].mean(axis=0)) @ normal, normal)
    low, high = feet[own].min(axis=0) - 1e-3, feet[own].max(axis=0) + 1e-3
    expected = (np.abs(ahead) > FACING_COSINE) & ((feet >= low) & (feet <= high)).all(axis=1)
    expected &= np.isin(np.arange(len(centers)), peaks.subapertures)
    expected &= np.isin(np.sign(ahead), np.sign(ahead[own]))
    return len(own) >= _SEEN_SHARE * int(expected.sum())


def _curvature(echoes: PeakSet) -> float:
    """Convergence of lines of sight: 0 for a plane, 1 for a point, negative for a concave face."""
    off_center, off_direction = np.zeros((2, len(echoes), 3))
    for number in np.unique(echoes.planes):
        own = echoes.planes == number
        off_center[own] = echoes.centers[own] - echoes.centers[own].mean(axis=0)
        off_direction[own] = echoes.directions[own] - echoes.directions[own].mean(axis=0)
    spread = float((off_center**2).sum())
    if spread < _MIN_SPREAD_M**2:
        return 0.0
    return -float((off_center * off_direction).sum() / spread * echoes.ranges_m.mean())


def _bounded(capture: Capture, box: FoundBox, peaks: PeakSet) -> FoundBox:
    """Box whose unseen faces lie at their edges, or with a margin around everything seen."""
    offsets, sigmas, seen = box.offsets_m.copy(), box.sigmas_m.copy(), box.seen.copy()
    square = seen == Seen.SQUARELY
    normals, middles = box.normals, WallMiddles.of(capture.walls, capture.waveform)
    bounds = offsets[..., None] + NORMAL_95 * np.where(square, sigmas, 0.0)[..., None] * [-1.0, 1.0]
    for _, k, side in face_names():
        face = (k, side)
        if square[face]:
            continue
        known = (seen != Seen.NOT).all(axis=1)
        usual = 0.5 * float(offsets[known].sum(axis=1).max(initial=box.size_m.min())) + SLACK_M
        least = flash_reach(peaks, normals, box.offsets_m, square, face, middles)
        content = content_reach(peaks, normals, box.offsets_m, square, face)
        edge = find_edge(peaks, normals, box.offsets_m, square, face, max(least, content))
        if edge is None:
            offsets[face] = max(least, content, usual)
            bounds[face] = max(least, content), np.inf
        else:
            offsets[face], sigmas[face] = edge, OFFSET_SIGMA_M
            seen[face] = Seen.EDGES
            bounds[face] = edge + NORMAL_95 * OFFSET_SIGMA_M * np.array([-1.0, 1.0])
    _require_outside(capture, normals, offsets)
    return replace(box, offsets_m=offsets, sigmas_m=sigmas, seen=seen, bounds_m=bounds)


def _content_share(box: FoundBox, peaks: PeakSet) -> float:
    """Share of the energy within the walls; UserError if they do not enclose the echoes."""
    square = box.seen == Seen.SQUARELY
    if not square.any():
        raise WallsNotFoundError(seen=f"{len(peaks)} echoes, none of a plane that is seen squarely")
    energy = peaks.strengths**2

    def share(margin_m: float) -> float:
        limits = np.where(square, box.offsets_m + margin_m, np.inf)
        inside = within(peaks.points, box.normals, limits)
        return float(energy[inside].sum() / energy.sum())

    outside = 1.0 - share(MAX_OFFSET_M)
    if outside > _MAX_OUTSIDE:
        raise WallsNotFoundError(
            seen=f"planes with {100 * outside:.0f} % of the echoes outside of them"
        )
    return share(-MAX_OFFSET_M)


def _require_outside(capture: Capture, normals: Floats, offsets: Floats) -> None:
    """Raise UserError if antennas are within the found walls."""
    n_inside = sum(
        bool(within(pose.phase_centers, normals, offsets).any()) for pose in capture.poses
    )
    if n_inside:
        raise WallsNotFoundError(seen=f"planes of antennas within the walls: {n_inside}")
