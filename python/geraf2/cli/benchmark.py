"""`geraf2 benchmark`: tables of methods over simulated scenes."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import count
from pathlib import Path
from typing import Annotated

from geraf2._bounds import Arg, Seed, ThreadCount
from geraf2.apps.benchmark import (
    Row,
    RowResult,
    Runner,
    Suite,
    load_suite,
    population,
    rows_of,
    write_pages,
)
from geraf2.apps.benchmark.pages import MARKDOWN_NAME
from geraf2.cli._console import CONSOLE, keep, progress_bar, rows, say, threads, warn
from geraf2.cli._fields import Positional
from geraf2.errors import UserError
from geraf2.io.atomic import write_json_atomic
from geraf2.io.outputs import require_folder
from geraf2.pipeline.estimates import n_threads
from geraf2.pipeline.presets import preset_type

_MARKER_NAME = "benchmark.json"
_OF_POPULATION = ("seeds", "against", "cache", "presets")
_OF_SUITE = ("quick", "scenes", "cases", "methods", "list", "suite", "seed")


@dataclass(frozen=True, kw_only=True)
class Config:
    """Simulate scenes, reconstruct them with every method, and write tables and a page.

    Scenes and results are kept: run again to continue where it stopped, or after a change to make
    again what depends on it.
    """

    out: Positional[Annotated[Path, Arg(metavar="OUT")]]
    """Folder for scenes/, runs/, benchmark.md and benchmark.html."""
    quick: bool = False
    """A short form: fewer planes, antennas and rows; minutes."""
    only: Annotated[tuple[str, ...], Arg(metavar="NAME ...")] = ()
    """Experiments to run; all but the ladder of the world's effects when not given."""
    scenes: Annotated[tuple[str, ...], Arg(metavar="SCENE ...")] = ()
    """Of these experiments, only these scenes: names, or patterns such as 'bunny*'."""
    cases: Annotated[tuple[str, ...], Arg(metavar="CASE ...")] = ()
    """Only these cases: labels, or patterns such as 'everything*'."""
    methods: Annotated[tuple[str, ...], Arg(metavar="METHOD ...")] = ()
    """Only these methods: names, or patterns such as '*-raw'."""
    list: bool = False
    """List experiments, how many rows each has, and how many were made in what processor time, and
    stop."""
    jobs: ThreadCount = 1
    """Rows at a time, on dask workers of this machine; each gets its share of the threads."""
    scheduler: str | None = None
    """Address of a running dask scheduler instead, tcp://HOST:PORT, whose workers see the same OUT
    and have the same geraf2."""
    suite: Annotated[Path | None, Arg(metavar="SUITE.toml")] = None
    """Scenes and experiments of your own."""
    seeds: Annotated[str | None, Arg(metavar="A:B")] = None
    """With --only population or ordinary: seeds A to B - 1. From 0 they are for estimating, from
    1000 for deciding, of the population from 10000 on for claims alone."""
    presets: Annotated[tuple[str, ...], Arg(metavar="PRESET ...")] = ()
    """With these: presets to compare, the first is the reference; fast when not given."""
    against: Annotated[Path | None, Arg(metavar="OTHER_OUT")] = None
    """With these: paired differences against the results in another OUT, as of another commit."""
    cache: Annotated[Path | None, Arg(metavar="FOLDER")] = None
    """With these: folder of the simulated scenes, which several OUT may share; OUT when not
    given."""
    seed: Annotated[Seed, Arg(hidden=True)] = 0
    """Of scenes, reconstructions and samples."""


