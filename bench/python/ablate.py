"""What each rule and each constant of a preset changes on seeds of the population.

    python bench/python/ablate.py OUT --seeds 1000:1040 [--presets fast best] [--only NAME ...]
        [--cache FOLDER] [--scenes N] [--screen N] [--limit F1] [--jobs N] [--quick] [--table]

A field of the config that is on or off is switched off. A number is set to 0, halved and doubled,
where its bounds allow it; an option that knows "no" is set to it. Constants of modules, as
`constants.py` finds them, are halved and doubled, too; what other constants are computed from them
on import does not change. `--only` chooses constants by name or by a pattern, as 'fit.*'.

First --screen scenes are run. What changes the mean F1 at 5 mm by more than --limit there is
needed, and stops; the others continue on all scenes. Results are kept line by line in
OUT/ablation.jsonl: a run continues where it stopped, and can be done in pieces. A change with
which all scenes end with an error has that error in its line.
"""

import argparse
import contextlib
import importlib
import logging
import multiprocessing
import sys
import time
import typing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, fields, is_dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

import geraf2
from constants import config_fields, module_constants
from geraf2.apps.benchmark import Row, Runner
from geraf2.apps.benchmark.making import population_scores
from geraf2.apps.benchmark.population import (
    Population,
    append_result,
    parse_seeds,
    read_results,
)
from geraf2.apps.benchmark.population_table import SeedResult, mean_interval, quantile_change
from geraf2.errors import UserError
from geraf2.io.container import LOS_NAME, TRUTH_NAME
from geraf2.io.mesh import read_mesh
from geraf2.pipeline.prior import PriorSource
from geraf2.scene import load_capture

RESULTS_NAME = "ablation.jsonl"
AS_IT_IS = "as it is"
MODULE = "module:"
SMALL = 0.002
Results = dict[tuple[str, int], SeedResult]


@dataclass(frozen=True)
class Variant:
    """One constant with one change."""

    constant: str
    """Dotted name of the config's field, or `module:` and that of the module's constant."""
    change: str
    """off, half or double."""
    value: Any

    @property
    def name(self) -> str:
        return f"{self.constant} {self.change}".strip()


def changes_of(value: Any, kind: Any = None) -> dict[str, Any]:
    """Values to try instead of one, by the name of the change."""
    if isinstance(value, bool):
        return {"off": False} if value else {}
    if isinstance(value, str):
        return {"off": "no"} if value != "no" and "no" in typing.get_args(kind) else {}
    if isinstance(value, tuple) and value:
        parts = [changes_of(v) for v in value]
        names = [n for n in ("half", "double") if all(n in part for part in parts)]
        return {n: tuple(part[n] for part in parts) for n in names}
    if isinstance(value, int | float) and value and np.isfinite(value):
        half = value // 2 if isinstance(value, int) else 0.5 * value
        return {"off": type(value)(0), **({"half": half} if half else {}), "double": 2 * value}
    return {}


def with_value(config: Any, path: str, value: Any) -> Any:
    """Config with another value of one field; UserError or ValueError where it is out of bounds."""
    name, _, rest = path.partition(".")
    return replace(
        config, **{name: with_value(getattr(config, name), rest, value) if rest else value}
    )


def text_options(config: Any, prefix: str = "") -> Iterator[str]:
    """Names of the config's fields that hold text, but its preset; `config_fields` skips them."""
    for entry in fields(config):
        value = getattr(config, entry.name)
        if is_dataclass(value):
            yield from text_options(value, f"{prefix}{entry.name}.")
        elif isinstance(value, str) and entry.name != "preset":
            yield prefix + entry.name


def value_and_type(config: Any, path: str) -> tuple[Any, Any]:
    *groups, name = path.split(".")
    for group in groups:
        config = getattr(config, group)
    return getattr(config, name), typing.get_type_hints(type(config))[name]


def variants_of(config: Any, only: Sequence[str], *, quick: bool) -> list[Variant]:
    """All that can be changed, each change that the bounds allow."""
    found = []
    for path in [*text_options(config), *config_fields(config)]:
        for change, value in changes_of(*value_and_type(config, path)).items():
            with contextlib.suppress(UserError, ValueError):
                with_value(config, path, value)
                found.append(Variant(path, change, value))
    for name in sorted(set(module_constants())):
        module, constant = name.rsplit(".", 1)
        value = getattr(importlib.import_module(f"geraf2.{module}"), constant)
        found += [
            Variant(MODULE + name, change, changed)
            for change, changed in changes_of(value).items()
            if change != "off"
        ]
    return [
        v
        for v in found
        if (not quick or v.change == "off")
        and (not only or any(fnmatchcase(v.constant.removeprefix(MODULE), p) for p in only))
    ]


