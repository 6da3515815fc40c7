"""`geraf2 reconstruct`: the surface of what is hidden in the box."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from geraf2._bounds import CountOrZero, Degrees, Seed, Sides, Triple
from geraf2.cli._console import CONSOLE, Threads, rows, say, showing_log_records
from geraf2.cli._fields import Arg, Positional
from geraf2.cli._flags import help_text, value_of
from geraf2.errors import UserError
from geraf2.io.run_folder import BOX_NAME, CONTENT_NAME, LOG_NAME, MESH_NAME, SAMPLES_NAME
from geraf2.pipeline.commands.reconstruct import reconstruct
from geraf2.pipeline.los_options import LosOptions
from geraf2.pipeline.presets import BestPreset, PresetConfig, preset_type
from geraf2.pipeline.prior import PriorSource
from geraf2.pipeline.reconstruction import Reconstruction
from geraf2.pipeline.run_record import RunOptions, RunRecord
from geraf2.surfaces.samples import size_lines


@dataclass(frozen=True, kw_only=True)
class Config:
    """Reconstruct the surface of what is hidden in the box; box and content in metres.

    For example: geraf2 reconstruct scene out --box 0.22 0.22 0.22
    """

    scene: Positional[Annotated[Path, Arg(metavar="SCENE")]]
    """Scene folder."""
    out: Positional[Annotated[Path, Arg(metavar="OUT")]]
    """Run folder for meshes, fields, report, log."""
    los: Annotated[Path | None, Arg(metavar="MESH|PHOTOS")] = None
    """Outside of the box: a closed mesh (metres, the scene's frame), a folder of `geraf2 los`, or
    photos with poses, from which a surface is trained first."""
    box: Annotated[Sides | None, Arg(metavar="X Y Z")] = None
    """Or the outer side lengths of the box, axes along the frame's [m]."""
    box_center: Annotated[Triple, Arg(metavar="X Y Z")] = (0.0, 0.0, 0.0)
    """Where the middle of --box lies [m]."""
    preset: Annotated[str, Arg(metavar="NAME")] = "best"
    """best: 20 seconds of a core. fast: coarser, 5. paper: the learned method, minutes to an
    hour; paper-corrected: its level corrected. To compare with: geraf1, matched-filter,
    normal-field, back-projection."""
    config: Annotated[Path | None, Arg(metavar="FILE")] = None
    """config.toml of a run that is to be repeated; flags go before it."""
    help_preset: Annotated[str | None, Arg(metavar="NAME")] = None
    """Show the constants of a preset, each a flag, and stop."""
    hold_out: Annotated[tuple[Degrees, ...], Arg(metavar="DEG ...")] = ()
    """Turntable angles of planes that are left out, for `geraf2 render` [degrees]."""
    calibrate: Literal["auto", "no"] = "auto"
    """auto: find leakage, channels, delay, box, axis and positions that are wrong and correct them,
    where held-out data confirm it. no: take the scene as it is."""
    trust_los: bool = False
    """Continue even if most of the echoes come from outside the box."""
    resume: bool = False
    """Keep the stages in OUT that are done and would come out the same."""
    overwrite: bool = False
    """Replace a finished result in OUT that has other settings or is of another scene."""
    no_report: bool = False
    """Leave out the report and its pictures."""
    samples: Annotated[CountOrZero, Arg(metavar="N")] = 0
    """Also write so many surfaces that the scan allows, into samples.npz."""
    seed: Seed = 0
    """Seed of the samples that `evaluate` draws, of training and of the fit to heat maps."""
    threads: Threads = None
    """Threads to use; all when not given."""
    photos: Annotated[LosOptions, Arg(see="geraf2 los")] = field(default_factory=LosOptions)
    """Options of the photos of --los."""
    settings: Annotated[PresetConfig, Arg(name="", hidden=True)] = field(default_factory=BestPreset)
    """Constants of the preset."""


def defaults(arguments: Sequence[str]) -> Mapping[str, Any]:
    """Default values of flags: of the chosen preset, or of a run to be repeated."""
    shown = value_of("--help-preset", arguments)
    if shown is not None:
        settings, prog = preset_type(shown)(), "geraf2 reconstruct SCENE OUT --preset " + shown
        about, start = (settings.__doc__ or "").partition("\n\n")[0], {"settings": settings}
        print(help_text(Config, prog=prog, description=about, default=start, hidden=True))
        raise SystemExit(0)
    preset, file = value_of("--preset", arguments), value_of("--config", arguments)
    if file is None:
        return {"settings": preset_type(preset or "best")()}
    record = RunRecord.read(Path(file))
    same = preset is None or preset == record.config.preset
    values: dict[str, Any] = {
        name: getattr(record.options, name)
        for name in ("hold_out", "calibrate", "trust_los", "seed", "samples")
    }
    values |= {
        "photos": record.options.photos,
        "settings": record.config if same else preset_type(str(preset))(),
    }
    if value_of("--los", arguments) is None and value_of("--box", arguments) is None:
        prior = record.prior
        values |= {"los": prior.los, "box": prior.box, "box_center": prior.box_center}
    return values


def main(config: Config) -> int:
    """Run the command."""
    if (config.los is None) == (config.box is None):
        raise UserError(
            what="give the outside of the box",
            expected="either --los MESH or --box X Y Z",
            got="both" if config.los is not None else "neither",
        )
    with showing_log_records():
        result = reconstruct(
            config.scene,
            PriorSource(los=config.los, box=config.box, box_center=config.box_center),
            config.settings,
            config.out,
            options=RunOptions(
                hold_out=config.hold_out,
                calibrate=config.calibrate,
                trust_los=config.trust_los,
                seed=config.seed,
                samples=config.samples,
                photos=config.photos,
            ),
            resume=config.resume,
            overwrite=config.overwrite,
            report=not config.no_report,
            num_threads=config.threads,
            listener=CONSOLE,
        )
    _print_outcome(result)
    return 0


def _print_outcome(result: Reconstruction) -> None:
    seconds = {name: record.seconds for name, record in result.run.stages.items()}
    say("stages   " + ", ".join(f"{name} {value:.1f} s" for name, value in seconds.items()))
    report = [("report", str(result.report))] if "report" in seconds else []
    names = [("content", CONTENT_NAME), ("box", BOX_NAME), ("both", MESH_NAME)]
    if "samples" in seconds:
        names.append(("samples", SAMPLES_NAME))
    paths = [(label, str(result.path / name)) for label, name in names]
    rows(size_lines(result.numbers.get("mesh", {})))
    rows([*paths, *report, ("log", str(result.path / LOG_NAME))])
