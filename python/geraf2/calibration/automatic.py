"""Calibration without being asked: each correction is judged by data that took no part in it.

What does not make such data fit better is dropped, so that a scan without errors comes out as it
went in, bit for bit. Corrections move antennas and the prior, never the content: results stay in
the frame in which the antennas' positions were recorded (docs/math.md, calibration).
"""

from collections import ChainMap
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np

from geraf2._types import Bools
from geraf2.calibration.autofocus import DRIFT_SIZE_M, AutofocusConfig, focus_antennas
from geraf2.calibration.channel_phase import (
    channels_of,
    estimate_channel_phases,
    find_turns,
    offset_channels,
    with_channel_phases,
)
from geraf2.calibration.corrections import Corrections
from geraf2.calibration.leakage import Leakage, find_leakage
from geraf2.calibration.wall_alignment import (
    GROUPS,
    MIN_FAR,
    AlignmentConfig,
    Group,
    WallAlignment,
    WallFit,
    WallProblem,
)
from geraf2.echoes.echo_phases import EchoPhases, collect_phases, mean_coherence
from geraf2.errors import UserError
from geraf2.scene import Capture, LosPrior

AUTOMATIC_VERSION = 6
"""Raised when the same capture gives other corrections."""

# Planes, sub-apertures and echoes that channels are looked for in: 1 s of processor time for 36
# planes at 3 mm.
_N_POSES = 8
_STEP_M = 0.03
_N_ECHOES = 30
# Of each plane that shows whether positions are off; then as many of all planes as take 1 s: of a
# drift of 0.32 mm 0.13 mm are left with 60, 0.16 mm with 30.
_MAX_DRIFT_ECHOES, _N_ALL_ECHOES = 60, 1000
# Relative gain in coherence of unused echoes from which on positions are moved: up to 0.4 % without
# any drift, 1.0 to 1.8 % for one of 0.2 mm (16 planes at 4 mm, four figures).
_DRIFT = AutofocusConfig(min_gain=0.006)
_SIZE_M = 0.08
# Coherence of echoes that took no part must rise by this share before channels are touched: what
# phases of 4 degrees rms cost.
_MIN_CHANNEL_GAIN = 0.0025
# Changes of the delay that are looked for, two-way path [m]; more where none was recorded.
_DELAY_SEARCH_M = (-0.03, 0.03)
# Misfit of wall echoes that took no part must fall by this share before anything is moved; a box
# that is turned by 2 degrees loses only 1 %, for what bends and leans a wall explains much of it.
_MIN_WALL_GAIN = 0.005
# And something must be as many standard uncertainties from where it was.
_MIN_SIGMAS = 3.0
# Energy of echoes inside the prior may fall by this share.
_MAX_INSIDE_LOSS = 0.02
_INSIDE_MARGIN_M = 0.005


_Step: TypeAlias = dict[str, Any]  # what one step adds to `Corrections`


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """What became of one correction."""

    name: str
    """leakage, channels, delay, frame, axis or positions."""
    applied: bool
    text: str
    """In one line: what was found, how sure it is, and what speaks for it or against."""
    against: str = ""
    """Why it was left alone."""
    numbers: dict[str, float] = field(default_factory=dict)
    """Values and uncertainties of one sigma, SI units; and what the rest of the data said."""

    def __str__(self) -> str:
        return f"{self.name}: {self.text}" + (f"; left, {self.against}" if self.against else "")


@dataclass(frozen=True, kw_only=True, eq=False)
class AutomaticCalibration:
    """The corrected capture, and how it came about."""

    capture: Capture
    """The one given, itself, where nothing was applied."""
    prior: LosPrior
    """In the frame of the capture."""
    corrections: Corrections
    judgements: tuple[Judgement, ...]


