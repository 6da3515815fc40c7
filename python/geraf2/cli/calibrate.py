"""`geraf2 calibrate`: delay, channel phases, frame, axis and antenna positions of a scene."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np

from geraf2.calibration.autofocus import AutofocusConfig
from geraf2.calibration.calibration import CalibratedCapture, CalibrationConfig, DelaySource
from geraf2.calibration.wall_alignment import AlignmentConfig, WallAlignment
from geraf2.cli._console import CONSOLE, Positional, Threads, require_threads, rows, say
from geraf2.cli._fields import Arg
from geraf2.errors import UserError
from geraf2.io.container import LOS_NAME, read_scene_manifest
from geraf2.io.manifest import CalibrationManifest
from geraf2.pipeline.prior import PriorSource, Triple
from geraf2.pipeline.calibrating import CALIBRATION_FIGURE_NAME, calibrate_scene

_MAX_SEARCH_M = 20.0


@dataclass(frozen=True, kw_only=True)
class Config:
    """Find what a scan does not know of itself; writes a corrected scene, or says what it found.

    Looks for the instrument delay, phases of channels, the place of the box, the turntable axis,
    and slow errors of the antennas' positions. Nothing is written without OUT or --write.
    """

    scene: Positional[Annotated[Path, Arg(metavar="SCENE")]]
    """Scene folder."""
    out: Positional[Annotated[Path | None, Arg(metavar="[OUT]")]] = None
    """Corrected scene to make, with the box as los.ply and a picture."""
    write: bool = False
    """Correct SCENE itself instead."""
    overwrite: bool = False
    """Replace another scene in OUT."""
    los: Annotated[Path | None, Arg(metavar="MESH")] = None
    """Closed mesh of the outside of the box, metres; los.ply of the scene when not given."""
    box: Annotated[Triple | None, Arg(metavar="X Y Z")] = None
    """Or the outer side lengths of the box, axes along the frame's [m]."""
    box_center: Annotated[Triple, Arg(metavar="X Y Z")] = (0.0, 0.0, 0.0)
    """Where the middle of --box lies [m]."""
    delay_from: DelaySource | None = None
    """What the instrument delay is found from; the walls when not given, "kept" leaves it."""
    reflector: Annotated[Triple | None, Arg(metavar="X Y Z")] = None
    """Place of a small reflector to find the delay from [m]."""
    delay_search: Annotated[tuple[float, float], Arg(metavar="LOW HIGH")] = (-0.3, 1.0)
    """Change of the delay to look for, on the two-way path [m]."""
    no_frame: bool = False
    """Leave the box, the turntable axis and the angles where they are."""
    channels: Annotated[int | None, Arg(metavar="N")] = None
    """Antenna i of a pose is of channel i modulo N; told by the offset of receiver from
    transmitter when not given."""
    no_channels: bool = False
    """Leave the phases of channels."""
    no_positions: bool = False
    """Leave the antennas' positions."""
    threads: Threads = None
    """Threads to use; all when not given."""
    autofocus: AutofocusConfig = field(default_factory=AutofocusConfig)
    """Constants of the search for errors of positions."""


def main(config: Config) -> int:
    """Run the command."""
    num_threads = require_threads(config.threads)
    settings = _settings(config)
    if config.write and config.out is not None:
        raise UserError(what="give either OUT or --write", got="both")
    read_scene_manifest(config.scene)  # that there is no scene is said before that it has no prior
    los = config.los
    if los is None and config.box is None and (config.scene / LOS_NAME).is_file():
        los = config.scene / LOS_NAME
    source = PriorSource(los=los, box=config.box, box_center=config.box_center)
    prior, name = source.load()
    calibrated = calibrate_scene(
        config.scene,
        prior,
        settings,
        prior_name=str(name) if los is None else los.name,
        num_threads=num_threads,
        listener=CONSOLE,
    )
    _print_table(calibrated.table, calibrated.found)
    target = config.scene if config.write else config.out
    if target is None:
        say("nothing was written: give OUT, or --write to correct the scene itself")
        return 0
    calibrated.save(target, overwrite=config.write or config.overwrite, listener=CONSOLE)
    rows(
        [
            ("scene", str(target)),
            ("box", str(target / LOS_NAME)),
            ("picture", str(target / CALIBRATION_FIGURE_NAME)),
            ("next", f"geraf2 reconstruct {target} RUN --los {target / LOS_NAME}"),
        ]
    )
    return 0


