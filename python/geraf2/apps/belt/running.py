"""`geraf2 belt`: a stream of parcels is cut, and each parcel is reconstructed by a worker."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from annotated_types import Interval

from geraf2._bounds import LengthM
from geraf2.apps.batch import BatchJob, BatchOptions, JobResult, run
from geraf2.apps.batch.child import ChildEndedError, child
from geraf2.apps.batch.cluster import connected, require_workers, tend
from geraf2.apps.batch.engine import Answer, Task, drive
from geraf2.apps.batch.folder import BAD_INPUT, DONE, KILLED, BatchFolder, JobPaths
from geraf2.apps.batch.page import write_last
from geraf2.apps.batch.running import if_lost
from geraf2.apps.belt.cutting import Cutter, Span
from geraf2.apps.belt.monostatic import far_apart
from geraf2.apps.belt.parcel import cut_parcel
from geraf2.apps.belt.store import DATABASE_NAME, PAGE_NAME, ParcelStore
from geraf2.apps.live.sources import SceneSource
from geraf2.errors import UserError
from geraf2.io.belt_file import is_belt, read_belt
from geraf2.io.container import SceneReader, is_scene
from geraf2.io.outputs import require_folder
from geraf2.pipeline.presets import PresetConfig, preset_type

if TYPE_CHECKING:
    from distributed import Client

PARCELS_FOLDER = "parcels"
_POLL_S = 0.2
_N_ON_PAGE = 20
_GOAL_PER_HOUR = 6000


@dataclass(frozen=True, kw_only=True)
class BeltOptions(BatchOptions):
    """Workers, and how a stream is cut."""

    longest_m: LengthM = 0.5
    """Longest parcel; a longer one is several that touch [m]."""
    idle_s: Annotated[float, Interval(ge=0.1, le=1e6)] = 10.0
    """End when no plane came for this time [s]."""


@dataclass(frozen=True, kw_only=True)
class BeltOutcome:
    """Result of a stream."""

    n_done: int
    n_failed: int
    seconds: float
    """From the first parcel to the last result [s]."""
    cpu_seconds: float
    """Processor time of a parcel, mean of those done [s]."""

    @property
    def per_hour(self) -> float:
        """Parcels an hour on these workers."""
        return 3600.0 * self.n_done / max(self.seconds, 1e-9)

    @property
    def cores(self) -> float:
        """Cores for 6,000 parcels an hour."""
        return _GOAL_PER_HOUR * self.cpu_seconds / 3600.0


def run_belt(
    stream: Path,
    out: Path,
    preset: PresetConfig | str = "best",
    *,
    options: BeltOptions | None = None,
    on_line: Callable[[str], None] = lambda line: None,
) -> BeltOutcome:
    """Cut a stream of parcels apart and reconstruct each on a worker.

    stream: scene folder with belt.json, which may grow. out: folder for parcels/, runs/, results/,
    parcels.csv, parcels.sqlite and parcels.html. on_line: receives a line for each parcel, and for
    each plane or parcel that cannot be used.

    Parcels that came while others were reconstructed wait in the stream. Finished ones are kept:
    after a stop the same call continues. Raises UserError where the stream is none, or has no
    parcel.
    """
    options = options or BeltOptions()
    config = preset_type(preset)() if isinstance(preset, str) else preset
    require_folder(out, "belt", own=(out / DATABASE_NAME).is_file())
    with ExitStack() as stack:
        line = _Line(stream, out, config, options, on_line, stack)
        for spans in _sets(stream, options, on_line):
            line.take(spans)
        return line.outcome()


def _sets(
    stream: Path, options: BeltOptions, on_line: Callable[[str], None]
) -> Iterator[list[Span]]:
    """Yield the parcels that came since the last ones, until no more come."""
    last, source, cutter = time.monotonic(), None, None
    while True:
        is_last = time.monotonic() - last > options.idle_s
        if source is None and is_scene(stream) and is_belt(stream):
            source, cutter = SceneSource(stream), Cutter(read_belt(stream), options.longest_m)
        if source is None or cutter is None:
            if is_last:
                read_belt(stream)  # raises the error
                raise UserError(what="no plane came", where=stream)
            time.sleep(_POLL_S)
            continue
        for new in source.poll(is_last=is_last):
            last = time.monotonic()
            try:
                if new.pose is None:
                    raise UserError(what=new.problem)
                n_still = cutter.add(new.pose, int(new.name))
                if n_still:
                    on_line(f"plane {new.pose.name}: the belt stood still for {n_still} frames")
            except UserError as error:
                on_line(f"{error}; left out")
        is_last = is_last or bool(source.ending)
        spans = list(cutter.ready(is_last=is_last))
        if spans:
            yield spans
            last = time.monotonic()
        elif is_last:
            if not cutter.n_found:
                raise UserError(
                    what="no parcel is seen",
                    where=stream,
                    expected="power of the arrays that rises by 6 dB above the empty belt",
                )
            return
        else:
            time.sleep(_POLL_S)


class _Line:
    """Parcels of a stream on their path through the workers."""

    def __init__(
        self,
        stream: Path,
        out: Path,
        config: PresetConfig,
        options: BeltOptions,
        on_line: Callable[[str], None],
        stack: ExitStack,
    ) -> None:
        self.stream, self.out, self.config, self.options = stream, out, config, options
        self.on_line, self.stack, self.store = on_line, stack, ParcelStore(out)
        self.client: Client | None = None
        self.last: list[JobPaths] = []
        self.cut_s: dict[str, float] = {}
        self.cpu_s: list[float] = []
        self.n_failed, self.start = 0, time.monotonic()
        folder = BatchFolder(out)
        folder.keep(folder.jobs() or {})

    def take(self, spans: list[Span]) -> None:
        """Cut and reconstruct some parcels."""
        if self.client is None:
            self.start = time.monotonic()
            waveform = SceneReader(self.stream).manifest.waveform
            for line in far_apart(read_belt(self.stream), waveform):
                self.on_line(line)
            self.client = self.stack.enter_context(connected(self.options, 0.0))
            require_workers(self.client)
        for span in spans:
            values = {"position_m": span.middle_m, "length_m": span.end_m - span.start_m}
            self.store.put(_name(span), {name: round(x, 4) for name, x in values.items()})
        usable = {_name(span): span for span in spans if not span.problem}
        for span in (span for span in spans if span.problem):
            self._failed(_name(span), span.problem)
        for name, answer in self._cut(self.client, usable):
            self._is_cut(name, answer)
        folder = self.out / PARCELS_FOLDER
        jobs = [
            BatchJob(scene=folder / name, config=self.config)
            for name in sorted(usable)
            if is_scene(folder / name)
        ]
        if jobs:
            given = self.options
            run(jobs, self.out, self.client, self._is_done, options=given, is_part=True)

    def _cut(self, client: "Client", spans: dict[str, Span]) -> Iterator[tuple[str, Answer]]:
        tasks = (
            Task(
                name=name,
                arguments=(
                    str(self.stream.absolute()),
                    str((self.out / PARCELS_FOLDER / name).absolute()),
                    [span.low_m, span.middle_m, span.high_m],
                    list(span.planes),
                    self.options.threads or 1,
                ),
            )
            for name, span in spans.items()
        )

        def again(task: Task, answer: Answer) -> Task | None:
            is_killed = isinstance(answer, dict) and answer.get("state") == KILLED
            if is_killed and task.attempt <= self.options.retries:
                return replace(task, attempt=task.attempt + 1)
            return if_lost(task, answer)

        for task, answer in drive(client, _in_child, tasks, again, tend=lambda: tend(client)):
            yield task.name, answer

    def _is_cut(self, name: str, answer: Answer) -> None:
        if not isinstance(answer, dict) or "error" in answer:
            known = answer["error"] if isinstance(answer, dict) else answer
            self._failed(name, " ".join(str(known).split()))
            return
        motion, self.cut_s[name] = answer["motion"], answer["cpu_seconds"]
        if motion["n_pairs"]:
            found = {
                "travel_percent": round(100.0 * motion["scale"], 4),
                "travel_sigma_percent": round(100.0 * motion["scale_sigma"], 4),
                "yaw_deg_per_m": round(float(np.rad2deg(motion["turn_rad_per_m"])), 3),
            }
            self.store.put(name, found)

    def _is_done(self, result: JobResult) -> None:
        """Keep the result of a parcel."""
        name = result.scene
        if result.state != DONE:
            self._failed(name, result.error, result.state)
            return
        cpu_s = self.cut_s.get(name, 0.0) + result.cpu_seconds
        self.cpu_s.append(cpu_s)
        numbers = {**result.numbers, **result.scores}
        values: dict[str, Any] = {
            key: numbers[key]
            for key in ("typical_error_mm", "not_seen_percent", "f1_5mm")
            if key in numbers
        }
        paths = JobPaths(self.out, result.key, name)
        values |= {"state": DONE, "cpu_seconds": round(cpu_s, 2), "attempts": result.attempts}
        values |= {"run": str(paths.run.relative_to(self.out)), "error": ""}
        self.store.put(name, values)
        error = values.get("typical_error_mm")
        text = "" if error is None else f"  typical error {error:.1f} mm"
        self.on_line(f"{name}  done{text}  {cpu_s:.1f} CPU s")
        self.last = sorted([*self.last, paths], key=lambda own: own.scene)[-_N_ON_PAGE:]
        write_last(self.out, PAGE_NAME, self.last)

    def _failed(self, name: str, error: str, state: str = BAD_INPUT) -> None:
        self.n_failed += 1
        self.store.put(name, {"state": state, "error": error})
        self.on_line(f"{name}: {error}")

    def outcome(self) -> BeltOutcome:
        """Totals of this call, after the last parcel."""
        self.store.write_table()
        return BeltOutcome(
            n_done=len(self.cpu_s),
            n_failed=self.n_failed,
            seconds=time.monotonic() - self.start,
            cpu_seconds=float(np.mean(self.cpu_s)) if self.cpu_s else 0.0,
        )


def _name(span: Span) -> str:
    return f"parcel-{span.number:05d}"


def _in_child(*arguments: Any) -> dict[str, Any]:
    """Cut a parcel in a process of its own, which may die."""
    try:
        with child(arguments[-1]) as process:
            return process.call(cut_parcel, *arguments)
    except ChildEndedError as error:
        return {"state": KILLED, "error": f"its process was ended: {error}"}
