"""Runs rows: scenes and results are kept by what they were made from."""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from geraf2.apps.batch.cluster import connected, require_workers, tend
from geraf2.apps.batch.engine import Answer, Task, drive
from geraf2.apps.batch.options import BatchOptions
from geraf2.apps.batch.running import is_killed
from geraf2.apps.benchmark.making import make_row, make_scene, tell_walls
from geraf2.apps.benchmark.rows import Row, RowResult
from geraf2.errors import UserError
from geraf2.io.atomic import write_json_atomic
from geraf2.io.run_folder import stage_key
from geraf2.io.toml import write_toml
from geraf2.pipeline.processes import Processes

if TYPE_CHECKING:
    from distributed import Client

RESULT_NAME = "result.json"
SCENES_FOLDER, RUNS_FOLDER = "scenes", "runs"
# Raised when the simulator or the evaluation gives something else from the same spec.
_SCENE_VERSION, _RESULT_VERSION = 1, 3
# How often a row may lose the worker on which it was or waited.
_MOST_LOSSES = 10
# Of a scan: what had no part in the names of folders before it existed.
_LATER = ("rings", "file", "sweeps")


class Place(NamedTuple):
    """Folders of a row, named after all that they depend on; tables share both."""

    scene: Path
    run: Path


@dataclass
class Runner:
    """Makes scenes and runs under one folder, each once and in a process of its own."""

    out: Path
    """Folder of the benchmark."""
    seed: int = 0
    """Of scenes, reconstructions and evaluation."""
    num_threads: int | None = None
    """Threads of each process; all when None."""
    _processes: Processes = field(default_factory=Processes)

    def run_all(
        self,
        rows: Sequence[Row],
        told: Callable[[Row, RowResult], None],
        *,
        jobs: int = 1,
        scheduler: str | None = None,
    ) -> list[tuple[Row, RowResult]]:
        """Figures of rows, each told as it is there.

        jobs: how many at a time, on processes of this machine; one needs no dask.
        scheduler: address of a dask scheduler instead, whose workers see the same files.

        Where it is interrupted, or `told` raises, the processes end, too.
        """
        if jobs > 1 or scheduler is not None:
            options = BatchOptions(workers=None if scheduler else jobs, scheduler=scheduler)
            return run_on_workers(self, rows, told, options)
        results = []
        try:
            for row in rows:
                results.append((row, self.run(row)))
                told(*results[-1])
        except BaseException:
            self._processes.stop()
            raise
        return results

    def run(self, row: Row) -> RowResult:
        """Figures of a row: from an earlier run, or a new one; a failure is its result."""
        done = self.known(row)  # tables share rows
        if done is not None:
            return done
        scene, run = self.place(row)
        try:
            self.simulate(row)
            result, seconds = self._processes.call(
                make_row, row, scene, run, self.seed, self.num_threads
            )
        except (UserError, OSError) as error:
            return RowResult(error=" ".join(str(error).split()))
        result = replace(
            result,
            all_cpu_seconds=seconds,
            folder=str(run.relative_to(self.out)),
            scene_folder=str(scene.relative_to(self.out)),
        )
        run.mkdir(parents=True, exist_ok=True)
        write_json_atomic(run / RESULT_NAME, {"row": row.name, **asdict(result)})
        return result

    def known(self, row: Row) -> RowResult | None:
        """Figures of a row from an earlier run; None where there are none."""
        values = _read(self.place(row).run / RESULT_NAME)
        own = {
            entry.name: values[entry.name] for entry in fields(RowResult) if entry.name in values
        }
        return RowResult(**own) if own else None

    def known_scene_seconds(self, row: Row) -> float | None:
        """Processor time that a row's scene took [s]; None where it is not known."""
        seconds = _read(self.place(row).scene.with_suffix(".json")).get("cpu_seconds")
        return float(seconds) if isinstance(seconds, int | float) else None

    def place(self, row: Row) -> Place:
        """Folders in which a row's scene and result are kept."""
        how, case = row.how, row.case
        spec = {entry.name: getattr(row.spec, entry.name) for entry in fields(row.spec)}
        if row.spec.world.is_off:  # as before there were worlds
            del spec["world"]
        scan = {
            name: value
            for name, value in vars(row.spec.scan).items()
            if value or name not in _LATER
        }
        spec["scan"] = scan
        if row.spec.disturbance.far_walls:  # as before they could be without echo
            spec["disturbance"] = {
                k: value for k, value in vars(row.spec.disturbance).items() if k != "far_walls"
            }
        scene = stage_key(
            version=_SCENE_VERSION, spec=spec, seed=self.seed, told=case.told_permittivity
        )
        more = {"options": how.options} if how.options else {}
        run = stage_key(
            version=_RESULT_VERSION,
            scene=scene,
            kind=how.kind,
            settings=how.photos if how.kind == "photos" else row.config,
            hold_out=how.hold_out,
            shift=case.prior_shift_m,
            stages=row.versions,
            seed=self.seed,
            **more,
        )
        return Place(
            self.out / SCENES_FOLDER / f"{row.scene}-{scene[:10]}",
            self.out / RUNS_FOLDER / f"{row.scene}-{row.method}-{run[:10]}",
        )

    def simulate(self, row: Row) -> None:
        """Make the scene of a row, unless it is there; UserError."""
        scene, told = self.place(row).scene, row.case.told_permittivity
        if scene.is_dir():  # made whole or not at all
            return
        scene.parent.mkdir(parents=True, exist_ok=True)
        write_toml(scene.with_suffix(".toml"), row.spec)
        if told == "true":
            arguments = (row.spec, scene, self.seed, self.num_threads)
            _, spent = self._processes.call(make_scene, *arguments)
            write_json_atomic(scene.with_suffix(".json"), {"cpu_seconds": spent})
            return
        true_one = true_to(row)
        self.simulate(true_one)
        self._processes.call(tell_walls, self.place(true_one).scene, scene, told)


