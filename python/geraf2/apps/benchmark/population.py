"""Presets on seeds of the population or of ordinary objects: each simulated and scored once."""

import json
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from geraf2 import __version__
from geraf2.apps.benchmark.population_table import (
    Records,
    SeedResult,
    paired_table,
    preset_table,
)
from geraf2.apps.benchmark.rows import Row, RowResult
from geraf2.apps.benchmark.runner import RESULT_VERSION, SCENE_VERSION, Runner, read_record
from geraf2.apps.benchmark.suite import Case, Method
from geraf2.errors import UserError
from geraf2.io.atomic import write_json_atomic
from geraf2.io.run_folder import stage_key
from geraf2.io.text import parse_json
from geraf2.io.toml import read_table, write_toml
from geraf2.pipeline.presets import PresetConfig, preset_type, versions_of
from geraf2.simulation import SceneSpec, parse_spec
from geraf2.simulation.ordinary import ORDINARY_VERSION, draw_ordinary
from geraf2.simulation.population import DrawnScene, draw_scene
from geraf2.simulation.population_settings import POPULATION_VERSION


@dataclass(frozen=True, kw_only=True)
class SceneSet:
    """Scenes that seeds name."""

    name: str
    """Of the experiment, as --only names it."""
    version: int
    """Of what the seeds give."""
    draw: Callable[[int], DrawnScene]
    """Scene of a seed; UserError where the set has none."""
    example: str
    """Seeds that an error suggests."""

    @property
    def results_name(self) -> str:
        """File of the results: a line for each seed, preset and version."""
        return f"{self.name}.jsonl"

    @property
    def record_name(self) -> str:
        """File of what was drawn for each seed, in the folder of the scenes."""
        return f"{self.name}.json"


SETS = {
    one.name: one
    for one in (
        SceneSet(
            name="population",
            version=POPULATION_VERSION,
            draw=draw_scene,
            example="--seeds 1000:1040",
        ),
        SceneSet(
            name="ordinary",
            version=ORDINARY_VERSION,
            draw=draw_ordinary,
            example="--seeds 1000:1064",
        ),
    )
}
"""Sets of scenes by name."""
RESERVED_SEED = 10_000
"""First seed that is kept for claims."""
MAX_SEEDS = 100_000
"""Longest range of seeds."""
# Rows that are prepared at a time: their scenes are drawn before the first of them runs.
_CHUNK = 16
# Raised when a score means something else.
_SCORES_VERSION = 1


def parse_seeds(text: str) -> range:
    """Seeds of `A:B`, B excluded; UserError for anything else."""
    found = re.fullmatch(r"(\d{1,18}):(\d{1,18})", text)
    seeds = range(int(found[1]), int(found[2])) if found else range(0)
    if not 0 < len(seeds) <= MAX_SEEDS:
        raise UserError(
            what="--seeds is no range of seeds",
            expected=f"A:B, 0 <= A < B, at most {MAX_SEEDS:,} seeds; B is not one of them",
            got=text,
            hint="--seeds 1000:1040 for 1000 to 1039",
        )
    return seeds


def is_reserved(seeds: range) -> bool:
    """Whether some of the seeds are kept for claims."""
    return seeds[-1] >= RESERVED_SEED


def scene_of(folder: Path, scenes: SceneSet, seed: int) -> SceneSpec:
    """Spec of a seed, drawn once; spec and record are kept in the folder of the scenes."""
    spec_path = folder / scenes.name / f"{seed}.toml"
    drawn = records_of(folder, scenes)
    if seed not in drawn or not spec_path.is_file():
        scene = scenes.draw(seed)
        spec_path.parent.mkdir(parents=True, exist_ok=True)
        write_toml(spec_path, scene.spec)
        record = {"version": scenes.version, "seeds": {**drawn, seed: dict(scene.record)}}
        write_json_atomic(folder / scenes.record_name, record)
    return parse_spec(read_table(spec_path), where=spec_path)


def records_of(folder: Path, scenes: SceneSet) -> Records:
    """Read what was drawn for each seed whose scene was made in this folder by this version."""
    known = read_record(folder / scenes.record_name)
    drawn = known.get("seeds")
    if known.get("version") != scenes.version or not isinstance(drawn, dict):
        return {}
    return {int(seed): record for seed, record in drawn.items()}


