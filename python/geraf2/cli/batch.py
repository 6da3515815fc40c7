"""`geraf2 batch`: many scenes on many processes."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from geraf2._bounds import Arg
from geraf2.apps.batch import BatchFolder, BatchRequest, run
from geraf2.apps.batch.plan import Plan
from geraf2.cli._console import err, rows
from geraf2.cli._fields import Positional
from geraf2.cli.reconstruct import defaults
from geraf2.pipeline.presets import BestPreset, PresetConfig

__all__ = ["Config", "defaults", "main"]


@dataclass(frozen=True, kw_only=True)
class Config(BatchRequest):
    """Reconstruct many scenes; run it again to continue where it stopped.

    For example: geraf2 batch scans/* out --box 0.22 0.22 0.22
    """

    scenes: Positional[Annotated[tuple[str, ...], Arg(metavar="SCENES")]]
    """Scene folders, patterns of them, CSV tables: scene, box, prior, truth, preset, settings."""
    out: Positional[Annotated[Path, Arg(metavar="OUT")]]
    """Folder for runs/, results/, batch.html and batch.csv."""
    settings: Annotated[PresetConfig, Arg(name="", hidden=True)] = field(default_factory=BestPreset)


def main(config: Config) -> int:
    """Run the command; exit code 2 if a scene failed."""
    jobs = config.jobs(config.scenes, config.settings)
    if not config.list:
        run(jobs, config.out, on_result=lambda result: err.print(result.line), options=config)
    plan = Plan.of(jobs, BatchFolder(config.out), report=config.report)
    rows(plan.listed() if config.list else plan.outcome())
    return 2 if plan.n_failed else 0
