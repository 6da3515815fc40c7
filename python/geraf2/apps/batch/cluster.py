"""Workers: of this machine, or of a running scheduler; what they have is asked first."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from geraf2 import __version__
from geraf2.apps.batch.engine import MEMORY_RESOURCE
from geraf2.apps.batch.options import BatchOptions
from geraf2.errors import UserError
from geraf2.pipeline.estimates import available_memory_bytes, n_threads

if TYPE_CHECKING:
    from distributed import Client

_CONNECT_S = 10.0
_WORKERS_S = 60.0
"""How long a scheduler may be without any worker: a queue starts them later."""


@contextmanager
def connected(options: BatchOptions, memory_bytes: float) -> Iterator["Client"]:
    """Lend a client of the scheduler that is asked for, or of processes of this machine.

    memory_bytes: of the largest job; as many processes as hold it where no number is asked for.
    """
    try:
        import distributed  # noqa: PLC0415 - an extra
    except ImportError:
        raise UserError(
            what="several processes need dask.distributed", hint="pip install 'geraf2[cluster]'"
        ) from None
    if options.scheduler is not None:
        try:
            client = distributed.Client(options.scheduler, timeout=_CONNECT_S)
        except (OSError, ValueError) as error:
            raise UserError(
                what=f"no dask scheduler answers: {error}", where=options.scheduler
            ) from None
        with client:
            yield client
        return
    free = available_memory_bytes() or float("inf")
    fitting = max(1, min(n_threads(), int(free // max(memory_bytes, 1.0))))
    n_workers = options.workers or fitting
    with (
        local_cluster(n_workers, free / n_workers) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


@contextmanager
def local_cluster(n_workers: int, memory_bytes: float) -> Iterator[object]:
    """Lend processes of this machine, of one thread each, that declare memory."""
    import dask  # noqa: PLC0415 - an extra
    from distributed import LocalCluster  # noqa: PLC0415 - as above

    # A task is told at once that its worker died: whether it is to blame, the batch knows better,
    # as a scheduler blames all that waited on that worker, too. The rest are dask's looks at
    # itself, up to a hundred a second, which nobody reads here. Made rare, they and the client's
    # rests leave client, scheduler and workers 1.5 % of two cores in place of 5.3 %.
    settings = {
        "distributed.scheduler.allowed-failures": 0,
        "distributed.worker.profile.enabled": False,
        "distributed.admin.tick.interval": "1s",
        "distributed.admin.system-monitor.interval": "10s",
        "distributed.scheduler.work-stealing-interval": "1s",
    }
    with (
        dask.config.set(settings),
        LocalCluster(
            n_workers=n_workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            # None alone leaves a server on dask's usual port, of all interfaces
            scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
            memory_limit=0,  # counts the worker, not the processes of its jobs
            silence_logs=logging.CRITICAL,
            resources={MEMORY_RESOURCE: memory_bytes},
        ) as cluster,
    ):
        yield cluster


def require_workers(client: "Client") -> None:
    """Wait for a worker; UserError for one without this very geraf2."""
    try:
        client.wait_for_workers(1, timeout=_WORKERS_S)
    except TimeoutError:
        raise UserError(
            what="the dask scheduler has no workers",
            where=client.scheduler.address,
            hint="start some with 'dask worker'",
        ) from None
    for worker, version in client.run(_version_teller()).items():
        if version != __version__:
            raise UserError(
                what="has no geraf2" if version is None else "has another geraf2",
                where=f"worker {worker}",
                expected=__version__,
                got=version or "none",
            )


def _version_teller() -> Callable[[], str | None]:
    # A function within a function is sent by value: a worker without geraf2 answers, too.
    def version() -> str | None:
        try:
            import geraf2  # noqa: PLC0415
        except ImportError:
            return None
        return geraf2.__version__

    return version


def tend(client: "Client") -> None:
    """Start processes of this machine again that are gone for good.

    One that dies is started again by its nanny, but not if it dies before it has begun.
    """
    from distributed import LocalCluster, Status  # noqa: PLC0415 - an extra

    cluster = client.cluster
    if isinstance(cluster, LocalCluster):
        gone = (Status.closed, Status.failed)
        for name in [n for n, worker in cluster.workers.items() if worker.status in gone]:
            del cluster.workers[name]
        cluster.scale(len(cluster.worker_spec))


def worker_memory(client: "Client") -> tuple[float | None, bool]:
    """Most memory of a worker [bytes], None where none says; whether as a resource of dask."""
    # client.scheduler_info() holds no workers while the client's own clock renews it without them.
    workers = client.sync(client.scheduler.identity, n_workers=-1)["workers"].values()
    declared = [float(w.get("resources", {}).get(MEMORY_RESOURCE, 0.0)) for w in workers]
    limits = [float(w.get("memory_limit") or 0.0) for w in workers]
    most = max(declared, default=0.0) or max(limits, default=0.0)
    return most or None, any(declared)
