"""Calibration of a capture from its own data, accepted by held-out data.

A correction that does not raise the likelihood of held-out data is not applied, so a scan without
errors is returned unchanged, bit for bit. Corrections move antennas and the prior, never the
content: results stay in the frame of the recorded positions (docs/math/calibration.md#acceptance).
"""

from collections import ChainMap
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from geraf2._bounds import Bounded, ChannelCount
from geraf2._types import Progress
from geraf2.calibration.acceptance import Judgement, judge, nothing_found
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
    phase_gain,
)
from geraf2.calibration.corrections import Corrections
from geraf2.calibration.leakage import find_leakage
from geraf2.calibration.wall_alignment import (
    GROUPS,
    AlignmentConfig,
    Group,
    WallAlignment,
    WallProblem,
    walls_not_seen,
)
from geraf2.echoes.echo_phases import EchoPhases, collect_phases
from geraf2.errors import UserError
from geraf2.imaging.peaks import KeptPeaks
from geraf2.scene import Capture, LosPrior

CALIBRATION_VERSION = 16
"""Increase when the same capture gives other corrections."""

# Planes for channels; step of sub-apertures [m]; echoes a plane.
_N_POSES, _STEP_M, _N_ECHOES = 8, 0.03, 30
_Step: TypeAlias = dict[str, Any]  # arguments of `Corrections` from one step


@dataclass(frozen=True, kw_only=True)
class CalibrationConfig(Bounded):
    """Selection of corrections."""

    leakage: bool = True
    """Subtract direct leakage between transmitter and receiver."""
    delay: bool = True
    """Correct the instrument delay."""
    frame: bool = True
    """Move the prior to agree with the walls."""
    n_channels: ChannelCount | None = None
    """Number of interleaved channels, antenna i with channel i modulo this. None: by their offsets,
    else by their phases."""
    channels: bool = True
    """Correct the phases of channels."""
    positions: bool = True
    """Correct slow errors of the antennas' positions."""
    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)
    autofocus: AutofocusConfig = field(default_factory=AutofocusConfig)


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """Corrected capture, and the decisions behind it."""

    capture: Capture
    """Corrected capture; the same object if nothing was applied."""
    prior: LosPrior
    """Prior in the frame of the capture."""
    corrections: Corrections
    judgements: tuple[Judgement, ...]
    common_offset_sigma_m: float
    """Standard deviation of the one-way range offset that all planes share after the corrections
    [m]."""
    walls: WallAlignment | None = None
    """Estimate with the applied corrections; None if walls were not used or not seen."""
    channels: ChannelPhases | None = None
    """None if channels were not searched for or cannot be distinguished."""
    drift: AntennaDrift | None = None
    """None if positions were not estimated."""

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
    """Correct a capture and its prior for the errors that the data show.

    Linear steps are first: leakage and phases of channels. Delay and position of the prior
    follow in one estimate from the walls, then slow errors of positions. If no delay is recorded,
    channels are estimated with that of the walls.

    prior: outside of the box, approximately in the capture frame.
    config: selection of corrections; all when None.
    peaks: of the capture's planes, and of its corrected planes; collected when None.

    Raises UserError if the given channels do not divide the antennas of a plane.
    """
    config = config or CalibrationConfig()
    if config.channels and config.n_channels is not None:
        _require_whole_turns(capture, config.n_channels)
    run = _Run(capture, prior, config, peaks or KeptPeaks(prior, num_threads=num_threads))
    report = progress or (lambda _: None)
    steps = (run.leakage, run.channels, run.walls, run.positions)
    for number, step in enumerate(steps):
        run.add(step())
        report((number + 1) / len(steps))
    own = Corrections(**dict(ChainMap(*run.steps)))
    return Calibration(
        capture=run.capture,
        prior=own.moved_prior(prior),
        corrections=own,
        judgements=tuple(run.judgements),
        common_offset_sigma_m=run.offset_sigma_m,
        **run.found,
    )