@contextlib.contextmanager
def module_constant(name: str, value: Any) -> Iterator[None]:
    """Another value of a module's constant, in all modules that imported it from there."""
    module, constant = name.rsplit(".", 1)
    known = getattr(importlib.import_module(f"geraf2.{module}"), constant)
    holders = [
        m
        for key, m in list(sys.modules.items())
        if key.startswith("geraf2") and getattr(m, constant, None) is known
    ]
    for holder in holders:
        setattr(holder, constant, value)
    try:
        yield
    finally:
        for holder in holders:
            setattr(holder, constant, known)


def ablate_scene(
    scene: Path, out: Path, config: Any, base: SeedResult, variants: Sequence[Variant]
) -> int:
    """Write the results of variants on one scene, a line each; one thread. Return their number.

    scene: scene folder. out: of the ablation. base: seed, preset and version. variants: to run.
    """
    logging.getLogger("geraf2").setLevel(logging.ERROR)  # of each variant the same warnings
    capture, truth = load_capture(scene), read_mesh(scene / TRUTH_NAME)

    def result(changed: Any) -> SeedResult:
        options = geraf2.RunOptions(seed=base.seed)
        prior = PriorSource(los=scene / LOS_NAME)
        try:
            done = geraf2.reconstruct(
                capture,
                prior,
                changed,
                options=options,
                num_threads=1,
            )
        except (UserError, ValueError, ArithmeticError, IndexError) as error:
            return replace(base, error=" ".join(str(error).split()) or type(error).__name__)
        scores = population_scores(done.content_mesh, truth, base.seed, num_threads=1)
        return replace(base, scores=scores)

    for variant in variants:
        changed, context = config, contextlib.nullcontext()
        if variant.constant.startswith(MODULE):
            context = module_constant(variant.constant.removeprefix(MODULE), variant.value)
        elif variant.constant:
            changed = with_value(config, variant.constant, variant.value)
        with context:
            found = result(changed)
        append_result(out / RESULTS_NAME, replace(found, preset=key_of(base.preset, variant)))
    return len(variants)


def make_and_ablate(
    out: Path, cache: Path | None, row: Row, base: SeedResult, variants: Sequence[Variant]
) -> int:
    """Write the results of variants on a scene; simulate it first unless it is there."""
    runner = Runner(out=out, num_threads=1, cache=cache)
    runner.simulate(row)
    return ablate_scene(runner.folders(row).scene, out, row.config, base, variants)


def key_of(preset: str, variant: Variant) -> str:
    """Name of a variant of a preset in the results."""
    return f"{preset}: {variant.name or AS_IT_IS}"


def size_changes(pairs: Sequence[tuple[SeedResult, SeedResult]]) -> str:
    """Mean change of F1 at 2 mm and of the absolute errors of volume, extents and offset."""
    cells = []
    for names, best in (
        (("f1_2mm",), 0.0),
        (("volume_ratio",), 1.0),
        (("extent_x_mm", "extent_y_mm", "extent_z_mm"), 0.0),
        (("offset_mm",), 0.0),
    ):
        values = np.abs([[[r.score(n) - best for n in names] for r in pair] for pair in pairs])
        change = values[:, 1] - values[:, 0]
        change = change[np.isfinite(change)]
        cells.append(f"  {change.mean():+.4f}" if len(change) else "        -")
    return "".join(cells)


