"""Slabs of one image on a scheduler's workers (`geraf2.pipeline.commands.image_tiles`)."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

from geraf2.apps.batch.cluster import connected, require_workers, tend, worker_memory
from geraf2.apps.batch.engine import Answer, Task, drive
from geraf2.apps.batch.folder import TRIED_AGAIN
from geraf2.apps.batch.options import BatchOptions
from geraf2.apps.batch.running import is_killed
from geraf2.apps.batch.work import state_of
from geraf2.errors import UserError
from geraf2.pipeline.commands.image_tiles import RunSlabs, SlabJob, image_slab

if TYPE_CHECKING:
    from distributed import Client

# A slab is blamed for each worker that dies while it waits there, so that some more are forgiven.
_MOST_LOSSES = 10


@contextmanager
def slab_workers(options: BatchOptions, num_threads: int = 1) -> Iterator[RunSlabs]:
    """Lend workers that image slabs; UserError where no scheduler answers.

    options: scheduler, or workers of this machine; retries. num_threads: of each slab.
    """
    with connected(options, 0.0) as client:
        require_workers(client)
        yield lambda job, left: run_slabs(client, job, left, options.retries, num_threads)


def run_slabs(
    client: "Client", job: SlabJob, left: list[int], retries: int = 2, num_threads: int = 1
) -> Iterator[int]:
    """Image slabs on workers, and yield the number of each that is done.

    A slab whose files or worker were lost is tried again. Raises UserError for the others, and
    before the work where no worker can hold one.
    """
    most, is_declared = worker_memory(client)
    if most is not None and job.memory_bytes > most:
        raise UserError(
            what="no worker can hold a slab",
            expected=f"about {job.memory_bytes / 2**30:.2g} GiB",
            got=f"{most / 2**30:.2g} GiB on the largest worker",
            hint="lower --slab-gib, or take larger workers",
        )
    tasks = (
        Task(name=f"slab-{n}", arguments=(job, n, num_threads), memory_bytes=job.memory_bytes)
        for n in left
    )

    def again(task: Task, answer: Answer) -> Task | None:
        if is_killed(answer) and task.losses < _MOST_LOSSES:
            return replace(task, losses=task.losses + 1)
        is_lost = isinstance(answer, BaseException) and state_of(answer) in TRIED_AGAIN
        if is_lost and task.attempt <= retries:
            return replace(task, attempt=task.attempt + 1)
        return None

    answers = drive(
        client, image_slab, tasks, again, declare_memory=is_declared, tend=lambda: tend(client)
    )
    for task, answer in answers:
        if isinstance(answer, UserError):
            raise answer
        if isinstance(answer, BaseException):
            reason = " ".join(str(answer).split()) or type(answer).__name__
            raise UserError(what=f"{task.name} could not be imaged: {reason}", where=job.scene)
        yield int(answer)
