"""`geraf2 batch`: many scenes on many processes."""

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated

from geraf2._bounds import Arg, Sides
from geraf2.apps.batch import BatchOptions, read_jobs, run
from geraf2.apps.batch.folder import DONE
from geraf2.cli._console import CONSOLE, keep, rows, threads
from geraf2.cli._fields import Positional
from geraf2.cli._outcome import EXIT_NO
from geraf2.cli.reconstruct import defaults
from geraf2.io.verdict import Trust
from geraf2.pipeline.presets import BestPreset, PresetConfig
from geraf2.pipeline.run_record import RunRecord

__all__ = ["Config", "defaults", "main"]


@dataclass(frozen=True, kw_only=True)
class Config(BatchOptions):
    """Reconstruct many scenes; run it again to continue where it stopped.

    Exit code 2: a scene failed; with --strict 3: a result is not to be trusted.

    For example: geraf2 batch scans/* out --box 0.22 0.22 0.22
    """

    scenes: Positional[Annotated[tuple[str, ...], Arg(metavar="SCENES")]]
    """Scene folders, patterns of them, CSV tables with columns scene, box, prior, truth."""
    out: Positional[Annotated[Path, Arg(metavar="OUT")]]
    """Folder for runs/, results/ and batch.html."""
    los: Path | None = None
    """Outside of all boxes, as of `geraf2 reconstruct`. When not given, it is a scene's own
    los.ply or the box that it states, or else found by radar."""
    box: Sides | None = None
    """Or the outer side lengths of all boxes [m]."""
    preset: str = "best"
    """As of `geraf2 reconstruct`, and so are its constants."""
    config: Path | None = None
    """config.toml of a run, for all settings but its scene; flags override it."""
    strict: bool = False
    """Exit with code 3 if a result is not to be trusted."""
    settings: Annotated[PresetConfig, Arg(name="", hidden=True)] = field(default_factory=BestPreset)


def main(config: Config) -> int:
    """Run the command; exit code 2 if a scene failed."""
    options = None if config.config is None else RunRecord.read(config.config).options
    jobs = read_jobs(
        config.scenes, los=config.los, box=config.box, config=config.settings, options=options
    )
    results = run(
        jobs,
        config.out,
        on_result=lambda result: CONSOLE.note(result.line),
        options=replace(config, threads=threads()),
    )
    n_failed = sum(result.state != DONE for result in results)
    totals = f"{len(results)} scenes, {len(results) - n_failed} done, {n_failed} failed"
    counts = {trust: sum(result.verdict == trust for result in results) for trust in Trust}
    verdicts = ", ".join(f"{count} {trust}" for trust, count in counts.items())
    judged = [("verdicts", verdicts)] if any(counts.values()) else []
    keep({"done": len(results) - n_failed, "failed": n_failed, "verdicts": counts})
    keep(
        {"results": [asdict(result) for result in results], "page": str(config.out / "batch.html")}
    )
    rows([("all", totals), *judged, ("page", str(config.out / "batch.html"))])
    is_strict = config.strict and counts[Trust.NOT_TO_BE_TRUSTED] > 0
    return 2 if n_failed else EXIT_NO if is_strict else 0
