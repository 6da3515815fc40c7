"""Runs rows: scenes and results are kept by what they were made from."""

import json
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

from geraf2.benchmark.making import make_row, make_scene, tell_walls
from geraf2.benchmark.rows import Row, RowResult
from geraf2.errors import UserError
from geraf2.io.atomic import write_json_atomic
from geraf2.io.run_folder import stage_key
from geraf2.io.toml import write_toml
from geraf2.pipeline.processes import Processes

RESULT_NAME = "result.json"
SCENES_FOLDER, RUNS_FOLDER = "scenes", "runs"
# Raised when the simulator or the evaluation gives something else from the same spec.
_SCENE_VERSION, _RESULT_VERSION = 1, 3
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
    _locks: dict[Path, threading.Lock] = field(default_factory=dict)
    _guard: threading.Lock = field(default_factory=threading.Lock)

    def run_all(
        self, rows: Sequence[Row], told: Callable[[Row, RowResult], None], *, jobs: int = 1
    ) -> list[tuple[Row, RowResult]]:
        """Figures of rows, `jobs` of them at a time; each is told, in the order of the rows.

        Where it is interrupted, or `told` raises, the processes end, too.
        """
        results = []
        with ThreadPoolExecutor(jobs) as pool:
            try:
                for row, result in zip(rows, pool.map(self.run, rows), strict=True):
                    results.append((row, result))
                    told(row, result)
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                self._processes.stop()
                raise
        return results

    def run(self, row: Row) -> RowResult:
        """Figures of a row: from an earlier run, or a new one; a failure is its result."""
        scene, run = self.place(row)
        with self._lock(run):  # tables share rows
            done = self.known(row)
            if done is not None:
                return done
            try:
                self._simulate(row, scene)
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

    def _lock(self, folder: Path) -> threading.Lock:
        with self._guard:
            return self._locks.setdefault(folder, threading.Lock())

    def _simulate(self, row: Row, scene: Path) -> None:
        told = row.case.told_permittivity
        with self._lock(scene):
            if scene.is_dir():  # made whole or not at all
                return
            scene.parent.mkdir(parents=True, exist_ok=True)
            write_toml(scene.with_suffix(".toml"), row.spec)
            if told == "true":
                arguments = (row.spec, scene, self.seed, self.num_threads)
                _, spent = self._processes.call(make_scene, *arguments)
                write_json_atomic(scene.with_suffix(".json"), {"cpu_seconds": spent})
                return
            plain = replace(row, case=replace(row.case, told_permittivity="true"))
            true_scene = self.place(plain).scene
            self._simulate(plain, true_scene)
            self._processes.call(tell_walls, true_scene, scene, told)


def _read(path: Path) -> dict[str, Any]:
    """Read a record; an empty one where there is none, or it is broken."""
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return values if isinstance(values, dict) else {}