def calibrate_automatically(
    capture: Capture, prior: LosPrior, *, num_threads: int | None = None
) -> AutomaticCalibration:
    """Find and take off what the data show to be wrong; nothing else.

    Leakage; phases of channels, told by the antennas' offsets or by turns; the instrument delay,
    the prior's place, the turntable axis and the poses' angles from the walls; slow errors of
    positions.

    prior: outside of the box, roughly in the capture frame.
    """
    leakage = find_leakage(capture, prior, num_threads=num_threads)
    judgements = [_leakage_judged(leakage)]
    steps: list[_Step] = [{"leakage": None if leakage.method == "none" else leakage}]
    capture = Corrections(**steps[0]).applied(capture)
    some = sorted({int(i) for i in np.linspace(0, len(capture.poses), _N_POSES, endpoint=False)})
    echoes = _strong_echoes(capture, prior, some, num_threads)
    steps += [_judge_channels(capture, prior, echoes, judgements, num_threads)]
    capture = Corrections(**steps[-1]).applied(capture)
    steps += [_judge_walls(capture, prior, judgements, num_threads)]
    capture = Corrections(**steps[-1]).applied(capture)
    steps += [_judge_positions(capture, prior, some, judgements, num_threads)]
    own = Corrections(**dict(ChainMap(*steps)))
    return AutomaticCalibration(
        capture=Corrections(**steps[-1]).applied(capture),
        prior=own.moved_prior(prior),
        corrections=own,
        judgements=tuple(judgements),
    )


def _leakage_judged(leakage: Leakage) -> Judgement:
    applied = leakage.method != "none"
    numbers = {"level_db": leakage.level_db, "steadiness": leakage.steadiness}
    if leakage.method == "reference":
        numbers["phase_rms_rad"] = float(np.deg2rad(leakage.phase_rms_deg))
    return Judgement(
        name="leakage",
        applied=applied,
        text=str(leakage),
        numbers={name: value for name, value in numbers.items() if np.isfinite(value)},
    )


def _strong_echoes(
    capture: Capture,
    prior: LosPrior,
    poses: Collection[int],
    num_threads: int | None,
    n_echoes: int = _N_ECHOES,
    size_m: float = _SIZE_M,
) -> list[EchoPhases]:
    return collect_phases(
        capture,
        prior,
        poses=poses,
        step_m=_STEP_M,
        size_m=size_m,
        n_echoes=n_echoes,
        num_threads=num_threads,
    )


def _judge_channels(
    capture: Capture,
    prior: LosPrior,
    echoes: list[EchoPhases],
    judgements: list[Judgement],
    num_threads: int | None,
) -> _Step:
    """Phases of channels, which take turns or are told by offsets."""

    def judged(text: str, against: str, **numbers: float) -> None:
        judgements.append(
            Judgement(
                name="channels", applied=not against, text=text, against=against, numbers=numbers
            )
        )

    index = offset_channels(capture.poses)
    n_turns = 0 if index is not None else find_turns(echoes)
    if n_turns is None:
        judged("phases of neighbouring antennas agree", "nothing to correct")
        return {}
    index = channels_of(capture.poses, n_turns) or []
    poses = sorted({echo.pose for echo in echoes})
    half = [echo for echo in echoes if echo.pose in poses[::2]]
    rest = [echo for echo in echoes if echo.pose not in poses[::2]]
    try:
        phases = estimate_channel_phases(echoes, index)
        trial = estimate_channel_phases(half, index).phases_rad
    except UserError as error:
        judged(str(error).partition(",")[0], "nothing to go by")
        return {}
    # Wrong phases make echoes where there are none, so they are looked for again.
    better = with_channel_phases(capture, index, trial)
    before = mean_coherence(rest)
    after = mean_coherence(_strong_echoes(better, prior, poses[1::2], num_threads))
    rms = float(np.sqrt(np.mean(phases.phases_rad**2)))
    sigma = float(np.sqrt(np.mean(phases.sigma_rad**2)))
    told = f"{n_turns} that take turns" if n_turns else f"{len(phases.phases_rad)} by offset"
    text = (
        f"{told}, {np.rad2deg(rms):.1f} degrees rms +- {np.rad2deg(sigma):.1f}; "
        f"coherence of held-out echoes {before:.3f} -> {after:.3f}"
    )
    numbers = {
        "n": len(phases.phases_rad),
        "rms_rad": rms,
        "sigma_rad": sigma,
        "coherence_before": before,
        "coherence": after,
    }
    against = "" if phases.is_significant else "not significant"
    if after < (1.0 + _MIN_CHANNEL_GAIN) * before:
        against = against or "those echoes are no more coherent"
    judged(text, against, **numbers)
    return {} if against else {"n_turns": n_turns, "channel_phases_rad": phases.phases_rad}


