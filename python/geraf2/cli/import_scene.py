"""`geraf2 import`: a capture of another format becomes a scene."""

from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Annotated

from geraf2._bounds import Arg
from geraf2.apps.importers import ImportOptions
from geraf2.apps.importers.import_capture import import_capture
from geraf2.cli._console import CONSOLE, keep, rows, say, threads
from geraf2.cli._fields import Positional
from geraf2.errors import UserError
from geraf2.io.manifest import RadarManifest, RasterManifest
from geraf2.io.toml import from_table, read_toml


@dataclass(frozen=True, kw_only=True)
class Config(ImportOptions):
    """Turn a capture of another format into a scene; checks it and finds the phase sign."""

    format: Positional[Annotated[str, Arg(metavar="FORMAT")]]
    """Format of the capture: dca1000, geraf-sens, mat, mmnorm, planar, rosbag, or a plug-in's."""
    source: Positional[Annotated[Path, Arg(metavar="SRC")]]
    """Folder or file of the capture."""
    scene: Positional[Annotated[Path, Arg(metavar="SCENE")]]
    """Folder to make."""
    radar: Path | None = None
    """TOML file with radar parameters that the capture lacks; they go before its own."""
    raster: Annotated[
        tuple[int, int, float, float] | None, Arg(metavar="ROWS COLUMNS ROW_STEP_M COLUMN_STEP_M")
    ] = None
    """The radar scanned a raster, row by row."""
    serpentine: bool = False
    """Every other row of the raster was scanned backwards."""
    overwrite: bool = False
    """Replace another scene in this folder."""


def main(config: Config) -> int:
    """Run the command."""
    imported = import_capture(
        config.format,
        config.source,
        config.scene,
        radar=_radar(config),
        options=config,
        overwrite=config.overwrite,
        num_threads=threads(),
        listener=CONSOLE,
    )
    summary = imported.summary
    keep({"scene": str(config.scene), "unchanged": imported.unchanged, **summary.numbers()})
    keep({"facts": dict(imported.facts), "phase_sign": 1 if imported.sign.is_positive else -1})
    keep({"phase_sign_evidence": imported.sign.evidence})
    rows(
        [
            *imported.facts,
            ("planes", str(len(summary.poses))),
            ("antennas", str(summary.n_antennas)),
            ("samples", str(summary.waveform.n_samples)),
            ("phase sign", str(imported.sign).removeprefix("phase sign ")),
            ("delay subtracted", f"{summary.waveform.path_bias_m:g} m on the two-way path"),
        ]
    )
    if imported.unchanged:
        say(f"{config.scene} already holds this scene, nothing changed")
    else:
        say(f"wrote {config.scene}")
    rows([("next", f"geraf2 info {quote(str(config.scene))}")])
    return 0


def _radar(config: Config) -> RadarManifest:
    """radar.toml, with the raster of the command line."""
    radar = read_toml(config.radar, RadarManifest) if config.radar else RadarManifest()
    if config.raster is None:
        if config.serpentine and radar.raster is None:
            raise UserError(what="--serpentine needs --raster")
        return radar
    names = ("n_rows", "n_columns", "row_step_m", "column_step_m")
    values = {**dict(zip(names, config.raster, strict=True)), "serpentine": config.serpentine}
    return radar.model_copy(update={"raster": from_table(values, RasterManifest, "--raster")})
