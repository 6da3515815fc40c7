"""`geraf2 calibrate`: delay, channel phases, frame, axis and antenna positions of a scene."""

import shutil
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from geraf2 import __version__
from geraf2.calibration.autofocus import AutofocusConfig
from geraf2.calibration.calibration import (
    CalibratedCapture,
    CalibrationConfig,
    DelaySource,
    calibrate,
)
from geraf2.calibration.wall_alignment import AlignmentConfig, WallAlignment
from geraf2.cli._console import (
    CONSOLE,
    Positional,
    Threads,
    print_findings,
    progress_bar,
    require_threads,
    rows,
    say,
    warn,
)
from geraf2.cli._fields import Arg
from geraf2.errors import UserError
from geraf2.io.container import LOS_NAME, MANIFEST_NAME, RADAR_NAME
from geraf2.io.manifest import CalibrationManifest
from geraf2.io.mesh import TriangleMesh, write_mesh
from geraf2.pipeline.prior import PriorSource, Triple, load_prior
from geraf2.scene import Capture, load_capture, save_capture
from geraf2.scene.checks import require_plausible
from geraf2.scene.summary import summarize_capture

FIGURE_NAME = "calibration.png"
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
    los = config.los
    if los is None and config.box is None:
        los = config.scene / LOS_NAME if (config.scene / LOS_NAME).is_file() else None
    capture = load_capture(config.scene)
    print_findings(require_plausible(summarize_capture(capture), config.scene))
    source = PriorSource(los=los, box=config.box, box_center=config.box_center)
    prior, prior_name = load_prior(source, capture.walls, CONSOLE)
    with progress_bar("calibrating") as report:
        found = calibrate(capture, prior, settings, num_threads=num_threads, progress=report)
    table = _table(config, capture, found, str(prior_name))
    _print_table(table, found)
    target = config.scene if config.write else config.out
    if target is None:
        say("nothing was written: give OUT, or --write to correct the scene itself")
        return 0
    done = (*capture.calibration, table)
    _write(config.scene, target, replace(found.capture, calibration=done), found, config)
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


def _table(
    config: Config, before: Capture, found: CalibratedCapture, prior_name: str
) -> CalibrationManifest:
    walls, channels, drift = found.walls, found.channels, found.drift
    settings = _settings(config)
    sigma = None
    if found.curve is not None:
        sigma = found.curve.sigma_m
    elif walls is not None and settings.delay_from == "walls":
        sigma = walls.delay_sigma_m
    values: dict[str, object] = {
        "scene": config.scene.resolve().name,
        "prior": Path(prior_name).name if config.box is None else prior_name,
        "software": f"geraf2 {__version__}",
        "delay_from": settings.delay_from,
        "path_bias_before_m": before.waveform.path_bias_m,
        "path_bias_m": found.capture.waveform.path_bias_m,
        "path_bias_sigma_m": sigma,
    }
    if walls is not None:
        values |= {
            "n_wall_echoes": walls.n_echoes,
            "wall_rms_before_m": walls.rms_before_m,
            "wall_rms_m": walls.rms_after_m,
        }
        if settings.frame:
            values |= _frame_values(walls)
    if channels is not None and found.channels_applied:
        n = config.channels
        values |= {
            "channels": f"antenna index modulo {n}" if n else "offset of receiver from transmitter",
            "channel_phases_rad": channels.phases_rad.tolist(),
            "channel_phase_sigmas_rad": channels.sigma_rad.tolist(),
        }
    if drift is not None:
        values |= {"coherence_before": drift.coherence_before, "coherence": drift.coherence_before}
        if found.drift_applied:
            values |= {
                "position_coefficients_m": drift.coefficients_m.tolist(),
                "position_sigma_m": drift.sigma_m,
                "coherence": drift.coherence_after,
            }
    return CalibrationManifest.model_validate(values)


def _frame_values(walls: WallAlignment) -> dict[str, object]:
    return {
        "prior_to_capture": walls.prior_to_capture.tolist(),
        "prior_rotation_sigma_rad": walls.rotation_sigma_rad.tolist(),
        "prior_translation_sigma_m": walls.translation_sigma_m.tolist(),
        "axis_shift_m": walls.axis_shift_m.tolist(),
        "axis_shift_sigma_m": walls.axis_shift_sigma_m.tolist(),
        "pose_angle_changes_rad": walls.angles_rad.tolist(),
    }


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


def _write(
    source: Path, target: Path, capture: Capture, found: CalibratedCapture, config: Config
) -> None:
    from geraf2.report.calibration import calibration_figure  # noqa: PLC0415 - matplotlib: 0.5 s

    def write_extras(folder: Path) -> None:
        kept = {MANIFEST_NAME, RADAR_NAME, LOS_NAME, LOS_NAME + ".json", FIGURE_NAME}
        for entry in sorted(source.iterdir()):
            if entry.name in kept or entry.is_symlink():
                continue
            copy = shutil.copytree if entry.is_dir() else shutil.copy2
            copy(entry, folder / entry.name)
        mesh = TriangleMesh(vertices=found.prior.vertices, faces=found.prior.faces)
        write_mesh(mesh, folder / LOS_NAME, frame=capture.frame)
        calibration_figure(found, folder / FIGURE_NAME)

    if capture.walls and found.walls is not None and not config.no_frame:
        warn("walls in scene.toml keep their place; the moved box is in los.ply")
    with progress_bar("writing"):
        save_capture(
            capture, target, overwrite=config.write or config.overwrite, extras=write_extras
        )
    rows(
        [
            ("scene", str(target)),
            ("box", str(target / LOS_NAME)),
            ("picture", str(target / FIGURE_NAME)),
            ("next", f"geraf2 reconstruct {target} RUN --los {target / LOS_NAME}"),
        ]
    )
