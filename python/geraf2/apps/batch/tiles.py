"""Imaging of the slabs of one image on workers (`geraf2.pipeline.commands.image_tiles`)."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

from geraf2.apps.batch.cluster import (
    connected,
    require_memory,
    require_workers,
    tend,
    worker_memory,
)
from geraf2.apps.batch.engine import Answer, Task, drive
from geraf2.apps.batch.folder import TRIED_AGAIN
from geraf2.apps.batch.options import BatchOptions
from geraf2.apps.batch.running import if_lost, is_killed
from geraf2.apps.batch.work import state_of
from geraf2.errors import UserError
from geraf2.pipeline.commands.image_tiles import RunSlabs, SlabJob, image_slab

if TYPE_CHECKING:
    from distributed import Client


@contextmanager
def slab_workers(options: BatchOptions, num_threads: int = 1) -> Iterator[RunSlabs]:
    """Yield a function that images slabs on workers; UserError where no scheduler answers.

    options: scheduler, or workers of this machine; retries. num_threads: of each slab.
    """
    with connected(options, 0.0) as client:
        require_workers(client)
        yield lambda job, slabs: run_slabs(client, job, slabs, options.retries, num_threads)


def run_slabs(
    client: "Client", job: SlabJob, slabs: list[int], retries: int = 2, num_threads: int = 1
) -> Iterator[int]:
    """Image slabs on workers, and yield the number of each finished one.

    Slabs with lost files or workers are repeated. Raises UserError for other failures, and before
    the work where no worker has enough memory.
    """
    hint = "lower --slab-gib, or take larger workers"
    require_memory(client, job.memory_bytes, where="a slab", hint=hint)
    tasks = (
        Task(name=f"slab-{n}", arguments=(job, n, num_threads), memory_bytes=job.memory_bytes)
        for n in slabs
    )

    def again(task: Task, answer: Answer) -> Task | None:
        is_lost = isinstance(answer, BaseException) and state_of(answer) in TRIED_AGAIN
        if is_lost and not is_killed(answer) and task.attempt <= retries:
            return replace(task, attempt=task.attempt + 1)
        return if_lost(task, answer)

    answers = drive(
        client,
        image_slab,
        tasks,
        again,
        declare_memory=worker_memory(client)[1],
        tend=lambda: tend(client),
    )
    for task, answer in answers:
        if isinstance(answer, UserError):
            raise answer
        if isinstance(answer, BaseException):
            reason = " ".join(str(answer).split()) or type(answer).__name__
            raise UserError(what=f"{task.name} could not be imaged: {reason}", where=job.scene)
        yield int(answer)