def true_to(row: Row) -> Row:
    """Row whose scene says what its walls are."""
    return replace(row, case=replace(row.case, told_permittivity="true"))


def run_on_workers(
    runner: Runner,
    rows: Sequence[Row],
    told: Callable[[Row, RowResult], None],
    options: BatchOptions,
) -> list[tuple[Row, RowResult]]:
    """Figures of rows by workers of dask: scenes first, each once, then the rows.

    UserError before any work where no scheduler answers, or workers have another geraf2.
    """
    runner = replace(runner, out=runner.out.resolve(), _processes=Processes())
    alike: dict[Path, list[Row]] = {}  # tables share rows
    for row in rows:
        alike.setdefault(runner.place(row).run, []).append(row)
    found = {run: runner.known(same[0]) for run, same in alike.items()}
    left = [same[0] for run, same in alike.items() if found[run] is None]
    true_ones = {runner.place(row).scene: row for row in map(true_to, left)}
    others = {runner.place(row).scene: row for row in left}

    def tell(run: Path, result: RowResult) -> None:
        found[run] = result
        for row in alike[run]:
            told(row, result)

    for run, result in list(found.items()):
        if result is not None:
            tell(run, result)
    if left:
        with connected(options, 0.0) as client:
            require_workers(client)
            for scenes in (true_ones, others):  # the latter are made of the former
                missing = [row for scene, row in scenes.items() if not scene.is_dir()]
                for _ in _answers(client, _simulate, runner, missing):
                    pass  # a scene that failed fails again with its row, which says why
            for row, answer in _answers(client, _run, runner, left):
                is_lost = isinstance(answer, BaseException)
                result = RowResult(error=" ".join(str(answer).split())) if is_lost else answer
                tell(runner.place(row).run, result)
    return [(row, found[runner.place(row).run] or RowResult()) for row in rows]


def _answers(
    client: "Client", function: Callable[..., Any], runner: Runner, rows: Sequence[Row]
) -> Iterator[tuple[Row, Answer]]:
    how = str(runner.out), runner.seed, runner.num_threads
    named = {f"{number}-{row.name}": row for number, row in enumerate(rows)}
    tasks = (Task(name=name, arguments=(*how, row)) for name, row in named.items())

    def again(task: Task, answer: Answer) -> Task | None:
        lost = is_killed(answer) and task.losses < _MOST_LOSSES
        return replace(task, losses=task.losses + 1) if lost else None

    answers = drive(client, function, tasks, again, per_thread=1, tend=lambda: tend(client))
    for task, answer in answers:
        yield named[task.name], answer


def _simulate(out: str, seed: int, num_threads: int | None, row: Row) -> None:
    Runner(out=Path(out), seed=seed, num_threads=num_threads).simulate(row)


def _run(out: str, seed: int, num_threads: int | None, row: Row) -> RowResult:
    return Runner(out=Path(out), seed=seed, num_threads=num_threads).run(row)


def _read(path: Path) -> dict[str, Any]:
    """Read a record; an empty one where there is none, or it is broken."""
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return values if isinstance(values, dict) else {}
