"""`geraf2 calibrate`: delay, channel phases, frame, axis and antenna positions of a scene."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from geraf2._bounds import Arg, ChannelCount, SignedM
from geraf2.calibration.driver import CalibrationConfig
from geraf2.calibration.wall_alignment import AlignmentConfig
from geraf2.cli._console import CONSOLE, keep, rows, say, threads
from geraf2.cli._fields import Positional, part_of
from geraf2.errors import UserError
from geraf2.io.container import LOS_NAME, read_scene_manifest
from geraf2.pipeline.commands.calibrate import calibrate, require_room
from geraf2.pipeline.prior import PriorSource

_MAX_SEARCH_M = 20.0


@dataclass(frozen=True, kw_only=True)
class Config(PriorSource):
    """Find errors of a scan's geometry and phases; writes a corrected scene, or reports them.

    It searches for leakage, the instrument delay, phases of channels, the position of the box, and
    slow errors of the antennas' positions. A correction that held-out echoes do
    not confirm is not applied. Nothing is written without OUT, which may be SCENE itself, with
    --overwrite.
    """

    scene: Positional[Annotated[Path, Arg(metavar="SCENE")]]
    """Scene folder."""
    out: Positional[Annotated[Path | None, Arg(metavar="[OUT]")]] = None
    """Corrected scene to make, with the box as los.ply."""
    overwrite: bool = False
    """Replace another scene in OUT, or SCENE itself."""
    los: Annotated[Path | None, Arg(metavar="MESH")] = None
    """Closed mesh of the outside of the box, metres; los.ply of the scene, or the box that it
    states, when not given."""
    no_delay: bool = False
    """Leave the instrument delay."""
    delay_search: Annotated[tuple[SignedM, SignedM] | None, Arg(metavar="LOW HIGH")] = None
    """Change of the delay that is searched, on the two-way path [m]; -0.048 0.048 when not given,
    and any delay of 0 to 0.6 where none was recorded and the box is no cuboid."""
    no_frame: bool = False
    """Leave the box where it is."""
    channels: Annotated[ChannelCount | None, Arg(metavar="N")] = None
    """Antenna i of a plane is of channel i modulo N; found from the offset of receiver from
    transmitter, else from the phases, when not given."""
    no_channels: bool = False
    """Leave the phases of channels."""
    no_positions: bool = False
    """Leave the antennas' positions."""


def main(config: Config) -> int:
    """Run the command."""
    settings = _settings(config)
    read_scene_manifest(config.scene)  # a missing scene is reported before a missing prior
    target = config.out
    require_room(config.scene, target, overwrite=config.overwrite)
    los = config.los
    if los is None and config.box is None and (config.scene / LOS_NAME).is_file():
        los = config.scene / LOS_NAME
    calibrated = calibrate(
        config.scene,
        replace(part_of(config, PriorSource), los=los),
        settings,
        num_threads=threads(),
        listener=CONSOLE,
    )
    rows(calibrated.rows())
    keep({"scene": None if target is None else str(target), **calibrated.table.model_dump()})
    prior = calibrated.found.prior
    keep({"box": {"size_m": prior.size_m, "center_m": prior.center_m}})
    if target is None:
        say("nothing was written: give OUT, or SCENE twice and --overwrite to correct it")
        return 0
    calibrated.save(target, overwrite=config.overwrite, listener=CONSOLE)
    rows(
        [
            ("scene", str(target)),
            ("box", str(target / LOS_NAME)),
            ("next", f"geraf2 reconstruct {target} RUN --los {target / LOS_NAME}"),
        ]
    )
    return 0


def _settings(config: Config) -> CalibrationConfig:
    if config.no_delay and config.delay_search is not None:
        raise UserError(what="give either --no-delay or --delay-search", got="both")
    if config.no_delay and config.no_frame and config.no_channels and config.no_positions:
        raise UserError(
            what="nothing is left to search for",
            got="--no-delay --no-frame --no-channels --no-positions",
        )
    low, high = config.delay_search or (-1.0, 1.0)
    if not -_MAX_SEARCH_M <= low < high <= _MAX_SEARCH_M:
        raise UserError(
            what="--delay-search must be two ascending lengths in metres",
            expected=f"within {_MAX_SEARCH_M:g} m",
            got=f"{low:g} {high:g}",
        )
    if config.channels is not None and config.no_channels:
        raise UserError(what="give either --channels or --no-channels", got="both")
    return CalibrationConfig(
        delay=not config.no_delay,
        frame=not config.no_frame,
        n_channels=config.channels,
        channels=not config.no_channels,
        positions=not config.no_positions,
        alignment=AlignmentConfig(delay_search_m=config.delay_search),
    )