class _Run:
    """Steps of one calibration, each on the capture that the previous ones corrected."""

    def __init__(
        self, capture: Capture, prior: LosPrior, config: CalibrationConfig, peaks: KeptPeaks
    ) -> None:
        self.capture, self.prior, self.config = capture, prior, config
        self.peaks = peaks
        self.judgements = list[Judgement]()
        self.steps = list[_Step]()
        self.found = dict[str, Any]()  # arguments of `Calibration` besides the corrections
        self.subset = _planes_around(capture)
        self.alignment = replace(config.alignment, keep_delay=not config.delay)
        self.offset_sigma_m = 0.5 * self.alignment.delay_sigma_m

    def add(self, step: _Step) -> None:
        """Record a step and apply it to the capture."""
        self.steps.append(step)
        self.capture = Corrections(**step).applied(self.capture)

    def leakage(self) -> _Step:
        """Estimate leakage, whose delays are shorter than those of the box."""
        if not self.config.leakage:
            return {}
        found = find_leakage(self.capture, self.prior)
        applied = found.basis is not None
        self.judgements.append(
            Judgement(name="leakage", applied=applied, text=str(found), numbers=found.numbers)
        )
        return {"leakage": found} if applied else {}

    def channels(self) -> _Step:
        """Estimate the phases of channels, which are interleaved or differ in their offsets."""
        if not self.config.channels:
            return {}
        capture = self.capture
        if not self.alignment.keep_delay and not self.alignment.is_recorded(capture):
            # Echoes need a delay: use that of the walls, which is estimated again later.
            with suppress(UserError):
                problem = WallProblem(capture, self.prior, self.alignment, self.peaks)
                delay_m = problem.result(problem.fit(GROUPS[:1])).delay_m
                capture = Corrections(delay_m=delay_m).applied(capture)
        echoes = list(_strong_echoes(capture, self.peaks, self.subset))
        index = offset_channels(capture.poses) if self.config.n_channels is None else None
        n_turns = self.config.n_channels or (0 if index is not None else find_turns(echoes))
        if n_turns is None:
            text = "phases of neighbouring antennas agree"
            self.judgements.append(nothing_found("channels", text, "nothing to correct"))
            return {}
        index = channels_of(capture.poses, n_turns) or []
        held_out = self.subset[1::2]
        try:
            phases = estimate_channel_phases(echoes, index)
            rest = [echo for echo in echoes if echo.pose not in held_out]
            trial = estimate_channel_phases(rest, index).phases_rad
        except UserError as error:
            text = str(error).partition(",")[0]
            self.judgements.append(nothing_found("channels", text, "no data", error))
            return {}
        self.found["channels"] = phases
        test = [echo for echo in echoes if echo.pose in held_out]
        gain, before, after = phase_gain(test, index, trial)
        kind = f"{n_turns} interleaved" if n_turns else f"{len(trial)} by offset"
        rms, sigma = (float(np.sqrt(np.mean(v**2))) for v in (phases.phases_rad, phases.sigma_rad))
        text = (
            f"{kind}, {np.rad2deg(rms):.1f} degrees rms +- {np.rad2deg(sigma):.1f}; "
            f"coherence of held-out echoes {before:.3f} -> {after:.3f}"
        )
        numbers = {"n": len(trial), "rms_rad": rms, "sigma_rad": sigma}
        numbers |= {"coherence_before": before, "coherence": after}
        self.judgements.append(judge("channels", text, numbers, gain))
        if not gain.is_sure:
            return {}
        return {"n_turns": n_turns, "channel_phases_rad": phases.phases_rad}

    def walls(self) -> _Step:
        """Estimate delay and frame together, and test each in the presence of the other."""
        groups: list[Group] = [
            group
            for group in GROUPS
            if (not self.alignment.keep_delay if group == "delay" else self.config.frame)
        ]
        if not groups:
            return {}
        try:
            problem = WallProblem(self.capture, self.prior, self.alignment, self.peaks)
            every = problem.result(problem.fit(groups))
            if not len(every.offsets_after_m):
                raise walls_not_seen(0, self.alignment.search_m(self.capture))
        except UserError as error:
            text = "the walls of the box do not stand out"
            self.judgements.append(nothing_found(groups[0], text, "no data", error))
            return {}
        gains = {
            group: problem.gain([other for other in groups if other != group], group)
            for group in groups
        }
        always = ("delay",) if self.alignment.always_delay else ()
        chosen = [group for group, gain in gains.items() if gain.is_sure or group in always]
        found = problem.result(problem.fit(chosen))
        for group, gain in gains.items():
            is_applied = group in chosen
            judged = judge(group, *_describe(found if is_applied else every, group), gain)
            against = "" if is_applied else judged.against
            self.judgements.append(replace(judged, applied=is_applied, against=against))
        self.found["walls"] = found
        # An estimated offset that is not applied remains in the capture.
        rest_m = every.delay_m - found.delay_m
        self.offset_sigma_m = 0.5 * float(np.hypot(rest_m, every.delay_sigma_m))
        values: dict[Group, _Step] = {
            "delay": {"delay_m": found.delay_m},
            "frame": {"prior_to_capture": found.prior_to_capture},
        }
        return dict(ChainMap(*(values[group] for group in chosen)))

    def positions(self) -> _Step:
        """Estimate slow errors of positions."""
        if not self.config.positions:
            return {}
        capture, config = self.capture, self.config.autofocus
        echoes = _strong_echoes(capture, self.peaks, range(len(capture.poses)))
        drift = focus_antennas(capture, echoes, config)
        self.found["drift"] = drift
        rms_m = drift.rms_m(capture)
        numbers = {
            "rms_m": rms_m,
            "sigma_m": drift.sigma_m,
            "coherence_before": drift.coherence_before,
            "coherence": drift.coherence_after,
        }
        text = (
            f"{1e3 * rms_m:.2f} mm rms +- {1e3 * drift.sigma_m:.2f}; coherence of held-out echoes "
            f"{drift.coherence_before:.3f} -> {drift.coherence_after:.3f}"
        )
        found = judge("positions", text, numbers, drift.gain)
        self.judgements.append(found)
        return {"drift_coefficients_m": drift.coefficients_m} if found.applied else {}


