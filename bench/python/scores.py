"""Scores of the reconstruction on an independent capture and on own simulations.

    python bench/python/scores.py --data ../shared/data --out out/scores \\
        [--preset fast | best] [--only cat cat_6_planes] [--jobs N | --scheduler tcp://HOST:8786]

The objects are public meshes and no part of the project; `--data` names the folder that holds
them (`meshes/*.ply`) and the independent capture (`spot_carton/`). Every case is simulated,
reconstructed and evaluated by the `geraf2` command with unchanged settings. `--preset` goes to
`geraf2 reconstruct`. Scenes are kept in
`--out` and used again; reconstructions are always new. Seed 0 everywhere. With `--jobs` or
`--scheduler` the cases run on workers of dask, of this machine or elsewhere (these see the same
files, and find this folder by PYTHONPATH); seconds are then those of a busy machine.
"""

import argparse
import json
import math
import shutil
import statistics
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import tomli_w

from geraf2.apps.batch import BatchOptions
from geraf2.apps.batch.cluster import connect_workers
from geraf2.apps.batch.engine import Failure, Task, drive
from reconstruct import Measurement, geraf2_command, measure

CARTON: dict[str, Any] = {"size_m": [0.22, 0.22, 0.22]}  # 4 mm of permittivity 1.6
INNER_BOX: dict[str, Any] = {"size_m": [0.17, 0.17, 0.17], "thickness_m": 0.003}