@dataclass(frozen=True, kw_only=True)
class Population:
    """Presets that run on a set of scenes, and the folder of their results."""

    runner: Runner
    """Where results and scenes lie, and with how many threads."""
    presets: tuple[str, ...]
    """Names."""
    scenes: SceneSet = SETS["population"]
    """What is reconstructed."""

    def config(self, preset: str) -> PresetConfig:
        """Constants of a preset."""
        return preset_type(preset)()

    def version(self, preset: str) -> str:
        """Digest of all that the scores of a preset depend on but the seed."""
        config = self.config(preset)
        return stage_key(
            population=self.scenes.version,
            scene=SCENE_VERSION,
            result=[RESULT_VERSION, _SCORES_VERSION],
            config=config,
            stages=versions_of(config),
        )[:10]

    def row(self, seed: int, preset: str) -> Row:
        """Row of the benchmark for a seed."""
        folder = self.runner.cache or self.runner.out
        spec = scene_of(folder, self.scenes, seed)
        name = str(spec.figure.name).removesuffix(f"-{seed}")
        return Row(
            experiment=self.scenes.name,
            scene=f"{name}-{seed}",
            case=Case(label=""),
            method=preset,
            spec=spec,
            config=self.config(preset),
            how=Method(title=preset, preset=preset, kind="population"),
            seed=seed,
        )

    def run(
        self,
        seeds: Sequence[int],
        on_result: Callable[[Row, RowResult], None] = lambda row, result: None,
        *,
        jobs: int = 1,
        scheduler: str | None = None,
    ) -> list[SeedResult]:
        """Results of all presets and seeds; those that are there are read, failed ones made again.

        on_result: called after each row that was made. jobs, scheduler: as of `Runner.run_all`.
        """
        path = self.runner.out / self.scenes.results_name
        asked = [(seed, preset) for seed in seeds for preset in self.presets]
        versions = {preset: self.version(preset) for preset in self.presets}
        found = {
            (result.seed, result.preset): result
            for result in read_results(path)
            if result.version == versions.get(result.preset) and result.error is None
        }
        left = [key for key in asked if key not in found]

        def keep(row: Row, result: RowResult) -> None:
            of_seed = _seed_result(row, result, versions[row.method])
            found[of_seed.seed, of_seed.preset] = of_seed
            append_result(path, of_seed)
            on_result(row, result)

        size = _CHUNK * jobs
        for start in range(0, len(left), size):
            rows = [self.row(*key) for key in left[start : start + size]]
            self.runner.run_all(rows, keep, jobs=jobs, scheduler=scheduler)
        return [found[key] for key in asked]


def tables(
    results: Sequence[SeedResult],
    presets: Sequence[str],
    records: Records,
    others: Iterable[SeedResult] = (),
) -> str:
    """Table of each preset, then paired differences: of presets, and against other results.

    records: what was drawn for each seed.
    """
    by_preset = {name: [r for r in results if r.preset == name] for name in presets}
    parts = [preset_table(name, own, records) for name, own in by_preset.items()]
    first = presets[0]
    parts += [
        paired_table(f"{name} less {first}", by_preset[first], by_preset[name])
        for name in presets[1:]
    ]
    for name, own in by_preset.items():
        before = [result for result in others if result.preset == name]
        if before:
            parts.append(paired_table(f"{name}, here less --against", before, own))
    return "\n\n".join("\n".join(lines) for lines in parts)


def results_against(folder: Path, scenes: SceneSet) -> list[SeedResult]:
    """Last result of each seed and preset in another folder; UserError where there is none."""
    last = {(r.seed, r.preset): r for r in read_results(folder / scenes.results_name)}
    if not last:
        raise UserError(
            what=f"has no results of --only {scenes.name}",
            where=folder,
            expected=f"a folder with {scenes.results_name}, as 'geraf2 benchmark' makes it",
            hint=f"run the other version with --only {scenes.name} into it first",
        )
    return list(last.values())


def read_results(path: Path) -> list[SeedResult]:
    """Results in the order of their lines; a line that a stop cut short is left out."""
    if not path.is_file():
        return []
    names = {entry.name for entry in fields(SeedResult)}
    results = []
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            values = parse_json(line)
            results.append(SeedResult(**{k: v for k, v in values.items() if k in names}))
        except (ValueError, TypeError, AttributeError):
            continue
    return results


def _seed_result(row: Row, result: RowResult, version: str) -> SeedResult:
    scores = dict(result.scores or {})
    if result.cpu_seconds is not None:
        scores["cpu_seconds"] = result.cpu_seconds
    assert row.seed is not None
    return SeedResult(
        seed=row.seed, preset=row.method, version=version, scores=scores, error=result.error
    )


def append_result(path: Path, result: SeedResult) -> None:
    """Add one line in one write; a line that was cut short ends first."""
    line = json.dumps({**asdict(result), "geraf2": __version__}) + "\n"
    with path.open("a+b") as file:
        if file.tell() > 0:
            file.seek(-1, 2)
            if file.read(1) != b"\n":
                line = "\n" + line
        file.write(line.encode())