@dataclass(frozen=True, kw_only=True)
class Ablation:
    """Variants of one preset, on scenes of the population."""

    task: Population
    preset: str
    out: Path
    jobs: int

    def found(self) -> Results:
        """Results that are there, by variant and seed."""
        version = self.task.version(self.preset)
        results = read_results(self.out / RESULTS_NAME)
        return {(r.preset, r.seed): r for r in results if r.version == version}

    def run(self, seeds: Sequence[int], variants: Sequence[Variant]) -> None:
        """Run what is missing, a scene in a process."""
        found, runner = self.found(), self.task.runner
        version = self.task.version(self.preset)
        spawn = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(self.jobs, mp_context=spawn) as pool:
            running = {}
            for seed in seeds:
                left = [v for v in variants if (key_of(self.preset, v), seed) not in found]
                if left:
                    row = self.task.row(seed, self.preset)
                    base = SeedResult(seed=seed, preset=self.preset, version=version)
                    where = self.out, runner.cache
                    running[pool.submit(make_and_ablate, *where, row, base, left)] = seed
            start = time.monotonic()
            for done, future in enumerate(as_completed(running), 1):
                name = f"{self.preset}, seed {running[future]}"
                try:
                    note = f"{future.result()} variants"
                except UserError as error:
                    note = str(error)
                left_s = (time.monotonic() - start) / done * (len(running) - done)
                print(f"{name}: {note}, {left_s / 60:.0f} min left", file=sys.stderr, flush=True)

    def pairs(
        self, found: Results, seeds: Sequence[int], variant: Variant
    ) -> list[tuple[SeedResult, SeedResult]]:
        """Results as the preset is, and with the change, of seeds that have both."""
        first = key_of(self.preset, Variant("", "", None)), key_of(self.preset, variant)
        both = [tuple(found.get((key, seed)) for key in first) for seed in seeds]
        return [(a, b) for a, b in both if a is not None and b is not None]

    def table(self, seeds: Sequence[int], variants: Sequence[Variant]) -> list[str]:
        """Lines of all variants, the largest change first, and what changes nothing."""
        lines, effects, found = [], dict[str, list[float]](), self.found()
        for variant in variants:
            pairs = self.pairs(found, seeds, variant)
            if not pairs:
                continue
            if all(after.error for _, after in pairs):
                lines.append((np.inf, f"{variant.name:56}{len(pairs):4d}  {pairs[0][1].error}"))
                effects.setdefault(variant.constant, []).append(np.inf)
                continue
            before, after = np.array([[r.score("f1_5mm") for r in pair] for pair in pairs]).T
            mean, quantile = mean_interval(after - before), quantile_change(before, after)
            effects.setdefault(variant.constant, []).append(
                max(abs(mean.value), abs(quantile.value))
            )
            text = "".join(
                f"  {c.value:+.4f} ({c.low:+.4f} to {c.high:+.4f})" for c in (mean, quantile)
            )
            name = f"{variant.name:56}{len(pairs):4d}{text}{size_changes(pairs)}"
            lines.append((abs(mean.value), name))
        lines.sort(key=lambda line: -line[0])
        nothing = sorted(n for n, sizes in effects.items() if max(sizes) <= SMALL)
        head = (
            f"{'':56}   n  mean F1 5 mm (95 %), 5 % quantile (95 %), mean F1 2 mm, "
            "errors of volume, extents [mm], offset [mm]"
        )
        return [
            f"{self.preset}: change against the preset as it is",
            head,
            *(text for _, text in lines),
            f"change mean and quantile by at most {SMALL}: " + (", ".join(nothing) or "none"),
        ]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path, help="folder of results and of what is reused")
    parser.add_argument("--seeds", default="1000:1040", help="A:B, B excluded")
    parser.add_argument("--presets", nargs="+", default=["fast"])
    parser.add_argument("--only", nargs="*", default=[], help="names or patterns of constants")
    parser.add_argument("--cache", type=Path, help="folder of scenes that are there; OUT if not")
    parser.add_argument("--scenes", type=int, help="only the first so many seeds")
    parser.add_argument("--screen", type=int, default=8, help="scenes that all variants run on")
    parser.add_argument("--limit", type=float, default=0.01, help="change of the mean that stops")
    parser.add_argument("--jobs", type=int, default=1, help="scenes at a time, a thread each")
    parser.add_argument("--quick", action="store_true", help="four scenes, switched off alone")
    parser.add_argument("--table", action="store_true", help="only print what is there")
    options = parser.parse_args()
    try:
        seeds = list(parse_seeds(options.seeds))[: 4 if options.quick else options.scenes]
        out = options.out.resolve()
        out.mkdir(parents=True, exist_ok=True)
        runner = Runner(out=out, num_threads=1, cache=options.cache and options.cache.resolve())
        task = Population(runner=runner, presets=tuple(options.presets))
        for preset in options.presets:
            ablation = Ablation(task=task, preset=preset, out=out, jobs=options.jobs)
            variants = variants_of(task.config(preset), options.only, quick=options.quick)
            if not options.table:
                base = Variant("", "", None)
                ablation.run(seeds[: options.screen], [base, *variants])
                rest = small_ones(ablation, seeds[: options.screen], variants, options.limit)
                ablation.run(seeds[options.screen :], [base, *rest])
            print("\n".join(ablation.table(seeds, variants)), flush=True)
    except UserError as error:
        sys.exit(f"ablate: {error}")


def small_ones(
    ablation: Ablation, seeds: Sequence[int], variants: Sequence[Variant], limit: float
) -> list[Variant]:
    """Return the variants that change the mean F1 at 5 mm by at most the limit."""
    found, small = ablation.found(), []
    for variant in variants:
        pairs = ablation.pairs(found, seeds, variant)
        changes = [b.score("f1_5mm") - a.score("f1_5mm") for a, b in pairs]
        if not changes or abs(float(np.mean(changes))) <= limit:
            small.append(variant)
    return small


if __name__ == "__main__":
    main()