def main(config: Config) -> int:
    """Run the command; exit code 2 if a row failed."""
    if any(name in population.SETS for name in config.only):
        return _by_seed(config)
    _require_unset(config, "is for --only population or ordinary", _OF_POPULATION)
    suite = load_suite(config.suite, quick=config.quick)
    choice = {"scene": config.scenes, "case": config.cases, "method": config.methods}
    todo = rows_of(suite, config.only, choice)
    share = max(1, n_threads() // config.jobs) if config.jobs > 1 else None
    runner = Runner(out=config.out, seed=config.seed, num_threads=threads() or share)
    everything = rows_of(suite, tuple(suite.experiments))
    is_chosen = bool(config.only) or any(choice.values())
    if config.list:
        rows(_listed(suite, runner, todo if is_chosen else everything))
        return 0
    _open_folder(config)
    start, done = time.perf_counter(), count(1)

    def report(row: Row, result: RowResult) -> None:
        CONSOLE.note(f"{next(done)}/{len(todo)}  {row.name}: {result}")

    results = runner.run_all(todo, report, jobs=config.jobs, scheduler=config.scheduler)
    now = {row.name: result for row, result in results}
    # Tables that earlier runs made are shown, too.
    pairs = [(row, now.get(row.name) or runner.known(row)) for row in everything]
    shown = [(row, result) for row, result in pairs if result is not None]
    page = write_pages(config.out, suite, shown)
    failed = sum(result.error is not None for _, result in results)
    seconds = time.perf_counter() - start
    keep({"n_rows": len(results), "n_failed": failed, "seconds": seconds, "page": str(page)})
    keep({"tables": str(config.out / MARKDOWN_NAME)})
    rows(
        [
            ("rows", f"{len(results)}, of which {failed} failed"),
            ("tables", str(config.out / MARKDOWN_NAME)),
            ("page", str(page)),
            ("time", f"{seconds:.0f} s"),
        ]
    )
    return 2 if failed else 0


def _listed(suite: Suite, runner: Runner, todo: Sequence[Row]) -> list[tuple[str, str]]:
    """Names of experiments with their rows, and the processor time of those that were made."""
    texts = []
    for name in dict.fromkeys(row.experiment for row in todo):
        own = [runner.known(row) for row in todo if row.experiment == name]
        spent = [r.all_cpu_seconds or 0.0 for r in own if r is not None and r.error is None]
        made = f", {len(spent)} made in {sum(spent) / 60.0:.1f} CPU minutes" if spent else ""
        texts.append((name, f"{suite.experiments[name].title} ({len(own)} rows{made})"))
    return texts


def _open_folder(config: Config) -> None:
    if config.jobs > 1 and config.scheduler is not None:
        raise UserError(what="give either --jobs or --scheduler", got="both")
    require_folder(config.out, "benchmark", own=(config.out / _MARKER_NAME).is_file())
    marker = {"format": "geraf2-benchmark", "format_version": 1}
    write_json_atomic(config.out / _MARKER_NAME, marker)


def _require_unset(config: Config, why: str, names: tuple[str, ...]) -> None:
    for name in names:
        if getattr(config, name) != getattr(type(config), name):
            raise UserError(what=f"--{name} {why}", where="benchmark")


def _by_seed(config: Config) -> int:
    """Presets on seeds of the population or of ordinary objects, as a table on the terminal."""
    if len(config.only) > 1:
        what = f"--only {next(n for n in config.only if n in population.SETS)} runs alone"
        raise UserError(what=what, got=" ".join(config.only), hint="run each by itself")
    scenes = population.SETS[config.only[0]]
    _require_unset(config, f"does not go with --only {scenes.name}", _OF_SUITE)
    if config.seeds is None:
        raise UserError(what=f"--only {scenes.name} needs --seeds A:B", hint=scenes.example)
    seeds = population.parse_seeds(config.seeds)
    presets = tuple(dict.fromkeys(config.presets or ("fast",)))
    for preset in presets:
        preset_type(preset)
    others = population.results_against(config.against, scenes) if config.against else []
    _open_folder(config)
    if population.is_reserved(seeds):
        warn(f"seeds from {population.RESERVED_SEED} on are reserved for claims")
    share = max(1, n_threads() // config.jobs) if config.jobs > 1 else None
    runner = Runner(out=config.out, num_threads=threads() or share, cache=config.cache)
    task = population.Population(runner=runner, presets=presets, scenes=scenes)
    total, done = len(seeds) * len(presets), count(1)
    with progress_bar(scenes.name) as progress:
        progress(0.0)

        def report(row: Row, result: RowResult) -> None:
            CONSOLE.note(f"{row.name}: {result}")
            progress(next(done) / total)

        results = task.run(seeds, report, jobs=config.jobs, scheduler=config.scheduler)
    keep({"results": [asdict(result) for result in results]})
    records = population.records_of(config.cache or config.out, scenes)
    for line in population.tables(results, presets, records, others).splitlines():
        say(line)
    return 0
