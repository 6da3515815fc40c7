"""Calibration of a capture from itself: each correction is judged by data that took no part in it.

What does not make such data fit better is dropped, so that a scan without errors comes out as it
went in, bit for bit. Corrections move antennas and the prior, never the content: results stay in
the frame in which the antennas' positions were recorded (docs/math/calibration.md#acceptance).
"""

from collections import ChainMap
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeAlias

import numpy as np

from geraf2._bounds import Bounded, ChannelCount, PlaceM
from geraf2._types import Progress
from geraf2.calibration.autofocus import (
    DRIFT_SIZE_M,
    AntennaDrift,
    AutofocusConfig,
    focus_antennas,
)
from geraf2.calibration.channel_phase import (
    ChannelPhases,
    channels_of,
    estimate_channel_phases,
    find_turns,
    offset_channels,
    with_channel_phases,
)
from geraf2.calibration.corrections import Corrections
from geraf2.calibration.instrument_delay import (
    DelayCurve,
    delay_from_reflector,
    delay_from_sharpness,
)
from geraf2.calibration.judgement import (
    Judgement,
    judge_channels,
    judge_drift,
    judge_groups,
    judge_leakage,
    nothing_found,
)
from geraf2.calibration.leakage import find_leakage
from geraf2.calibration.wall_alignment import (
    GROUPS,
    MIN_FAR,
    NEAR_SEARCH_M,
    WIDE_SEARCH_M,
    AlignmentConfig,
    Group,
    WallAlignment,
    WallProblem,
    delay_search,
)
from geraf2.echoes.echo_phases import EchoPhases, collect_phases, mean_coherence
from geraf2.errors import UserError
from geraf2.imaging.peaks import KeptPeaks
from geraf2.scene import Capture, LosPrior

CALIBRATION_VERSION = 8
"""Raised when the same capture gives other corrections."""

# Planes, sub-apertures and echoes that channels are looked for in: 1 s of processor time for 36
# planes at 3 mm.
_N_POSES = 8
_STEP_M = 0.03
_N_ECHOES = 30
# Of each plane that shows whether positions are off; then as many of all planes as take 1 s: of a
# drift of 0.32 mm 0.13 mm are left with 60, 0.16 mm with 30.
_MAX_DRIFT_ECHOES, _N_ALL_ECHOES = 60, 1000
_SIZE_M = 0.08
_Step: TypeAlias = dict[str, Any]  # what one step adds to `Corrections`
DelaySource = Literal["walls", "reflector", "sharpness", "kept"]


@dataclass(frozen=True, kw_only=True)
class CalibrationConfig(Bounded):
    """What is calibrated."""

    leakage: bool = True
    """Subtract what reaches the receivers without having been in the box."""
    delay_from: DelaySource = "walls"
    """What the instrument delay is found from; "kept" leaves it."""
    reflector_m: tuple[PlaceM, PlaceM, PlaceM] | None = None
    """Position of the reflector for delay_from "reflector" [m]."""
    frame: bool = True
    """Move the prior, the turntable axis and the poses' angles to where the walls are."""
    n_channels: ChannelCount | None = None
    """Channels that take turns, antenna i of channel i modulo this; None: by their offsets, else
    by their phases."""
    channels: bool = True
    """Correct the phases of channels."""
    positions: bool = True
    """Correct slow errors of the antennas' positions."""
    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)
    autofocus: AutofocusConfig = field(default_factory=AutofocusConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.delay_from == "reflector") != (self.reflector_m is not None):
            msg = (
                "reflector_m goes with delay_from 'reflector', got "
                f"{self.reflector_m} with {self.delay_from!r}"
            )
            raise ValueError(msg)


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """The corrected capture, and how it came about."""

    capture: Capture
    """The one given, itself, where nothing was applied."""
    prior: LosPrior
    """In the frame of the capture."""
    corrections: Corrections
    judgements: tuple[Judgement, ...]
    walls: WallAlignment | None = None
    """With the corrections that were applied; None where walls were not used or not seen."""
    curve: DelayCurve | None = None
    """Where the delay came from a reflector or from sharpness."""
    channels: ChannelPhases | None = None
    """None where channels were not looked for or cannot be told apart."""
    drift: AntennaDrift | None = None
    """None where positions were not looked for."""

    def applied(self, name: str) -> bool:
        """Whether the correction of this name was applied."""
        return any(one.applied for one in self.judgements if one.name == name)


