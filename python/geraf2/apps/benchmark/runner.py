"""Runs rows; scenes and results are stored by a hash of their inputs."""

import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from multiprocessing import Pipe, current_process, get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from geraf2.apps.batch.cluster import connect_workers
from geraf2.apps.batch.engine import Failure, Task, drive
from geraf2.apps.batch.options import BatchOptions
from geraf2.apps.benchmark.making import copy_with_walls, make_row, make_scene
from geraf2.apps.benchmark.rows import Row, RowResult
from geraf2.errors import UserError
from geraf2.io.atomic import write_json_atomic
from geraf2.io.run_folder import stage_key
from geraf2.io.text import read_object
from geraf2.io.toml import write_toml

if TYPE_CHECKING:
    from distributed import Client

_T = TypeVar("_T")
RESULT_NAME = "result.json"
SCENES_FOLDER, RUNS_FOLDER = "scenes", "runs"
# Increased when the simulator or the evaluation changes its results.
SCENE_VERSION, RESULT_VERSION = 1, 4
_PATIENCE_S = 5.0
"""Time that a process gets to clean up before it is killed [s]."""


class Folders(NamedTuple):
    """Folders of a row, named by a hash of their inputs; tables share both."""

    scene: Path
    run: Path


@dataclass
class Runner:
    """Simulates scenes and runs rows in one folder, each once and in a process of its own."""

    out: Path
    """Folder of the benchmark."""
    seed: int = 0
    """Of scenes, reconstructions and evaluation."""
    num_threads: int | None = None
    """Threads of each process; all when None."""
    cache: Path | None = None
    """Folder whose scenes/ are used and added to; `out` when None."""

    def run_all(
        self,
        rows: Sequence[Row],
        on_result: Callable[[Row, RowResult], None],
        *,
        jobs: int = 1,
        scheduler: str | None = None,
    ) -> list[tuple[Row, RowResult]]:
        """Results of rows; `on_result` is called with each as it finishes.

        jobs: processes of this machine; one needs no dask.
        scheduler: address of a dask scheduler instead, whose workers share the files.

        An interruption ends the processes, too.
        """
        if jobs > 1 or scheduler is not None:
            options = BatchOptions(workers=None if scheduler else jobs, scheduler=scheduler)
            return run_on_workers(self, rows, on_result, options)
        results = []
        for row in rows:
            results.append((row, self.run(row)))
            on_result(*results[-1])
        return results

    def run(self, row: Row) -> RowResult:
        """Return the stored or new result of a row; a failure is a result, too."""
        done = self.known(row)  # tables share rows
        if done is not None:
            return done
        scene, run = self.folders(row)
        try:
            self.simulate(row)
            arguments = (row, scene, run, self.seed_of(row), self.num_threads)
            result, seconds = self._call(make_row, *arguments)
        except (UserError, OSError) as error:
            return RowResult(error=" ".join(str(error).split()))
        result = replace(
            result,
            all_cpu_seconds=seconds,
            folder=str(run.relative_to(self.out)),
            scene_folder=os.path.relpath(scene, self.out),
        )
        run.mkdir(parents=True, exist_ok=True)
        write_json_atomic(run / RESULT_NAME, {"row": row.name, **asdict(result)})
        return result

    def _call(self, function: Callable[..., _T], *arguments: Any) -> tuple[_T, float]:
        """Call a function in a process of its own -> result, its processor time [s]."""
        if current_process().daemon:  # a worker of dask, which starts no processes
            return time_call(function, *arguments)
        ours, theirs = Pipe(duplex=False)
        process = get_context("spawn").Process(
            target=send_answer, args=(theirs, function, *arguments), daemon=True
        )
        process.start()
        theirs.close()
        try:
            answer = ours.recv()
        except EOFError:
            process.join()
            code = process.exitcode or 0
            name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
            raise UserError(what=f"its process was ended: {name}") from None
        finally:
            process.terminate()
            process.join(_PATIENCE_S)
            process.kill()
        if isinstance(answer, str):
            raise UserError(what=answer)
        found: tuple[_T, float] = answer
        return found

    def known(self, row: Row) -> RowResult | None:
        """Return the stored result of a row; None without one."""
        values = read_record(self.folders(row).run / RESULT_NAME)
        own = {
            entry.name: values[entry.name] for entry in fields(RowResult) if entry.name in values
        }
        return RowResult(**own) if own else None

    def folders(self, row: Row) -> Folders:
        """Folders of a row's scene and result."""
        how, case = row.how, row.case
        scene = stage_key(
            version=SCENE_VERSION,
            spec=row.spec,
            seed=self.seed_of(row),
            told=case.given_permittivity,
        )
        run = stage_key(
            version=RESULT_VERSION,
            scene=scene,
            kind=how.kind,
            settings=row.config,
            shift=case.prior_shift_m,
            stages=row.versions,
            seed=self.seed_of(row),
            options=how.options,
        )
        return Folders(
            (self.cache or self.out) / SCENES_FOLDER / f"{row.scene}-{scene[:10]}",
            self.out / RUNS_FOLDER / f"{row.scene}-{row.method}-{run[:10]}",
        )

    def seed_of(self, row: Row) -> int:
        """Seed of a row."""
        return self.seed if row.seed is None else row.seed

    def simulate(self, row: Row) -> None:
        """Simulate the scene of a row, unless it exists; UserError."""
        scene, permittivity = self.folders(row).scene, row.case.given_permittivity
        if scene.is_dir():  # made whole or not at all
            return
        scene.parent.mkdir(parents=True, exist_ok=True)
        write_toml(scene.with_suffix(".toml"), row.spec)
        if permittivity == "true":
            arguments = (row.spec, scene, self.seed_of(row), self.num_threads)
            self._call(make_scene, *arguments)
            return
        true_row = with_true_walls(row)
        self.simulate(true_row)
        true_scene = self.folders(true_row).scene
        self._call(copy_with_walls, true_scene, scene, permittivity)


