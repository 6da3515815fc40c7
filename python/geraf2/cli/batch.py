"""`geraf2 batch`: many scenes on many processes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from geraf2.batch import BatchFolder, BatchOptions, JobResult, read_jobs, run
from geraf2.batch.plan import Plan
from geraf2.cli._console import err, rows
from geraf2.cli._fields import Arg, Positional
from geraf2.cli.reconstruct import defaults as _defaults
from geraf2.pipeline.presets import GlintPreset, PresetConfig
from geraf2.pipeline.prior import Triple


@dataclass(frozen=True, kw_only=True)
class Config:
    """Reconstruct many scenes; run it again to go on where it stopped.

    For example: geraf2 batch scans/* out --box 0.22 0.22 0.22
    """

    scenes: Positional[Annotated[tuple[str, ...], Arg(metavar="SCENES")]]
    """Scene folders, patterns of them, CSV tables: scene, box, prior, truth, preset, settings."""
    out: Positional[Annotated[Path, Arg(metavar="OUT")]]
    """Folder for runs/, results/, batch.html and batch.csv."""
    los: Annotated[Path | None, Arg(metavar="MESH|PHOTOS")] = None
    """Outside of all boxes, as of `geraf2 reconstruct`; a scene's own los.ply when not given."""
    box: Annotated[Triple | None, Arg(metavar="X Y Z")] = None
    """Or the outer side lengths of all boxes [m]."""
    preset: Annotated[str, Arg(metavar="NAME")] = "glint"
    """As of `geraf2 reconstruct`."""
    config: Annotated[Path | None, Arg(metavar="FILE")] = None
    """config.toml of a run, for its preset and constants; flags go before it."""
    list: bool = False
    """List what is done, and what is left with the processor time that it will take, and stop."""
    batch: Annotated[BatchOptions, Arg(name="")] = field(default_factory=BatchOptions)
    settings: Annotated[PresetConfig, Arg(name="", hidden=True)] = field(
        default_factory=GlintPreset
    )


def defaults(arguments: Sequence[str]) -> Mapping[str, Any]:
    """Constants that flags start from."""
    return {"settings": _defaults(arguments)["settings"]}


def main(config: Config) -> int:
    """Run the command; exit code 2 if a scene failed."""
    jobs = read_jobs(config.scenes, los=config.los, box=config.box, config=config.settings)
    if config.list:
        plan = Plan.of(jobs, BatchFolder(config.out), report=config.batch.report)
        rows(plan.listed())
        return 0

    def told(result: JobResult) -> None:
        err.print(f"{result.scene}: {result.state}{': ' * bool(result.error)}{result.error}")

    results = run(jobs, config.out, on_result=told, options=config.batch)
    rows(Plan.of(jobs, BatchFolder(config.out)).listed()[-1:])
    rows([("page", str(config.out / "batch.html"))])
    return 2 if any(result.state != "done" for result in results) else 0
