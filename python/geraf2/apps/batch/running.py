"""A batch: what is not done yet goes to the workers, what comes back is on the disk already."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from geraf2 import __version__
from geraf2.apps.batch.cluster import connected, require_workers, tend, worker_memory
from geraf2.apps.batch.engine import Answer, Task, drive
from geraf2.apps.batch.folder import (
    BUSY,
    FAILED,
    KILLED,
    TRIED_AGAIN,
    BatchFolder,
    JobResult,
    Place,
    asked_of,
)
from geraf2.apps.batch.jobs import BatchJob, distinct
from geraf2.apps.batch.options import BatchOptions
from geraf2.apps.batch.plan import Plan
from geraf2.apps.batch.work import do_job, state_of
from geraf2.errors import UserError
from geraf2.io.toml import to_table
from geraf2.pipeline.estimates import n_threads

if TYPE_CHECKING:
    from distributed import Client

# Of the time of a batch that goes into its page while it runs.
_PAGE_SHARE = 0.02
_BUSY_S = 2.0
# Workers that die while a task only waits there: a cluster that cannot work, not a bad task.
_MOST_LOSSES = 50


def run(
    jobs: Sequence[BatchJob],
    out: Path | str,
    client: "Client | None" = None,
    on_result: Callable[[JobResult], None] = lambda result: None,
    *,
    options: BatchOptions | None = None,
) -> list[JobResult]:
    """Do all jobs that `out` does not hold yet, and write batch.html and batch.csv.

    jobs: of distinct scenes. out: folder of the batch, on a disk that all workers see.
    client: of a dask scheduler; processes of this machine, or options.scheduler, where None.
    on_result: is told what became of each job, at once of those that were done before.
    options: workers, retries, time limit.

    Returns what became of the jobs, in their order. A job that fails is a result, no error. Raises
    UserError before any work for jobs, folder or workers that do not fit.
    """
    options = options or BatchOptions()
    asked = distinct(job.resolved() for job in jobs)
    plan = Plan.of(asked, BatchFolder(out), report=options.report)
    entries, left = plan.folder.merged(plan.jobs), plan.left()
    lent: AbstractContextManager[Client | None] = nullcontext(client)
    if left and client is None:
        lent = connected(options, max(map(_memory_bytes, left.values())))
    with lent as one:
        results: Iterator[JobResult] = iter(())
        if left and one is not None:
            require_workers(one)
            _require_memory(one, left)
            results = _results(one, plan, options, is_local=client is None)
        plan.folder.keep(entries)
        for result in plan.known.values():
            on_result(result)
        try:
            for result in results:
                plan.known[result.key] = result
                on_result(result)
                plan.draw(_PAGE_SHARE)
        finally:
            plan.draw()
    return [plan.known[key] for key in plan.jobs]


def _results(
    client: "Client", plan: Plan, options: BatchOptions, *, is_local: bool
) -> Iterator[JobResult]:
    """Yield what becomes of the jobs that are left."""
    left, is_declared = plan.left(), worker_memory(client)[1]
    num_threads = options.threads or 1
    if options.threads is None and is_local and options.scheduler is None:
        num_threads = max(1, n_threads() // max(1, len(client.nthreads())))
    how = {
        "num_threads": num_threads,
        "timeout_s": options.timeout_s,
        "report": options.report,
        "version": __version__,
    }

    def tasks() -> Iterator[Task]:
        for key, job in left.items():
            plan.place(key).forget_begins()  # under a client that is gone
            yield Task(
                name=key,
                arguments=(to_table(job), str(plan.folder.out), key),
                options={**how, "attempt": 1},
                memory_bytes=_memory_bytes(job),
            )

    def again(task: Task, answer: Answer) -> Task | None:
        return _again(task, answer, plan.place(task.name), options.retries)

    answers = drive(
        client,
        do_job,
        tasks(),
        again,
        declare_memory=is_declared,
        tend=lambda: tend(client),
    )
    for task, answer in answers:
        yield _result(plan.place(task.name), left[task.name], task, answer)


def _again(task: Task, answer: Answer, place: Place, retries: int) -> Task | None:
    """Task to be tried once more after an answer; None where that would not help."""
    if isinstance(answer, dict) and answer["state"] == BUSY:
        return replace(task, rest_s=_BUSY_S)
    if is_killed(answer):
        # Its worker died: whether because of this task, which may only have waited there, says
        # how often it was begun.
        if len(place.begins()) > retries or task.losses >= _MOST_LOSSES:
            return None
        return replace(task, losses=task.losses + 1, rest_s=0.0)
    if task.attempt > retries or _state(answer) not in TRIED_AGAIN:
        return None
    n = task.attempt + 1
    return replace(task, attempt=n, options={**task.options, "attempt": n}, rest_s=0.0)


def _result(place: Place, job: BatchJob, task: Task, answer: Answer) -> JobResult:
    """Record of a job that will not be tried again; written here where no worker could."""
    found = place.read()
    if isinstance(answer, dict) and found is not None and found.state == answer["state"]:
        return found
    begins = place.begins()
    line = answer["error"] if isinstance(answer, dict) else " ".join(str(answer).split())
    if is_killed(answer):
        line = f"its worker died {len(begins)} times while it ran"
    result = JobResult(
        key=place.key,
        scene=place.scene,
        preset=job.config.preset,
        state=_state(answer),
        asked=asked_of(job),
        error=line,
        attempts=max(task.attempt, len(begins)),
        worker=begins[-1] if begins else "",
    )
    if not isinstance(answer, dict):  # else the worker has written it, and this disk is late
        place.write(result)
    return result


def _state(answer: Answer) -> str:
    if isinstance(answer, dict):
        return str(answer["state"])
    if is_killed(answer):
        return KILLED
    return state_of(answer) if isinstance(answer, (OSError, UserError)) else FAILED


def is_killed(answer: Answer) -> bool:
    """Whether a task ended with its worker."""
    from distributed import KilledWorker  # noqa: PLC0415 - an extra

    return isinstance(answer, KilledWorker)


def _memory_bytes(job: BatchJob) -> float:
    estimate = job.estimate
    return estimate.memory_bytes if estimate else 0.0


def _require_memory(client: "Client", jobs: Mapping[str, BatchJob]) -> None:
    """Refuse a job that no worker can hold."""
    most, _ = worker_memory(client)
    for job in jobs.values():
        if most is not None and _memory_bytes(job) > most:
            raise UserError(
                what="no worker can hold it",
                where=job.scene,
                expected=f"about {_memory_bytes(job) / 2**30:.1f} GiB",
                got=f"{most / 2**30:.1f} GiB on the largest worker",
                hint="take fewer --workers, or larger ones",
            )
