"""Run of a batch: remaining jobs go to the workers, which write the results."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from geraf2.apps.batch.cluster import connect_workers, require_workers
from geraf2.apps.batch.engine import Failure, Task, drive
from geraf2.apps.batch.folder import BatchFolder, JobPaths, JobResult
from geraf2.apps.batch.jobs import BatchJob, require_distinct
from geraf2.apps.batch.options import BatchOptions
from geraf2.apps.batch.page import Pages
from geraf2.apps.batch.work import do_job, is_answer
from geraf2.errors import UserError
from geraf2.pipeline.estimates import n_threads

if TYPE_CHECKING:
    from distributed import Client


def run(
    jobs: Sequence[BatchJob],
    out: Path | str,
    client: "Client | None" = None,
    on_result: Callable[[JobResult], None] = lambda result: None,
    *,
    options: BatchOptions | None = None,
) -> list[JobResult]:
    """Do all jobs that are not done yet, and write batch.html.

    jobs: of distinct scenes and the same settings. out: folder, on a disk shared by all workers.
    client: of a dask scheduler; None: processes of this machine, or options.scheduler.
    on_result: called with each result, first with those of earlier runs.
    options: workers and retries.

    Returns the results in the order of the jobs. A failed job is a result, no error. Raises
    UserError before any work for unusable jobs, folder or workers.
    """
    options = options or BatchOptions()
    by_key = {job.key: job for job in require_distinct(job.resolve() for job in jobs)}
    settings = {job.settings for job in by_key.values()}
    if len(settings) > 1:
        raise UserError(what="jobs of different settings", hint="give each settings a batch")
    folder = BatchFolder(out, settings.pop())
    folder.require_own()
    paths = {key: JobPaths(folder.out, key, job.scene.name) for key, job in by_key.items()}
    read = {key: own.read() for key, own in paths.items()}
    known = {
        key: result
        for key, result in read.items()
        if result is not None and is_answer(result, paths[key], report=options.report)
    }
    sizes = {key: _memory_bytes(job) for key, job in by_key.items() if key not in known}
    connection: AbstractContextManager[Client | None] = nullcontext(client)
    if sizes and client is None:
        connection = connect_workers(options, max(sizes.values()))
    with connection as one:
        if sizes and one is not None:
            require_workers(one)
        folder.add({job.scene.name: key for key, job in by_key.items()})
        for result in known.values():
            on_result(result)
        pages = Pages(folder.out, f"geraf2 batch {folder.out.name}")
        try:
            if sizes and one is not None:
                threads = job_threads(one, options)
                tasks = (
                    Task(
                        name=key,
                        arguments=(by_key[key], paths[key], threads, options.report),
                        memory_bytes=n_bytes,
                    )
                    for key, n_bytes in sizes.items()
                )
                for key, answer in drive(one, do_job, tasks, retries=options.retries):
                    preset = by_key[key].config.preset
                    known[key] = record_answer(answer, paths[key], preset)
                    on_result(known[key])
                    pages.draw_sometimes(folder.all_paths, known)
        finally:
            pages.draw(folder.all_paths(), known)
    return [known[key] for key in by_key]


def job_threads(client: "Client", options: BatchOptions) -> int:
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
