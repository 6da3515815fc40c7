"""Judgements: which corrections of a calibration are accepted, and why.

A correction is accepted where its values exceed their uncertainty and where data that took no part
in finding it fit better with it.
"""

from dataclasses import dataclass, field

import numpy as np

from geraf2._types import Bools
from geraf2.calibration.autofocus import AntennaDrift
from geraf2.calibration.channel_phase import ChannelPhases
from geraf2.calibration.leakage import Leakage
from geraf2.calibration.wall_alignment import (
    MIN_FAR,
    Group,
    WallAlignment,
    WallFit,
    WallProblem,
)
from geraf2.errors import UserError

# Coherence of echoes that took no part must rise by this share before channels are touched: what
# phases of 4 degrees rms cost.
_MIN_CHANNEL_GAIN = 0.0025
# Misfit of wall echoes that took no part must fall by this share before anything is moved; a box
# that is turned by 2 degrees loses only 1 %, for what bends and leans a wall explains much of it.
_MIN_WALL_GAIN = 0.005
# And something must be as many standard uncertainties from where it was.
_MIN_SIGMAS = 3.0
# Energy of echoes inside the prior may fall by this share.
_MAX_INSIDE_LOSS = 0.02
_INSIDE_MARGIN_M = 0.005


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
    error: UserError | None = None
    """Why it cannot be found, of one who asks for it."""
    numbers: dict[str, float] = field(default_factory=dict)
    """Values and uncertainties of one sigma, SI units; and what the rest of the data said."""

    def __str__(self) -> str:
        return f"{self.name}: {self.text}" + (f"; left, {self.against}" if self.against else "")


def judge(
    name: str,
    text: str,
    *,
    significant: bool,
    gain: float,
    least_gain: float,
    numbers: dict[str, float] | None = None,
) -> Judgement:
    """Accept a correction that is significant and that held-out data confirm.

    name, text, numbers: of the judgement. significant: whether its values exceed their
    uncertainty. gain: by what share held-out data fit better with it. least_gain: of this, to be
    accepted.
    """
    against = "" if gain >= least_gain else "held-out echoes fit no better"
    against = against if significant else "not significant"
    return Judgement(
        name=name, applied=not against, text=text, against=against, numbers=numbers or {}
    )


def nothing_found(name: str, text: str, against: str, error: UserError | None = None) -> Judgement:
    """Judgement of what was not found."""
    return Judgement(name=name, applied=False, text=text, against=against, error=error)


def judge_leakage(leakage: Leakage) -> Judgement:
    """Judgement of leakage, which has judged itself."""
    numbers = {"level_db": leakage.level_db, "steadiness": leakage.steadiness}
    if leakage.method == "reference":
        numbers["phase_rms_rad"] = float(np.deg2rad(leakage.phase_rms_deg))
    return Judgement(
        name="leakage",
        applied=leakage.method != "none",
        text=str(leakage),
        numbers={name: value for name, value in numbers.items() if np.isfinite(value)},
    )


def judge_channels(phases: ChannelPhases, n_turns: int, before: float, after: float) -> Judgement:
    """Judgement of phases; before and after: coherence of held-out echoes."""
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
    return judge(
        "channels",
        text,
        significant=phases.is_significant,
        gain=after / max(before, 1e-300) - 1.0,
        least_gain=_MIN_CHANNEL_GAIN,
        numbers=numbers,
    )


def judge_drift(drift: AntennaDrift, rms_m: float) -> Judgement:
    """Judgement of positions; the drift itself was judged by held-out echoes."""
    text = (
        f"{1e3 * rms_m:.2f} mm rms +- {1e3 * drift.sigma_m:.2f}; coherence of held-out echoes "
        f"{drift.coherence_before:.3f} -> {drift.coherence_after:.3f}"
    )
    numbers = {
        "rms_m": rms_m,
        "sigma_m": drift.sigma_m,
        "coherence_before": drift.coherence_before,
        "coherence": drift.coherence_after,
    }
    gain = 0.0 if drift.is_significant else -np.inf
    return judge("positions", text, significant=True, gain=gain, least_gain=0.0, numbers=numbers)


def judge_groups(
    problem: WallProblem, groups: list[Group]
) -> tuple[list[Judgement], list[Group], WallFit]:
    """Judgements of groups of unknowns, those that are applied, and the fit of these."""
    judgements, chosen, folds = list[Judgement](), list[Group](), problem.folds()
    now = problem.fit(chosen)
    for group in groups:
        fit = problem.fit([*chosen, group])
        found = problem.result(fit)
        text, numbers = _said(found, group)
        numbers["sigmas"] = _sigmas_off(found, group)
        if group == "delay" and problem.peak.n_far < MIN_FAR:
            judgements.append(nothing_found(group, text, "no far wall stands out"))
            continue
        significant = numbers["sigmas"] >= _MIN_SIGMAS
        if significant and _inside(problem, fit) < _inside(problem, now) - _MAX_INSIDE_LOSS:
            judgements.append(nothing_found(group, text, "fewer echoes would lie inside the prior"))
            continue
        gain = 0.0
        if significant:
            before, after = (
                _held_out_misfit(problem, g, folds) for g in (chosen, [*chosen, group])
            )
            numbers |= {"misfit_before": before, "misfit": after}
            text += f"; misfit of held-out wall echoes {before:.2f} -> {after:.2f}"
            gain = 1.0 - after / max(before, 1e-300)
        judgements.append(
            judge(
                group,
                text,
                significant=significant,
                gain=gain,
                least_gain=_MIN_WALL_GAIN,
                numbers=numbers,
            )
        )
        if judgements[-1].applied:
            chosen, now = [*chosen, group], fit
    return judgements, chosen, now


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
