"""`geraf2 reconstruct`: the surface of what is hidden in the box."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from geraf2._bounds import Arg
from geraf2.cli._console import CONSOLE, Threads, rows, say, showing_log_records
from geraf2.cli._fields import Positional, part_of, values_of
from geraf2.cli._flags import help_text, value_of
from geraf2.errors import UserError
from geraf2.io.objects import is_remote
from geraf2.io.run_folder import BOX_NAME, CONTENT_NAME, LOG_NAME, MESH_NAME, SAMPLES_NAME
from geraf2.pipeline.commands.reconstruct import reconstruct
from geraf2.pipeline.presets import BestPreset, PresetConfig, preset_type
from geraf2.pipeline.prior import PriorSource
from geraf2.pipeline.reconstruction import Reconstruction
from geraf2.pipeline.run_record import RunOptions, RunRecord
from geraf2.surfaces.samples import size_lines


@dataclass(frozen=True, kw_only=True)
class Config(RunOptions, PriorSource):
    """Reconstruct the surface of what is hidden in the box; box and content in metres.

    For example: geraf2 reconstruct scene out
    """

    scene: Positional[Annotated[Path, Arg(metavar="SCENE")]]
    """Scene folder."""
    out: Positional[Annotated[Path, Arg(metavar="OUT")]]
    """Run folder for meshes, fields, report, log."""
    preset: Annotated[str, Arg(metavar="NAME")] = "best"
    """best: 10 seconds of a core. fast: coarser, 4. paper: the learned method, minutes to an
    hour; paper-corrected: its level corrected. To compare with: geraf1, matched-filter,
    normal-field, back-projection."""
    config: Annotated[Path | None, Arg(metavar="FILE")] = None
    """config.toml of a run that is to be repeated; flags go before it."""
    help_preset: Annotated[str | None, Arg(metavar="NAME")] = None
    """Show the constants of a preset, each a flag, and stop."""
    resume: bool = False
    """Keep the stages in OUT that are done and would come out the same."""
    overwrite: bool = False
    """Replace a finished result in OUT that has other settings or is of another scene."""
    no_report: bool = False
    """Leave out the report and its pictures."""
    threads: Threads = None
    """Threads to use; all when not given."""
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
    with showing_log_records():
        result = reconstruct(
            config.scene,
            part_of(config, PriorSource),
            config.settings,
            config.out,
            options=part_of(config, RunOptions),
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