def _settings(config: Config) -> CalibrationConfig:
    source = config.delay_from or ("reflector" if config.reflector is not None else "walls")
    if (source == "reflector") != (config.reflector is not None):
        raise UserError(
            what="--delay-from reflector goes with --reflector X Y Z",
            got=f"--delay-from {source}, {'no ' if config.reflector is None else ''}--reflector",
        )
    if config.reflector is not None and not np.isfinite(config.reflector).all():
        raise UserError(what="--reflector must be finite", got=config.reflector)
    low, high = config.delay_search
    if not -_MAX_SEARCH_M <= low < high <= _MAX_SEARCH_M:
        raise UserError(
            what="--delay-search must be two ascending lengths in metres",
            expected=f"within {_MAX_SEARCH_M:g} m",
            got=f"{low:g} {high:g}",
        )
    if config.channels is not None and config.channels < 2:
        raise UserError(what="--channels must be at least 2", got=config.channels)
    if config.channels is not None and config.no_channels:
        raise UserError(what="give either --channels or --no-channels", got="both")
    return CalibrationConfig(
        delay_from=source,
        reflector_m=config.reflector,
        frame=not config.no_frame,
        n_channels=config.channels,
        channels=not config.no_channels,
        positions=not config.no_positions,
        alignment=AlignmentConfig(delay_search_m=config.delay_search),
        autofocus=config.autofocus,
    )


def _print_table(table: CalibrationManifest, found: CalibratedCapture) -> None:
    sigma = table.path_bias_sigma_m
    pairs = [
        (
            "instrument delay",
            f"{table.path_bias_before_m:.4f} -> {table.path_bias_m:.4f}"
            + (f" +- {sigma:.4f}" if sigma is not None else "")
            + f" m on the two-way path ({table.delay_from})",
        )
    ]
    walls = found.walls
    if walls is not None:
        pairs.append(
            (
                "walls",
                f"{walls.n_echoes} echoes, {1e3 * walls.rms_before_m:.2f} -> "
                f"{1e3 * walls.rms_after_m:.2f} mm rms about the prior",
            )
        )
        if table.prior_to_capture is not None:
            pairs += _frame_rows(walls)
    pairs.append(("channel phases", _channel_text(found)))
    pairs.append(("positions", _drift_text(found)))
    rows(pairs)


def _frame_rows(walls: WallAlignment) -> list[tuple[str, str]]:
    turn, turn_sigma = np.rad2deg(walls.rotation_rad), np.rad2deg(walls.rotation_sigma_rad)
    shift, shift_sigma = 1e3 * walls.translation_m, 1e3 * walls.translation_sigma_m
    axis, axis_sigma = 1e3 * walls.axis_shift_m, 1e3 * walls.axis_shift_sigma_m
    return [
        ("prior turned by", _measured(turn, turn_sigma, ".2f") + " degrees about x, y, z"),
        ("prior moved by", _measured(shift, shift_sigma, ".1f") + " mm"),
        (
            "turntable axis",
            _measured(axis, axis_sigma, ".1f") + " mm towards the radar, across (true - recorded)",
        ),
        ("turntable angles", f"at most {np.rad2deg(np.abs(walls.angles_rad).max()):.2f} degrees"),
    ]


def _measured(values: np.ndarray, sigmas: np.ndarray, form: str) -> str:
    return ", ".join(
        f"{v:{form}} +- {s:{form}}" if s > 0 else "held"
        for v, s in zip(values, sigmas, strict=True)
    )


def _channel_text(found: CalibratedCapture) -> str:
    channels = found.channels
    if channels is None:
        return "no channels to tell apart; --channels N says how many take turns"
    rms = np.rad2deg(np.sqrt(np.mean(channels.phases_rad**2)))
    sigma = np.rad2deg(channels.sigma_rad.max())
    text = (
        f"{len(channels.phases_rad)} channels, {rms:.1f} degrees rms +- {sigma:.1f}, coherence "
        f"{channels.coherence_before:.3f} -> {channels.coherence_after:.3f}"
    )
    return text if found.channels_applied else text + "; not significant, left alone"


def _drift_text(found: CalibratedCapture) -> str:
    drift = found.drift
    if drift is None:
        return "left alone"
    text = (
        f"{1e3 * drift.rms_m(found.capture):.2f} mm rms +- {1e3 * drift.sigma_m:.2f}, coherence of "
        f"other echoes {drift.coherence_before:.3f} -> {drift.coherence_after:.3f}"
    )
    return text if found.drift_applied else text + "; not significant, left alone"
