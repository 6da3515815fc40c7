"""Run of a batch: remaining jobs go to the workers, which write the results."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from geraf2 import __version__
from geraf2.apps.batch.cluster import (
    connected,
    require_memory,
    require_workers,
    tend,
    worker_memory,
)
from geraf2.apps.batch.engine import Answer, Task, drive
from geraf2.apps.batch.folder import (
    BUSY,
    FAILED,
    KILLED,
    TRIED_AGAIN,
    BatchFolder,
    JobPaths,
    JobResult,
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

# Share of the time of a running batch that is spent on its page.
_PAGE_SHARE = 0.02
_BUSY_S = 2.0
# Most losses of a waiting task, which is lost with each worker where it waits: beyond that the
# cluster is broken. Jobs wait in larger numbers than the tasks of `if_lost`.
_MAX_LOSSES, MAX_LOSSES = 50, 10


def run(
    jobs: Sequence[BatchJob],
    out: Path | str,
    client: "Client | None" = None,
    on_result: Callable[[JobResult], None] = lambda result: None,
    *,
    options: BatchOptions | None = None,
    is_part: bool = False,
) -> list[JobResult]:
    """Do all jobs that are not done yet, and write batch.html and batch.csv.

    jobs: of distinct scenes. out: folder of the batch, on a disk shared by all workers.
    client: of a dask scheduler; None: processes of this machine, or options.scheduler.
    on_result: called with each result, first with those of earlier runs.
    options: workers, retries, time limit. is_part: of a batch that grows; results of other jobs are
    not read, and no page is written.

    Returns the results in the order of the jobs. A failed job is a result, no error. Raises
    UserError before any work for unusable jobs, folder or workers.
    """
    options = options or BatchOptions()
    resolved = distinct(job.resolved() for job in jobs)
    plan = Plan.of(resolved, BatchFolder(out), report=options.report)
    entries, remaining = plan.folder.merged(plan.jobs, is_part=is_part), plan.remaining()
    connection: AbstractContextManager[Client | None] = nullcontext(client)
    if remaining and client is None:
        connection = connected(options, max(map(_memory_bytes, remaining.values())))
    with connection as one:
        results: Iterator[JobResult] = iter(())
        if remaining and one is not None:
            require_workers(one)
            largest = max(remaining.values(), key=_memory_bytes)
            hint = "take fewer --workers, or larger ones"
            require_memory(one, _memory_bytes(largest), where=largest.scene, hint=hint)
            results = _results(one, plan, options, is_local=client is None)
        plan.folder.keep(entries)
        for result in plan.known.values():
            on_result(result)
        try:
            for result in results:
                plan.known[result.key] = result
                on_result(result)
                if not is_part:
                    plan.draw(_PAGE_SHARE)
        finally:
            if not is_part:
                plan.draw()
    return [plan.known[key] for key in plan.jobs]


def _results(
    client: "Client", plan: Plan, options: BatchOptions, *, is_local: bool
) -> Iterator[JobResult]:
    """Yield the results of the remaining jobs."""
    remaining, is_declared = plan.remaining(), worker_memory(client)[1]
    num_threads = options.threads or 1
    if options.threads is None and is_local and options.scheduler is None:
        num_threads = max(1, n_threads() // max(1, len(client.nthreads())))
    settings = {
        "num_threads": num_threads,
        "timeout_s": options.timeout_s,
        "report": options.report,
        "version": __version__,
    }

    def tasks() -> Iterator[Task]:
        for key, job in remaining.items():
            plan.paths(key).forget_begins()  # of an earlier client
            yield Task(
                name=key,
                arguments=(to_table(job), str(plan.folder.out), key),
                options={**settings, "attempt": 1},
                memory_bytes=_memory_bytes(job),
            )

    def again(task: Task, answer: Answer) -> Task | None:
        return _again(task, answer, plan.paths(task.name), options.retries)

    answers = drive(
        client,
        do_job,
        tasks(),
        again,
        declare_memory=is_declared,
        tend=lambda: tend(client),
    )
    for task, answer in answers:
        yield _result(plan.paths(task.name), remaining[task.name], task, answer)


def _again(task: Task, answer: Answer, paths: JobPaths, retries: int) -> Task | None:
    """Task to be repeated after an answer; None where that would not help."""
    if isinstance(answer, dict) and answer["state"] == BUSY:
        return replace(task, rest_s=_BUSY_S)
    if is_killed(answer):
        # Its worker died, possibly by another task: the number of starts decides.
        if len(paths.begins()) > retries or task.losses >= _MAX_LOSSES:
            return None
        return replace(task, losses=task.losses + 1, rest_s=0.0)
    if task.attempt > retries or _state(answer) not in TRIED_AGAIN:
        return None
    n = task.attempt + 1
    return replace(task, attempt=n, options={**task.options, "attempt": n}, rest_s=0.0)


def _result(paths: JobPaths, job: BatchJob, task: Task, answer: Answer) -> JobResult:
    """Record of a finished job, written here where its worker could not."""
    found = paths.read()
    if isinstance(answer, dict) and found is not None and found.state == answer["state"]:
        return found
    begins = paths.begins()
    line = answer["error"] if isinstance(answer, dict) else " ".join(str(answer).split())
    if is_killed(answer):
        line = f"its worker died {len(begins)} times while it ran"
    result = JobResult(
        key=paths.key,
        scene=paths.scene,
        preset=job.config.preset,
        state=_state(answer),
        asked=asked_of(job),
        error=line,
        attempts=max(task.attempt, len(begins)),
        worker=begins[-1] if begins else "",
    )
    if not isinstance(answer, dict):  # else the worker has written it, not yet visible here
        paths.write(result)
    return result


def _state(answer: Answer) -> str:
    if isinstance(answer, dict):
        return str(answer["state"])
    if is_killed(answer):
        return KILLED
    return state_of(answer) if isinstance(answer, (OSError, UserError)) else FAILED


def is_killed(answer: Answer) -> bool:
    """Whether a task was lost with its worker."""
    from distributed import KilledWorker  # noqa: PLC0415 - an extra

    return isinstance(answer, KilledWorker)


def if_lost(task: Task, answer: Answer) -> Task | None:
    """Return a task lost with its worker for repetition, at most MAX_LOSSES times."""
    if is_killed(answer) and task.losses < MAX_LOSSES:
        return replace(task, losses=task.losses + 1)
    return None


def _memory_bytes(job: BatchJob) -> float:
    estimate = job.estimate
    return estimate.memory_bytes if estimate else 0.0