def calibrate(
    capture: Capture,
    prior: LosPrior,
    config: CalibrationConfig | None = None,
    *,
    peaks: KeptPeaks | None = None,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Capture and prior without the errors that the data show; nothing else is changed.

    Leakage; phases of channels, told by the antennas' offsets or by turns; the instrument delay,
    the prior's place, the turntable axis and the poses' angles from the walls; slow errors of
    positions. Where no delay is recorded, channels are found with that of the walls.

    prior: outside of the box, roughly in the capture frame.
    config: what is calibrated; all of it when None.
    peaks: of the capture's planes, and of its corrected planes; collected when None.

    Raises UserError where a reflector or sharpness gives no delay, or where channels that were
    given do not divide the antennas of a plane.
    """
    config = config or CalibrationConfig()
    if config.channels and config.n_channels is not None:
        _require_whole_turns(capture, config.n_channels)
    run = _Run(capture, prior, config, peaks or KeptPeaks(prior, num_threads=num_threads))
    report = progress or (lambda _: None)
    steps = (run.leakage, run.delay, run.channels, run.walls, run.positions)
    for number, step in enumerate(steps):
        run.add(step())
        report((number + 1) / len(steps))
    own = Corrections(**dict(ChainMap(*run.steps)))
    return Calibration(
        capture=run.capture,
        prior=own.moved_prior(prior),
        corrections=own,
        judgements=tuple(run.judgements),
        **run.found,
    )


class _Run:
    """Steps of one calibration, each on the capture that the ones before it corrected."""

    def __init__(
        self,
        capture: Capture,
        prior: LosPrior,
        config: CalibrationConfig,
        peaks: KeptPeaks,
    ) -> None:
        self.capture, self.prior, self.config = capture, prior, config
        self.peaks = peaks
        self.judgements = list[Judgement]()
        self.steps = list[_Step]()
        self.found = dict[str, Any]()  # of `Calibration`, what is kept beside the corrections
        n_poses = len(capture.poses)
        self.some = sorted({int(i) for i in np.linspace(0, n_poses, _N_POSES, endpoint=False)})

    def add(self, step: _Step) -> None:
        """Keep a step and correct the capture by it."""
        self.steps.append(step)
        self.capture = Corrections(**step).applied(self.capture)

    def leakage(self) -> _Step:
        """Find leakage, whose delays are shorter than those of the box."""
        if not self.config.leakage:
            return {}
        leakage = find_leakage(self.capture, self.prior, self.peaks)
        self.judgements.append(judge_leakage(leakage))
        return {} if leakage.method == "none" else {"leakage": leakage}

    def delay(self) -> _Step:
        """Instrument delay that is not the walls'; it was asked for, and is applied."""
        config, capture = self.config, self.capture
        search = delay_search(capture, config.alignment.delay_search_m)
        if config.delay_from == "reflector":
            place = np.asarray(config.reflector_m, dtype=np.float64)
            curve = delay_from_reflector(capture, place, search)
        elif config.delay_from == "sharpness":
            reach = 0.5 * float(np.linalg.norm(self.prior.size_m))
            curve = delay_from_sharpness(capture, self.prior.bounds.mean(axis=0), reach, search)
        else:
            return {}
        self.found["curve"] = curve
        text = f"{1e3 * curve.delay_m:+.2f} mm of path +- {1e3 * curve.sigma_m:.2f}"
        numbers = {"delay_m": curve.delay_m, "sigma_m": curve.sigma_m}
        self.judgements.append(Judgement(name="delay", applied=True, text=text, numbers=numbers))
        return {"delay_m": curve.delay_m}

    def channels(self) -> _Step:
        """Phases of channels, which take turns or are told by offsets."""
        if not self.config.channels:
            return {}
        capture = self.capture
        if self.config.delay_from == "walls" and capture.waveform.path_bias_m == 0.0:
            # Without a delay echoes lie elsewhere; that of the walls is found again afterwards.
            with suppress(UserError):
                problem = _wall_problem(capture, self.prior, self.alignment(), self.peaks)
                delay_m = problem.result(problem.fit(GROUPS[:1])).delay_m
                capture = Corrections(delay_m=delay_m).applied(capture)
        echoes = _strong_echoes(capture, self.peaks, self.some)
        index = offset_channels(capture.poses) if self.config.n_channels is None else None
        n_turns = self.config.n_channels or (0 if index is not None else find_turns(echoes))
        if n_turns is None:
            text = "phases of neighbouring antennas agree"
            self.judgements.append(nothing_found("channels", text, "nothing to correct"))
            return {}
        index = channels_of(capture.poses, n_turns) or []
        poses = sorted({echo.pose for echo in echoes})
        half = [echo for echo in echoes if echo.pose in poses[::2]]
        rest = [echo for echo in echoes if echo.pose not in poses[::2]]
        try:
            phases = estimate_channel_phases(echoes, index)
            trial = estimate_channel_phases(half, index).phases_rad
        except UserError as error:
            text = str(error).partition(",")[0]
            self.judgements.append(nothing_found("channels", text, "nothing to go by", error))
            return {}
        self.found["channels"] = phases
        # Wrong phases make echoes where there are none, so they are looked for again.
        better = with_channel_phases(capture, index, trial)
        before = mean_coherence(rest)
        after = mean_coherence(_strong_echoes(better, self.peaks, poses[1::2]))
        found = judge_channels(phases, n_turns, before, after)
        self.judgements.append(found)
        if not found.applied:
            return {}
        return {"n_turns": n_turns, "channel_phases_rad": phases.phases_rad}

    def alignment(self) -> AlignmentConfig:
        """Return what may be off, by the source of the delay."""
        held = self.config.delay_from != "walls"
        return replace(self.config.alignment, keep_delay=held)

    def walls(self) -> _Step:
        """Find delay, frame and axis, one after the other, each judged by held-out echoes."""
        groups: list[Group] = [
            group
            for group in GROUPS
            if (self.config.delay_from == "walls" if group == "delay" else self.config.frame)
        ]
        if not groups:
            return {}
        try:
            problem = _wall_problem(self.capture, self.prior, self.alignment(), self.peaks)
            judgements, chosen, fit = judge_groups(problem, groups)
            found = problem.result(fit)
            if found.n_echoes == 0:
                raise UserError(
                    what="the walls of the box do not stand out",
                    expected="echoes along the prior's faces",
                    got=0,
                    hint="check that the prior lies in the scan's frame and in metres; widen "
                    "--delay-search LOW HIGH where the delay was not recorded",
                )
        except UserError as error:
            text = "the walls of the box do not stand out"
            self.judgements.append(nothing_found(groups[0], text, "nothing to go by", error))
            return {}
        self.judgements += judgements
        self.found["walls"] = found
        values: dict[Group, _Step] = {
            "delay": {"delay_m": found.delay_m},
            "frame": {"prior_to_capture": found.prior_to_capture},
            "axis": {"axis_shift_m": found.axis_shift_m, "angles_rad": found.angles_rad},
        }
        return dict(ChainMap(*(values[group] for group in chosen)))

    def positions(self) -> _Step:
        """Slow errors of positions; all planes are used only where some show any."""
        if not self.config.positions:
            return {}
        capture, config = self.capture, self.config.autofocus
        few = _strong_echoes(capture, self.peaks, self.some, _MAX_DRIFT_ECHOES, DRIFT_SIZE_M)
        drift = focus_antennas(capture, few, config)
        if drift.is_significant:
            planes = range(len(capture.poses))
            each = min(max(_N_ALL_ECHOES // len(planes), _N_ECHOES), _MAX_DRIFT_ECHOES)
            every = _strong_echoes(capture, self.peaks, planes, each, DRIFT_SIZE_M)
            drift = focus_antennas(capture, every, config)
        self.found["drift"] = drift
        found = judge_drift(drift, drift.rms_m(capture))
        self.judgements.append(found)
        return {"drift_coefficients_m": drift.coefficients_m} if found.applied else {}


def _strong_echoes(
    capture: Capture,
    peaks: KeptPeaks,
    planes: Collection[int],
    n_echoes: int = _N_ECHOES,
    size_m: float = _SIZE_M,
) -> list[EchoPhases]:
    found = peaks.of(capture, planes).thinned(_STEP_M)
    return collect_phases(capture, found, size_m=size_m, n_echoes=n_echoes)


def _wall_problem(
    capture: Capture, prior: LosPrior, config: AlignmentConfig, peaks: KeptPeaks
) -> WallProblem:
    """Echoes of walls near the recorded delay; farther where none was recorded, and both walls.

    UserError where no wall stands out.
    """
    near = config.delay_search_m or NEAR_SEARCH_M
    searches = [near]
    wide = config.delay_search_m is None and not config.keep_delay
    if wide and capture.waveform.path_bias_m == 0.0:
        searches.append(WIDE_SEARCH_M)
    found, failure = None, None
    for search in searches:
        try:
            problem = WallProblem.of(
                capture,
                prior,
                replace(config, delay_search_m=search),
                peaks,
                num_threads=peaks.num_threads,
            )
        except UserError as error:
            failure = failure or error
            continue
        if problem.peak.n_far >= MIN_FAR:
            return problem
        found = found or (problem if search == near else None)
    if found is None:
        raise failure or UserError(what="the walls of the box do not stand out")
    return found


def _require_whole_turns(capture: Capture, n_channels: int) -> None:
    """Every place has one antenna of each channel, so that they divide the antennas of a pose."""
    for number, pose in enumerate(capture.poses):
        if pose.n_antennas % n_channels:
            raise UserError(
                what=f"--channels {n_channels} does not divide the antennas of a plane",
                expected=f"a multiple of {n_channels} in every plane",
                got=f"{pose.n_antennas} in plane {pose.name or number}",
                hint="give the number of channels that take turns, or leave it out",
            )