@dataclass(frozen=True, kw_only=True)
class Case:
    name: str
    mesh: str
    up: str = "+y"
    height_m: float = 0.12
    smooth: int = 0
    """Rounds of subdivision: coarse meshes have facets, and a facet is a flat mirror."""
    inner_walls: tuple[dict[str, Any], ...] = ()
    scan: dict[str, Any] = field(default_factory=dict)
    disturbance: dict[str, Any] = field(default_factory=dict)
    of: str | None = None
    """Case whose scene it is, if not one of its own."""
    planes: int | None = None
    """Planes used of the 36, equally spaced; all when None."""

    @property
    def more(self) -> tuple[str, ...]:
        """Arguments of `geraf2 reconstruct`."""
        if self.planes is None:
            return ()
        angles = (10 * number for number in range(36))
        return ("--hold-out", *(str(a) for a in angles if a % (360 // self.planes)))

    def spec(self, meshes: Path) -> dict[str, Any]:
        return {
            "figure": {
                "mesh": str((meshes / f"{self.mesh}.ply").resolve()),
                "height_m": self.height_m,
                "up": self.up,
                "smooth_subdivisions": self.smooth,
            },
            "walls": [CARTON, *self.inner_walls],
            "scan": self.scan,
            "disturbance": self.disturbance,
        }


INDEPENDENT = "spot_carton"
# Each stands on its longest axis, so that 12 cm of height is all of it: on its keel the boat
# would be 50 cm long.
FIGURES = (
    Case(name="cat", mesh="cat"),
    Case(name="penguin", mesh="penguin", smooth=1),
    Case(name="fish", mesh="fish", smooth=2, up="+z"),
    Case(name="wingnut", mesh="wingnut", smooth=1, up="+z"),
    Case(name="boat", mesh="boat", up="+z"),
)
# The two that fit into the carton lying, too: at 12 cm height they are 20 cm long and fill it.
LYING = (
    Case(name="fish_lying_20_cm", mesh="fish", smooth=2),
    Case(name="wingnut_lying_20_cm", mesh="wingnut", smooth=1),
    Case(name="fish_lying_12_cm", mesh="fish", smooth=2, height_m=0.0722),
    Case(name="wingnut_lying_12_cm", mesh="wingnut", smooth=1, height_m=0.0713),
)
HARDER = (
    Case(name="cat_9_planes", mesh="cat", scan={"n_poses": 9}),
    Case(name="cat_6_planes", mesh="cat", scan={"n_poses": 6}),
    Case(name="cat_0_db", mesh="cat", disturbance={"snr_db": 0.0}),
    Case(name="cat_jitter_0.2_mm", mesh="cat", scan={"position_jitter_rms_m": 2e-4}),
    Case(name="cat_nested_box", mesh="cat", inner_walls=(INNER_BOX,)),
    Case(
        name="cat_3_percent_scatterers", mesh="cat", disturbance={"scatterer_energy_fraction": 0.03}
    ),
)

# The independent capture and the five objects again, with less data.
FEW_PLANES = (
    Case(name=f"{INDEPENDENT}_of_6_planes", mesh="", of=INDEPENDENT, planes=6),
    *(replace(c, name=f"{c.name}_of_6_planes", of=c.name, planes=6) for c in FIGURES),
)
CLUTTER = {"scatterer_energy_fraction": 0.1}
SCATTERERS = (
    Case(
        name="spot_10_percent_scatterers",
        mesh=f"../{INDEPENDENT}/truth_object",
        up="+z",
        disturbance=CLUTTER,
    ),
    *(replace(c, name=f"{c.name}_10_percent_scatterers", disturbance=CLUTTER) for c in FIGURES),
)


@dataclass(frozen=True, kw_only=True)
class Score:
    f1_15_mm: float
    f1_5_mm: float
    f1_3_mm: float
    f1_2_mm: float
    chamfer_1e3_m2: float
    volume_ratio: float
    extents_mm: tuple[float, float, float]
    """Errors along x, y and z."""
    offset_mm: float
    """Along the normal, in the median."""
    cost: Measurement

    @property
    def values(self) -> tuple[float, ...]:
        f1 = self.f1_15_mm, self.f1_5_mm, self.f1_3_mm, self.f1_2_mm
        return *f1, self.chamfer_1e3_m2, self.volume_ratio, *self.extents_mm, self.offset_mm

    def row(self, name: str) -> str:
        cost = f"{self.cost.wall_s:7.1f}  {self.cost.peak_memory_mib:8.0f}"
        return f"{name:29} {numbers(self.values)}  {cost}"


HEADER = (
    f"{'':29} F1 15 mm   F1 5 mm   F1 3 mm   F1 2 mm   CD 1e-3 m2  volume   "
    "extents x, y, z mm  offset mm   wall s  peak MiB"
)
# Best value of each of `Score.values`: of F1 1, of the rest that of a perfect surface.
BEST = (1.0, 1.0, 1.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0)


def numbers(values: tuple[float, ...]) -> str:
    *f1, chamfer, volume, x, y, z, offset = values
    shares = "  ".join(f"{value:8.4f}" for value in f1)
    return (
        f"{shares}   {chamfer:10.5f}  {volume:6.3f}  {x:+6.1f} {y:+6.1f} {z:+6.1f}  {offset:+9.2f}"
    )


def geraf2(*arguments: str) -> None:
    command = [*geraf2_command(), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        msg = f"geraf2 {' '.join(arguments)}: exit code {done.returncode}\n{done.stderr}"
        raise RuntimeError(msg)


def known(value: float | None) -> float:
    """NaN where one of the surfaces is open."""
    return math.nan if value is None else value


def reconstruct_and_score(
    scene: Path, los: Path, truth: Path, run: Path, *options: str, n_samples: int = 10_000
) -> Score:
    """Scores of a new reconstruction, with more options of the command."""
    shutil.rmtree(run, ignore_errors=True)
    command = [*geraf2_command(), "reconstruct", str(scene), str(run), "--los", str(los)]
    cost = measure([*command, *options], quiet=True)
    geraf2("evaluate", str(run), "--truth", str(truth), "--n-samples", str(n_samples))
    metrics = json.loads((run / "metrics.json").read_text(encoding="utf-8"))
    f1 = {round(1e3 * score["threshold_m"]): score["f1"] for score in metrics["scores"]}
    x, y, z = (1e3 * error for error in metrics["size"]["extent_errors_m"])
    return Score(
        f1_15_mm=f1[15],
        f1_5_mm=f1[5],
        f1_3_mm=f1[3],
        f1_2_mm=f1[2],
        chamfer_1e3_m2=metrics["chamfer_1e3_m2"],
        volume_ratio=known(metrics["size"]["volume_ratio"]),
        extents_mm=(x, y, z),
        offset_mm=1e3 * known(metrics["surface_bias_m"]),
        cost=cost,
    )


@dataclass(frozen=True, kw_only=True)
class Bench:
    data: Path
    out: Path
    preset: str

    def scene(self, case: Case) -> Path:
        """Scene of a case, made unless it is there."""
        name = case.of or case.name
        return self._independent() if name == INDEPENDENT else self._simulated(case, name)

    def score(self, case: Case) -> Score:
        name, scene = case.of or case.name, self.scene(case)
        los, truth = scene / "los.ply", scene / "truth.ply"
        if name == INDEPENDENT:
            los = self.data / INDEPENDENT / "los_box.ply"
            truth = self.data / INDEPENDENT / "truth_object.ply"
        run = self.out / "runs" / f"{case.name}_{self.preset}"
        return reconstruct_and_score(scene, los, truth, run, "--preset", self.preset, *case.more)

    def _independent(self) -> Path:
        scene = self.out / "scenes" / INDEPENDENT
        geraf2("import", "geraf-sens", str(self.data / INDEPENDENT), str(scene))
        return scene

    def _simulated(self, case: Case, name: str) -> Path:
        """Scene of a case, simulated unless it is there already."""
        scene, spec_path = self.out / "scenes" / name, self.out / "scenes" / f"{name}.toml"
        spec = tomli_w.dumps(case.spec(self.data / "meshes"))
        known = spec_path.read_text(encoding="utf-8") if spec_path.is_file() else None
        if known != spec or not scene.is_dir():
            spec_path.parent.mkdir(parents=True, exist_ok=True)
            spec_path.write_text(spec, encoding="utf-8")
            geraf2("simulate", str(spec_path), str(scene), "--overwrite")
        return scene


def make_scene(bench: Bench, case: Case) -> None:
    bench.scene(case)


def score(bench: Bench, case: Case) -> Score:
    return bench.score(case)


def scores_of(bench: Bench, cases: list[Case], options: BatchOptions) -> Iterator[Score]:
    """Scores in the order of the cases, by workers; scenes first, each once."""
    scenes = {case.of or case.name: case for case in cases}
    found: dict[str, Score] = {}
    with connect_workers(options) as client:
        for function, some in ((make_scene, list(scenes.values())), (score, cases)):
            tasks = (Task(name=case.name, arguments=(bench, case)) for case in some)
            for name, answer in drive(client, function, tasks):
                if isinstance(answer, Failure):
                    sys.exit(f"{name}: {answer.error}")
                if answer is not None:
                    found[name] = answer
    for case in cases:
        yield found[case.name]


def print_group(title: str, scores: dict[str, Score], summarise: str) -> None:
    if len(scores) > 1:
        columns = zip(*(score.values for score in scores.values()), strict=True)
        if summarise == "mean":
            summary = tuple(statistics.fmean(column) for column in columns)
        else:  # of each score the value that is farthest from its best one
            summary = tuple(
                max(column, key=lambda value: abs(value - best))
                for column, best in zip(columns, BEST, strict=True)
            )
        print(f"{f'{title}: {summarise}':29} {numbers(summary)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, default=Path("out/scores"))
    parser.add_argument("--preset", choices=("fast", "best"), default="fast")
    parser.add_argument("--only", nargs="*", help="names of cases; all when not given")
    parser.add_argument("--jobs", type=int, default=1, help="cases at a time")
    parser.add_argument("--scheduler", help="address of a dask scheduler")
    options = parser.parse_args()
    independent = Case(name=INDEPENDENT, mesh="")
    groups = (
        ("figures", (independent, *FIGURES), "mean"),
        ("lying", LYING, "mean"),
        ("harder", HARDER, "worst"),
        ("6 planes", FEW_PLANES, "mean"),
        ("scatterers", SCATTERERS, "mean"),
    )
    names = [case.name for _, cases, _ in groups for case in cases]
    unknown = set(options.only or ()) - set(names)
    if unknown:
        parser.error(f"no such case: {', '.join(sorted(unknown))}; there are {', '.join(names)}")
    wanted = set(options.only or names)
    bench = Bench(data=options.data.resolve(), out=options.out.resolve(), preset=options.preset)
    chosen = [case for _, cases, _ in groups for case in cases if case.name in wanted]
    found = map(bench.score, chosen)
    if options.jobs > 1 or options.scheduler:
        workers = None if options.scheduler else options.jobs
        found = scores_of(bench, chosen, BatchOptions(workers=workers, scheduler=options.scheduler))

    print(HEADER)
    for title, cases, summarise in groups:
        scores = {}
        for case in cases:
            if case.name in wanted:
                scores[case.name] = next(found)
                print(scores[case.name].row(case.name), flush=True)
        print_group(title, scores, summarise)


if __name__ == "__main__":
    main()
