"""Calibration of a capture from itself: delay, channel phases, frame, axis, antenna positions."""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from geraf2._bounds import Bounded, ChannelCount, PlaceM
from geraf2._types import Progress
from geraf2.calibration.autofocus import (
    DRIFT_SIZE_M,
    AntennaDrift,
    AutofocusConfig,
    focus_antennas,
    with_displacements,
)
from geraf2.calibration.channel_phase import ChannelPhases, channels_of, estimate_channel_phases
from geraf2.calibration.corrections import Corrections, with_delay
from geraf2.calibration.instrument_delay import (
    DelayCurve,
    delay_from_reflector,
    delay_from_sharpness,
)
from geraf2.calibration.wall_alignment import (
    AlignmentConfig,
    WallAlignment,
    align_to_walls,
    delay_search,
)
from geraf2.echoes.echo_phases import EchoPhases, collect_phases
from geraf2.errors import UserError
from geraf2.scene import Capture, LosPrior

DelaySource = Literal["walls", "reflector", "sharpness", "kept"]


@dataclass(frozen=True, kw_only=True)
class CalibrationConfig(Bounded):
    """What to look for."""

    delay_from: DelaySource = "walls"
    """What the instrument delay is found from; "kept" leaves it."""
    reflector_m: tuple[PlaceM, PlaceM, PlaceM] | None = None
    """Place of the reflector for delay_from "reflector" [m]."""
    frame: bool = True
    """Move the prior, the turntable axis and the poses' angles to where the walls are."""
    n_channels: ChannelCount | None = None
    """Channels that take turns, antenna i of channel i modulo this; None: by their offsets."""
    channels: bool = True
    """Correct the phases of channels."""
    positions: bool = True
    """Correct slow errors of the antennas' places."""
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
class CalibratedCapture:
    """The capture with everything found taken off, and what was found."""

    capture: Capture
    prior: LosPrior
    """In the frame of the capture."""
    walls: WallAlignment | None
    curve: DelayCurve | None
    """Where the delay came from a reflector or from sharpness."""
    channels: ChannelPhases | None
    """None where channels were not looked for or cannot be told apart."""
    channels_applied: bool
    drift: AntennaDrift | None
    drift_applied: bool


def calibrate(
    capture: Capture,
    prior: LosPrior,
    config: CalibrationConfig | None = None,
    *,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> CalibratedCapture:
    """Find out what a capture does not know of itself, and take it off.

    The delay goes first, as without it nothing lies where it is looked for; then channels, whose
    phases jump between neighbours and show whatever the geometry; then the walls once more, with
    the recorded geometry and the phases taken off: delay, prior, axis; then slow errors of
    positions, which need all of these. Phases and positions are left alone where they are not
    significant.

    prior: outside of the box, roughly in the capture frame.

    Raises UserError: channels do not divide the antennas of a plane; the walls, or the reflector,
    do not stand out.
    """
    config = config or CalibrationConfig()
    if config.channels and config.n_channels is not None:
        _require_whole_turns(capture, config.n_channels)
    report = progress or (lambda _: None)
    walls, curve = _find_delay(capture, prior, config, num_threads)
    report(0.3)

    late = Corrections(delay_m=_delay_m(walls, curve))
    echoes = collect_phases(late.applied(capture), prior, num_threads=num_threads)
    phases = _find_channels(capture, echoes, config)
    own = Corrections()
    use_phases = phases is not None and phases.is_significant
    if phases is not None and use_phases:
        own = replace(own, n_turns=config.n_channels or 0, channel_phases_rad=phases.phases_rad)
    report(0.6)

    if walls is not None and use_phases:
        walls, curve = _find_delay(own.applied(capture), prior, config, num_threads)
    own = replace(own, delay_m=_delay_m(walls, curve))
    if walls is not None and config.frame:
        own = replace(own, axis_shift_m=walls.axis_shift_m, angles_rad=walls.angles_rad)
        own = replace(own, prior_to_capture=walls.prior_to_capture)
    report(0.7)

    drift, use_drift, corrected = None, False, own.applied(capture)
    if config.positions:
        echoes = collect_phases(corrected, prior, size_m=DRIFT_SIZE_M, num_threads=num_threads)
        drift = focus_antennas(corrected, echoes, config.autofocus)
        use_drift = drift.is_significant
        if use_drift:
            corrected = with_displacements(corrected, drift.coefficients_m)
    report(1.0)
    return CalibratedCapture(
        capture=corrected,
        prior=own.moved_prior(prior),
        walls=walls,
        curve=curve,
        channels=phases,
        channels_applied=use_phases,
        drift=drift,
        drift_applied=use_drift,
    )


def _delay_m(walls: WallAlignment | None, curve: DelayCurve | None) -> float:
    return curve.delay_m if curve is not None else walls.delay_m if walls is not None else 0.0


def _find_delay(
    capture: Capture, prior: LosPrior, config: CalibrationConfig, num_threads: int | None
) -> tuple[WallAlignment | None, DelayCurve | None]:
    """Delay by the source asked for, then the frame with that delay held."""
    search = delay_search(capture, config.alignment.delay_search_m)
    curve = None
    if config.delay_from == "reflector":
        place = np.asarray(config.reflector_m, dtype=np.float64)
        curve = delay_from_reflector(capture, place, search)
    elif config.delay_from == "sharpness":
        center = prior.bounds.mean(axis=0)
        reach = 0.5 * float(np.linalg.norm(prior.size_m))
        curve = delay_from_sharpness(capture, center, reach, search)
    if config.delay_from != "walls" and not config.frame:
        return None, curve
    alignment = replace(config.alignment, keep_delay=config.delay_from != "walls")
    if curve is not None:
        capture = with_delay(capture, curve.delay_m)
    return align_to_walls(capture, prior, alignment, num_threads=num_threads), curve


def _find_channels(
    capture: Capture, echoes: list[EchoPhases], config: CalibrationConfig
) -> ChannelPhases | None:
    if not config.channels or not echoes:
        return None
    index = channels_of(capture.poses, config.n_channels or 0)
    return None if index is None else estimate_channel_phases(echoes, index)


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