def _planes_around(capture: Capture) -> list[int]:
    """Choose planes at even steps around the box, in this order."""
    looking = np.array([pose.axes[0] for pose in capture.poses]).reshape(-1, 3)
    order = np.argsort(np.arctan2(looking[:, 1], looking[:, 0]).round(3), kind="stable")
    steps = {int(i) for i in np.linspace(0, len(order), _N_POSES, endpoint=False)}
    return [int(order[step]) for step in sorted(steps)]


def _strong_echoes(
    capture: Capture, peaks: KeptPeaks, planes: Collection[int]
) -> Iterator[EchoPhases]:
    """Echoes of some planes, one after the other."""
    found = peaks.of(capture, planes).thinned(_STEP_M)
    return collect_phases(capture, found, size_m=DRIFT_SIZE_M, n_echoes=_N_ECHOES)


def _describe(found: WallAlignment, group: Group) -> tuple[str, dict[str, float]]:
    """Text and numbers of a group's estimate."""
    if group == "delay":
        bulge = f", walls bulged by up to {1e3 * abs(found.bulge_m):.1f} mm"
        text = f"{1e3 * found.delay_m:+z.2f} mm of path +- {1e3 * found.delay_sigma_m:.2f}{bulge}"
        numbers = {"delay_m": found.delay_m, "sigma_m": found.delay_sigma_m}
        return text, numbers | {"bulge_m": found.bulge_m}
    turn, shift = np.linalg.norm(found.rotation_rad), np.linalg.norm(found.translation_m)
    sigmas = found.rotation_sigma_rad.max(), found.translation_sigma_m[:2].max()
    text = (
        f"box turned by {np.rad2deg(turn):.2f} degrees +- {np.rad2deg(sigmas[0]):.2f}, moved "
        f"by {1e3 * shift:.1f} mm +- {1e3 * sigmas[1]:.1f}"
    )
    names = ("turn_rad", "turn_sigma_rad", "shift_m", "shift_sigma_m")
    values = (turn, sigmas[0], shift, sigmas[1])
    return text, dict(zip(names, map(float, values), strict=True))


def _require_whole_turns(capture: Capture, n_channels: int) -> None:
    """Raise UserError unless the number of interleaved channels divides the antennas of a pose."""
    for number, pose in enumerate(capture.poses):
        if pose.n_antennas % n_channels:
            raise UserError(
                what=f"--channels {n_channels} does not divide the antennas of a plane",
                expected=f"a multiple of {n_channels} in every plane",
                got=f"{pose.n_antennas} in plane {pose.name or number}",
                hint="give the number of interleaved channels, or leave it out",
            )