def _judge_walls(
    capture: Capture,
    prior: LosPrior,
    judgements: list[Judgement],
    num_threads: int | None,
) -> _Step:
    """Delay, frame and axis, one after the other, each only if the rest of the echoes say so."""
    problem = _wall_problem(capture, prior, num_threads)
    if problem is None:
        text = "the walls of the box do not stand out"
        judgements.append(
            Judgement(name="delay", applied=False, text=text, against="nothing to go by")
        )
        return {}
    chosen = list[Group]()
    folds = problem.folds()
    now = problem.fit(chosen)
    for group in GROUPS:
        groups = [*chosen, group]
        fit = problem.fit(groups)
        found = problem.result(fit)
        text, numbers = _said(found, group)
        numbers["sigmas"] = _sigmas_off(found, group)
        against = ""
        if group == "delay" and problem.peak.n_far < MIN_FAR:
            against = "no far wall stands out"
        elif numbers["sigmas"] < _MIN_SIGMAS:
            against = "not significant"
        elif _inside(problem, fit) < _inside(problem, now) - _MAX_INSIDE_LOSS:
            against = "fewer echoes would lie inside the prior"
        else:
            before, after = (_held_out_misfit(problem, g, folds) for g in (chosen, groups))
            numbers |= {"misfit_before": before, "misfit": after}
            text += f"; misfit of held-out wall echoes {before:.2f} -> {after:.2f}"
            if after > (1.0 - _MIN_WALL_GAIN) * before:
                against = "they fit no better"
        judgements.append(
            Judgement(name=group, applied=not against, text=text, numbers=numbers, against=against)
        )
        if not against:
            chosen, now = groups, fit
    found = problem.result(now)
    values: dict[Group, _Step] = {
        "delay": {"delay_m": found.delay_m},
        "frame": {"prior_to_capture": found.prior_to_capture},
        "axis": {"axis_shift_m": found.axis_shift_m, "angles_rad": found.angles_rad},
    }
    return dict(ChainMap(*(values[group] for group in chosen)))


def _wall_problem(capture: Capture, prior: LosPrior, num_threads: int | None) -> WallProblem | None:
    """Echoes of walls near the recorded delay; farther where none was recorded, and both walls."""
    found: WallProblem | None = None
    searches = [_DELAY_SEARCH_M, None] if capture.waveform.path_bias_m == 0.0 else [_DELAY_SEARCH_M]
    for search in searches:
        config = AlignmentConfig(delay_search_m=search)
        with suppress(UserError):
            problem = WallProblem.of(capture, prior, config, num_threads=num_threads)
            if problem.peak.n_far >= MIN_FAR:
                return problem
            found = found or (problem if search is not None else None)
    return found


def _held_out_misfit(
    problem: WallProblem, groups: list[Group], folds: tuple[Bools, Bools]
) -> float:
    """Misfit of each half of the echoes under what the other half says."""
    first, second = folds
    costs = [problem.cost(problem.fit(groups, first), second)]
    costs.append(problem.cost(problem.fit(groups, second), first))
    return float(np.mean(costs))


def _sigmas_off(found: WallAlignment, group: Group) -> float:
    """How many standard uncertainties the farthest value of a group is from where it was."""
    values, sigmas = {
        "delay": (np.array([found.delay_m]), np.array([found.delay_sigma_m])),
        "frame": (
            np.concatenate([found.rotation_rad, found.translation_m]),
            np.concatenate([found.rotation_sigma_rad, found.translation_sigma_m]),
        ),
        "axis": (
            np.concatenate([found.axis_shift_m, found.angles_rad]),
            np.concatenate([found.axis_shift_sigma_m, found.angle_sigma_rad]),
        ),
    }[group]
    return float(np.max(np.abs(values) / np.maximum(sigmas, 1e-12), initial=0.0))


