"""`geraf2 reconstruct`: the surface of what is hidden in the box."""

import webbrowser
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from geraf2._bounds import Arg
from geraf2.cli._console import CONSOLE, keep, threads, warn
from geraf2.cli._fields import Positional, part_of, values_of
from geraf2.cli._flags import help_text, value_of
from geraf2.cli._outcome import print_found, print_next, print_verdict
from geraf2.errors import UserError, lacks_memory
from geraf2.io.objects import is_remote
from geraf2.pipeline.box_check import BOX_STAGE
from geraf2.pipeline.commands.reconstruct import reconstruct
from geraf2.pipeline.presets import BestPreset, PresetConfig, preset_type, step_names
from geraf2.pipeline.prior import PriorSource
from geraf2.pipeline.reconstruction import Reconstruction
from geraf2.pipeline.run_record import RunOptions, RunRecord


@dataclass(frozen=True, kw_only=True)
class Config(RunOptions, PriorSource):
    """Reconstruct the surface of what is hidden in the box; box and content in metres.

    The last lines say how far the result can be trusted. Exit code 2: an input cannot be used; with
    --strict 3: the result is not to be trusted. For example: geraf2 reconstruct scene out
    """

    scene: Positional[Annotated[Path, Arg(metavar="SCENE")]]
    """Scene folder."""
    out: Positional[Annotated[Path, Arg(metavar="OUT")]] = Path("out")
    """Run folder for meshes, fields, report, log."""
    preset: Annotated[str, Arg(metavar="NAME")] = "best"
    """best: seconds. fast: coarser, in two thirds of the time. paper: the learned method, minutes
    to an hour; paper-corrected: its level corrected. To compare with: geraf1, matched-filter,
    normal-field, back-projection."""
    config: Annotated[Path | None, Arg(metavar="FILE")] = None
    """config.toml of a run that is to be repeated; flags go before it."""
    help_preset: Annotated[str | None, Arg(metavar="NAME")] = None
    """Show the constants of a preset, each a flag, and stop."""
    resume: bool = False
    """Continue the training that a stopped run left in OUT; only for presets that train."""
    overwrite: bool = False
    """Replace a finished result in OUT that has other settings or is of another scene."""
    no_report: bool = False
    """Leave out the report and its pictures."""
    strict: bool = False
    """Exit with code 3 if the result is not to be trusted."""
    open: bool = False
    """Open the report in a browser at the end."""
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
    settings = record.config if same else preset_type(str(preset))()
    values = {**values_of(record.options), "settings": settings}
    if value_of("--los", arguments) is None and value_of("--box", arguments) is None:
        if record.prior.los is not None and is_remote(record.prior.los):
            raise UserError(
                what="names an object store, which only the command line may",
                where=file,
                got=f"los = {str(record.prior.los)!r}",
                hint="give it by --los",
            )
        values |= values_of(record.prior)
    return values


def main(config: Config) -> int:
    """Run the command."""
    if config.open and config.no_report:
        raise UserError(what="--open and --no-report exclude each other")
    with CONSOLE.show_as_one(_steps(config)):
        result = reconstruct(
            config.scene,
            part_of(config, PriorSource),
            config.settings,
            config.out,
            options=part_of(config, RunOptions),
            resume=config.resume,
            overwrite=config.overwrite,
            report=not config.no_report,
            num_threads=threads(),
            listener=CONSOLE,
        )
    try:
        _print_outcome(result)
    except Exception as error:
        if not lacks_memory(error):
            raise
        warn(f"{result.path} is whole, but memory ran out before it was described")
    page = result.report if config.open else None
    if page is not None and not webbrowser.open(page.resolve().as_uri()):
        warn(f"no browser opened; the report is {page}")
    return print_verdict(result.verdict, strict=config.strict)


# Users' words for each step, and its usual share of the time.
_STEPS = {
    BOX_STAGE: ("finding the box", 1.0),
    "calibration": ("checking the calibration", 3.0),
    "prior": ("finding echoes in the box", 2.0),
    "glints": ("finding echoes of the content", 1.0),
    "outlines": ("finding outlines on the far walls", 1.0),
    "sdf": ("fitting the surface", 1.5),
    "baseline": ("computing the image", 3.0),
    "train": ("training", 60.0),
    "mesh": ("drawing the surface", 1.0),
    "samples": ("drawing samples of the surface", 1.0),
    "report": ("drawing the report", 2.0),
}


def _steps(config: Config) -> dict[str, tuple[str, float]]:
    names = {BOX_STAGE, "prior", *step_names(config.settings)}
    names |= {"calibration"} if config.calibrate == "auto" else set()
    names |= set() if config.no_report else {"report"}
    names |= {"samples"} if config.samples else set()
    return {name: entry for name, entry in _STEPS.items() if name in names}


def _print_outcome(result: Reconstruction) -> None:
    print_found(result)
    keep({"seconds": {name: record.seconds for name, record in result.run.stages.items()}})
    print_next(result)
