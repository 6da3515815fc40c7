"""Run of a batch: remaining jobs go to the workers, which write the results."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from geraf2.apps.batch.cluster import connected, require_workers
from geraf2.apps.batch.engine import Failure, Task, drive
from geraf2.apps.batch.folder import DONE, BatchFolder, JobPaths, JobResult
from geraf2.apps.batch.jobs import BatchJob, distinct
from geraf2.apps.batch.options import BatchOptions
from geraf2.apps.batch.page import Pages
from geraf2.apps.batch.work import do_job, is_answer
from geraf2.pipeline.estimates import n_threads

if TYPE_CHECKING:
    from distributed import Client


@dataclass(frozen=True)
class Plan:
    """Jobs of a batch and their results, by key."""

    folder: BatchFolder
    jobs: dict[str, BatchJob]
    """In the order of the request."""
    known: dict[str, JobResult]
    """Results, also of failed jobs that would be repeated."""
    remaining: dict[str, BatchJob]

    @classmethod
    def of(cls, jobs: Iterable[BatchJob], folder: BatchFolder, *, report: bool = False) -> "Plan":
        """Plan of some jobs with their results in a folder."""
        by_key = {job.key: job for job in jobs}
        paths = {key: folder.paths(key, job) for key, job in by_key.items()}
        read = {key: own.read() for key, own in paths.items()}
        known = {key: result for key, result in read.items() if result is not None}
        remaining = {
            key: job
            for key, job in by_key.items()
            if key not in known or not is_answer(known[key], paths[key], report=report)
        }
        return cls(folder, by_key, known, remaining)

    @property
    def n_failed(self) -> int:
        """Number of failed jobs."""
        return sum(result.state != DONE for result in self.known.values())

    def listed(self) -> list[tuple[str, str]]:
        """Lines of `--list`: state of each scene, and totals with the remaining time."""
        lines = []
        for key, job in self.jobs.items():
            _, _, state = (self.known[key].line if key in self.known else "").partition(": ")
            lines.append((job.scene.name, state or "to do"))
        n_done = sum(result.state == DONE for result in self.known.values())
        text = f"{len(self.jobs)} scenes, {n_done} done, {self.n_failed} failed"
        if self.remaining:
            minutes = self._seconds_remaining() / 60.0
            text += f", {len(self.remaining)} to do in about {minutes:.1f} CPU minutes"
        return [*lines, ("all", text)]

    def _seconds_remaining(self) -> float:
        """Processor time of the remaining jobs: mean of finished ones, else by size [s]."""
        spent: dict[str, list[float]] = {}
        for result in self.known.values():
            if result.state == DONE:
                spent.setdefault(result.preset, []).append(result.cpu_seconds)
        total = 0.0
        for job in self.remaining.values():
            own, estimate = spent.get(job.config.preset), job.estimate
            total += sum(own) / len(own) if own else estimate.seconds if estimate else 0.0
        return total


def run(
    jobs: Sequence[BatchJob],
    out: Path | str,
    client: "Client | None" = None,
    on_result: Callable[[JobResult], None] = lambda result: None,
    *,
    options: BatchOptions | None = None,
) -> list[JobResult]:
    """Do all jobs that are not done yet, and write batch.html and batch.csv.

    jobs: of distinct scenes. out: folder of the batch, on a disk shared by all workers.
    client: of a dask scheduler; None: processes of this machine, or options.scheduler.
    on_result: called with each result, first with those of earlier runs.
    options: workers and retries.

    Returns the results in the order of the jobs. A failed job is a result, no error. Raises
    UserError before any work for unusable jobs, folder or workers.
    """
    options = options or BatchOptions()
    resolved = distinct(job.resolved() for job in jobs)
    plan = Plan.of(resolved, BatchFolder(out), report=options.report)
    plan.folder.require_own(plan.jobs)
    sizes = {key: _memory_bytes(job) for key, job in plan.remaining.items()}
    connection: AbstractContextManager[Client | None] = nullcontext(client)
    if sizes and client is None:
        connection = connected(options, max(sizes.values()))
    with connection as one:
        if sizes and one is not None:
            require_workers(one)
        plan.folder.add(plan.jobs)
        for key in (key for key in plan.jobs if key not in sizes):
            on_result(plan.known[key])
        pages = Pages(plan.folder.out, f"geraf2 batch {plan.folder.out.name}")
        try:
            if sizes and one is not None:
                threads = threads_of(one, options)
                tasks = (
                    Task(
                        name=key,
                        arguments=(job, plan.folder.paths(key, job), threads, options.report),
                        memory_bytes=sizes[key],
                    )
                    for key, job in plan.remaining.items()
                )
                for key, answer in drive(one, do_job, tasks, retries=options.retries):
                    job = plan.jobs[key]
                    result = record_answer(answer, plan.folder.paths(key, job), job.config.preset)
                    plan.known[key] = result
                    on_result(result)
                    pages.draw_sometimes(plan.folder.all_paths, plan.known)
        finally:
            pages.draw(plan.folder.all_paths(), plan.known)
    return [plan.known[key] for key in plan.jobs]


def threads_of(client: "Client", options: BatchOptions) -> int:
    """Threads of each job: as asked for, else the share of a process of this machine."""
    if options.threads is not None:
        return options.threads
    is_local = client.cluster is not None
    return max(1, n_threads() // max(1, len(client.nthreads()))) if is_local else 1


def record_answer(
    answer: JobResult | Failure,
    paths: JobPaths,
    preset: str,
    numbers: Mapping[str, float] | None = None,
) -> JobResult:
    """Return the result of a job; that of a failure is written here."""
    if isinstance(answer, JobResult):
        return answer
    result = JobResult(
        key=paths.key,
        scene=paths.scene,
        preset=preset,
        state=answer.state,
        error=answer.error,
        numbers=dict(numbers or {}),
        log_tail=answer.log_tail,
    )
    paths.write(result)
    return result


def _memory_bytes(job: BatchJob) -> float:
    estimate = job.estimate
    return estimate.memory_bytes if estimate else 0.0
