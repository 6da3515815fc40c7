"""Imaging of the slabs of one image on workers (`geraf2.pipeline.commands.image_tiles`)."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from geraf2.apps.batch.cluster import connect_workers
from geraf2.apps.batch.engine import Failure, Task, drive
from geraf2.apps.batch.options import BatchOptions
from geraf2.errors import UserError
from geraf2.pipeline.commands.image_tiles import RunSlabs, SlabJob, image_slab

if TYPE_CHECKING:
    from distributed import Client


@contextmanager
def slab_workers(options: BatchOptions) -> Iterator[RunSlabs]:
    """Yield a function that images slabs on workers; UserError where no scheduler answers."""
    with connect_workers(options) as client:
        yield lambda job, slabs: run_slabs(client, job, slabs, options)


def run_slabs(
    client: "Client", job: SlabJob, slabs: list[int], options: BatchOptions
) -> Iterator[int]:
    """Image slabs on workers, and yield the number of each finished one; UserError for a failure.

    options: retries, and threads of each slab.
    """
    tasks = (
        Task(
            name=f"slab-{n}",
            arguments=(job, n, options.threads or 1),
            memory_bytes=job.memory_bytes,
        )
        for n in slabs
    )
    for name, answer in drive(client, image_slab, tasks, retries=options.retries):
        if isinstance(answer, Failure):
            raise UserError(what=f"{name} could not be imaged: {answer.error}", where=job.scene)
        yield int(answer)