def _inside(problem: WallProblem, fit: WallFit) -> float:
    """Share of the echoes' energy inside the prior, or within 5 mm of it."""
    points, magnitudes = problem.placed_points(fit)
    near = problem.scene.signed_distance(points) < _INSIDE_MARGIN_M
    energy = magnitudes**2
    return float(energy[near].sum() / max(float(energy.sum()), 1e-300))


def _said(found: WallAlignment, group: Group) -> tuple[str, dict[str, float]]:
    """Say what the walls tell of a group, in words and numbers."""
    if group == "delay":
        bulge = f", walls bulged by up to {1e3 * abs(found.bulge_m):.1f} mm"
        text = f"{1e3 * found.delay_m:+.2f} mm of path +- {1e3 * found.delay_sigma_m:.2f}{bulge}"
        numbers = {"delay_m": found.delay_m, "sigma_m": found.delay_sigma_m}
        return text, numbers | {"bulge_m": found.bulge_m}
    if group == "frame":
        turn, shift = np.linalg.norm(found.rotation_rad), np.linalg.norm(found.translation_m)
        sigmas = found.rotation_sigma_rad.max(), found.translation_sigma_m[:2].max()
        text = (
            f"box turned by {np.rad2deg(turn):.2f} degrees +- {np.rad2deg(sigmas[0]):.2f}, moved "
            f"by {1e3 * shift:.1f} mm +- {1e3 * sigmas[1]:.1f}"
        )
        names = ("turn_rad", "turn_sigma_rad", "shift_m", "shift_sigma_m")
        values = (turn, sigmas[0], shift, sigmas[1])
        return text, dict(zip(names, map(float, values), strict=True))
    across, sigma = found.axis_shift_m[1], found.axis_shift_sigma_m[1]
    largest = np.abs(found.angles_rad).max()
    text = (
        f"turntable axis {1e3 * across:+.2f} mm across +- {1e3 * sigma:.2f}, angles by up to "
        f"{np.rad2deg(largest):.3f} degrees"
    )
    found_numbers = {"across_m": across, "sigma_m": sigma, "largest_angle_rad": largest}
    return text, {name: float(value) for name, value in found_numbers.items()}


def _judge_positions(
    capture: Capture,
    prior: LosPrior,
    some: list[int],
    judgements: list[Judgement],
    num_threads: int | None,
) -> _Step:
    """Slow errors of positions; all planes are looked at only where some show any."""
    few = _strong_echoes(capture, prior, some, num_threads, _MAX_DRIFT_ECHOES, DRIFT_SIZE_M)
    drift = focus_antennas(capture, few, _DRIFT)
    if drift.is_significant:
        planes = range(len(capture.poses))
        each = min(max(_N_ALL_ECHOES // len(planes), _N_ECHOES), _MAX_DRIFT_ECHOES)
        every = _strong_echoes(capture, prior, planes, num_threads, each, DRIFT_SIZE_M)
        drift = focus_antennas(capture, every, _DRIFT)
    rms = drift.rms_m(capture)
    text = (
        f"{1e3 * rms:.2f} mm rms +- {1e3 * drift.sigma_m:.2f}; coherence of held-out echoes "
        f"{drift.coherence_before:.3f} -> {drift.coherence_after:.3f}"
    )
    numbers = {
        "rms_m": rms,
        "sigma_m": drift.sigma_m,
        "coherence_before": drift.coherence_before,
        "coherence": drift.coherence_after,
    }
    against = "" if drift.is_significant else "those echoes are no more coherent"
    judgements.append(
        Judgement(
            name="positions", applied=not against, text=text, against=against, numbers=numbers
        )
    )
    return {} if against else {"drift_coefficients_m": drift.coefficients_m}