def time_call(function: Callable[..., _T], *arguments: Any) -> tuple[_T, float]:
    """Return the result of a function, and the processor time of the call [s]."""
    start = time.process_time()
    return function(*arguments), time.process_time() - start


def send_answer(connection: Connection, function: Callable[..., Any], *arguments: Any) -> None:
    """Send the result of a call with its processor time, or its error as one line.

    A training that is ended stores a checkpoint, as after Ctrl-C, which is for the parent.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        answer: Any = time_call(function, *arguments)
    except KeyboardInterrupt:
        return
    except UserError as error:
        answer = error.args[0]
    except Exception as error:
        answer = f"{type(error).__name__}: {' '.join(str(error).split())}"
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # it is ended once the answer has arrived
    connection.send(answer)


def with_true_walls(row: Row) -> Row:
    """Return the same row with the true walls recorded in its scene."""
    return replace(row, case=replace(row.case, given_permittivity="true"))


def run_on_workers(
    runner: Runner,
    rows: Sequence[Row],
    on_result: Callable[[Row, RowResult], None],
    options: BatchOptions,
) -> list[tuple[Row, RowResult]]:
    """Results of rows by workers of dask: first the scenes, each once, then the rows.

    UserError before any work where no scheduler answers, or workers have another geraf2.
    """
    cache = None if runner.cache is None else runner.cache.resolve()
    runner = replace(runner, out=runner.out.resolve(), cache=cache)
    alike: dict[Path, list[Row]] = {}  # tables share rows
    for row in rows:
        alike.setdefault(runner.folders(row).run, []).append(row)
    found = {run: runner.known(same[0]) for run, same in alike.items()}
    remaining = [same[0] for run, same in alike.items() if found[run] is None]
    true_scenes = {runner.folders(row).scene: row for row in map(with_true_walls, remaining)}
    others = {runner.folders(row).scene: row for row in remaining}

    def report(run: Path, result: RowResult) -> None:
        found[run] = result
        for row in alike[run]:
            on_result(row, result)

    for run, result in list(found.items()):
        if result is not None:
            report(run, result)
    if remaining:
        with connect_workers(options) as client:
            for scenes in (true_scenes, others):  # others are copies of true scenes
                missing = [row for scene, row in scenes.items() if not scene.is_dir()]
                for _ in _answers(client, Runner.simulate, runner, missing):
                    pass  # a failed scene fails again with its row, which reports the reason
            for row, answer in _answers(client, Runner.run, runner, remaining):
                is_lost = isinstance(answer, Failure)
                result = RowResult(error=answer.error) if is_lost else answer
                report(runner.folders(row).run, result)
    return [(row, found[runner.folders(row).run] or RowResult()) for row in rows]


def _answers(
    client: "Client", function: Callable[..., Any], runner: Runner, rows: Sequence[Row]
) -> Iterator[tuple[Row, Any]]:
    named = {f"{number}-{row.name}": row for number, row in enumerate(rows)}
    tasks = (Task(name=name, arguments=(runner, row)) for name, row in named.items())
    for name, answer in drive(client, function, tasks):
        yield named[name], answer


def read_record(path: Path) -> dict[str, Any]:
    """Contents of a record; empty where it is missing or broken."""
    with suppress(UserError):
        return read_object(path)
    return {}
