"""`geraf2 belt`: a stream of parcels is cut, and each parcel is reconstructed by a worker."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Interval

from geraf2._bounds import LengthM
from geraf2.apps.batch import BatchFolder, BatchJob, BatchOptions, JobResult
from geraf2.apps.batch.cluster import connect_workers
from geraf2.apps.batch.engine import BAD_INPUT, Failure, Task, drive
from geraf2.apps.batch.folder import DONE, JobPaths
from geraf2.apps.batch.page import NUMBERS, Pages
from geraf2.apps.batch.running import job_threads, record_answer
from geraf2.apps.batch.work import do_job, is_answer
from geraf2.apps.belt.cutting import Cutter, Span
from geraf2.apps.belt.monostatic import list_wide_baselines
from geraf2.apps.belt.parcel import cut_parcel
from geraf2.apps.live.sources import SceneSource
from geraf2.errors import UserError
from geraf2.io.belt_file import is_belt, read_belt
from geraf2.io.container import SceneReader, is_scene
from geraf2.io.run_folder import stage_key
from geraf2.pipeline.presets import PresetConfig, preset_type, versions_of

PARCELS_FOLDER, STEM = "parcels", "parcels"
_POLL_S = 0.2
_N_ON_PAGE = 200
_GOAL_PER_HOUR = 6000
_NUMBERS = (
    ("position_m", "position [m]", 3),
    ("length_m", "length [m]", 3),
    ("travel_percent", "travel [%]", 2),
    ("yaw_deg_per_m", "yaw [degrees/m]", 2),
    *NUMBERS,
)


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

    stream: scene folder with belt.json, which may grow. out: folder for parcels/, runs/, results/
    and parcels.html. on_line: receives a line for each parcel, and for each plane or
    parcel that cannot be used.

    Parcels that came while others were reconstructed wait in the stream. Finished ones are kept:
    after a stop the same call continues. Raises UserError where the stream is none, or has no
    parcel.
    """
    options, stream, out = options or BeltOptions(), stream.absolute(), out.absolute()
    config = preset_type(preset)() if isinstance(preset, str) else preset
    settings = stage_key(
        stream=stream, config=config, stages=versions_of(config), longest_m=options.longest_m
    )
    folder = BatchFolder(out, settings)
    folder.require_own()
    spans = _spans(stream, options, on_line)
    first = next(span for span in spans if span)  # errors of the stream leave no folder
    folder.add({})
    for line in list_wide_baselines(read_belt(stream), SceneReader(stream).manifest.waveform):
        on_line(line)
    table = _Table(out, config.preset, on_line)

    def tasks(threads: int) -> Iterator[Task | None]:
        for span in chain([first], spans):
            if span is None:
                yield None
                continue
            name = f"parcel-{span.number:05d}"
            paths = table.paths(stage_key(settings=settings, span=span), name)
            known = paths.read()
            if known is not None and is_answer(known, paths, report=options.report):
                table.take(paths.key, known)
            elif span.problem:
                failure = Failure(state=BAD_INPUT, error=span.problem)
                table.take(paths.key, failure, _place(span))
            else:
                job = BatchJob(scene=out / PARCELS_FOLDER / name, config=config)
                arguments = stream, span, job, paths, threads, options.report
                yield Task(name=paths.key, arguments=arguments)

    with connect_workers(options) as client:
        waiting = tasks(job_threads(client, options))
        try:
            for key, answer in drive(client, do_parcel, waiting, retries=options.retries):
                table.take(key, answer)
        finally:
            table.draw()
    return table.outcome()


def do_parcel(
    stream: Path, span: Span, job: BatchJob, paths: JobPaths, num_threads: int, report: bool
) -> JobResult:
    """Cut a parcel out of a stream and reconstruct it, on a worker."""
    start = time.process_time()
    motion = cut_parcel(stream, job.scene, span, num_threads=num_threads)
    numbers = {**_place(span), "cutting_cpu_seconds": round(time.process_time() - start, 3)}
    if motion.n_pairs:
        numbers |= {
            "travel_percent": round(100.0 * motion.scale, 4),
            "travel_sigma_percent": round(100.0 * motion.scale_sigma, 4),
            "yaw_deg_per_m": round(float(np.rad2deg(motion.turn_rad_per_m)), 3),
        }
    return do_job(job, paths, num_threads, report, numbers)


def _place(span: Span) -> dict[str, float]:
    return {
        "position_m": round(span.middle_m, 4),
        "length_m": round(span.end_m - span.start_m, 4),
    }


class _Table:
    """Results of the parcels, as they come."""

    def __init__(self, out: Path, preset: str, on_line: Callable[[str], None]) -> None:
        self.out, self.preset, self.on_line = out, preset, on_line
        self._pages = Pages(out, f"geraf2 belt {out.name}", STEM, _NUMBERS, _N_ON_PAGE)
        self._paths, self._results = dict[str, JobPaths](), dict[str, JobResult]()
        self._start = time.monotonic()

    def paths(self, key: str, name: str) -> JobPaths:
        """Paths of a parcel's files."""
        self._paths[key] = JobPaths(self.out, key, name)
        return self._paths[key]

    def take(
        self, key: str, answer: JobResult | Failure, numbers: dict[str, float] | None = None
    ) -> None:
        """Keep a result."""
        result = record_answer(answer, self._paths[key], self.preset, numbers)
        self._results[key] = result
        error = result.numbers.get("typical_error_mm")
        text = "" if error is None else f", typical error {error:.1f} mm"
        self.on_line(f"{result.line}{text}")
        self._pages.draw_sometimes(lambda: list(self._paths.values()), self._results)

    def draw(self) -> None:
        """Write the page."""
        self._pages.draw(list(self._paths.values()), self._results)

    def outcome(self) -> BeltOutcome:
        """Totals."""
        done = [result for result in self._results.values() if result.state == DONE]
        spent = [r.cpu_seconds + r.numbers["cutting_cpu_seconds"] for r in done]
        return BeltOutcome(
            n_done=len(done),
            n_failed=len(self._results) - len(done),
            seconds=time.monotonic() - self._start,
            cpu_seconds=float(np.mean(spent)) if spent else 0.0,
        )


def _spans(
    stream: Path, options: BeltOptions, on_line: Callable[[str], None]
) -> Iterator[Span | None]:
    """Yield parcels as they come, until no more come; None where there is none at present."""
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
        spans = list(cutter.pop_parcels(is_last=is_last))
        for span in spans:
            yield span
            last = time.monotonic()  # while all workers are busy, nobody looks for planes
        if is_last and not spans:
            if not cutter.n_found:
                raise UserError(
                    what="no parcel is seen",
                    where=stream,
                    expected="power of the arrays that rises by 6 dB above the empty belt",
                )
            return
        time.sleep(_POLL_S)
        yield None
