"""Workers of this machine or of a running scheduler, and checks of their version and memory."""

import asyncio
import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from geraf2 import __version__
from geraf2._memory import available_memory_bytes
from geraf2.apps.batch.engine import MEMORY_RESOURCE
from geraf2.apps.batch.options import BatchOptions
from geraf2.errors import UserError
from geraf2.pipeline.estimates import n_threads

if TYPE_CHECKING:
    from distributed import Client

_CONNECT_S = 10.0
_WORKERS_S = 60.0
"""Time to wait for the first worker [s]: a queue may start them later."""


@contextmanager
def connected(options: BatchOptions, memory_bytes: float) -> Iterator["Client"]:
    """Yield a client of the given scheduler, or of processes of this machine.

    memory_bytes: of the largest job; limits the default number of processes.
    """
    try:
        import cryptography  # noqa: F401, PLC0415 - an extra, for the certificates
        import distributed  # noqa: PLC0415 - as above
    except ImportError:
        raise UserError(
            what="several processes need dask.distributed", hint="pip install 'geraf2[cluster]'"
        ) from None
    if options.scheduler is not None:
        try:
            asyncio.run(asyncio.wait_for(_answer_of(options.scheduler), _CONNECT_S))
            client = distributed.Client(options.scheduler, timeout=_CONNECT_S)
        except TimeoutError:
            what = f"no dask scheduler answers within {_CONNECT_S:g} s"
            raise UserError(what=what, where=options.scheduler) from None
        except Exception as error:  # of its protocol, TLS and others: any type
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


async def _answer_of(address: str) -> None:
    """Ask a scheduler for its identity; a client would wait for ever for one that is silent."""
    from distributed import Security, rpc  # noqa: PLC0415 - an extra

    arguments = Security().get_connection_args("client")
    async with rpc(address, timeout=_CONNECT_S, connection_args=arguments) as scheduler:
        await scheduler.identity()


@contextmanager
def local_cluster(n_workers: int, memory_bytes: float) -> Iterator[object]:
    """Yield a cluster of single-threaded processes of this machine that declare memory.

    A scheduler executes what it is sent: certificates of this cluster keep other users of the
    machine out.
    """
    import dask  # noqa: PLC0415 - an extra
    from distributed import LocalCluster, Security  # noqa: PLC0415 - as above

    # A lost worker fails its tasks at once: the batch decides which of them caused it, since a
    # scheduler blames all tasks of that worker. The other settings reduce dask's own monitoring, up
    # to a hundred calls a second: overhead falls from 5.3 % to 1.5 % of two cores.
    settings = {
        "distributed.scheduler.allowed-failures": 0,
        "distributed.worker.profile.enabled": False,
        "distributed.admin.tick.interval": "1s",
        "distributed.admin.system-monitor.interval": "10s",
        "distributed.scheduler.work-stealing-interval": "1s",
        # Pages of dask have no password.
        "distributed.scheduler.http.routes": [],
        "distributed.worker.http.routes": [],
    }
    os.environ["PYTHONSAFEPATH"] = "1"  # modules of the working directory are not imported
    with (
        # dask imports modules of its scratch folder, which by default all users share
        TemporaryDirectory(prefix="geraf2-", ignore_cleanup_errors=True) as scratch,
        dask.config.set(settings | {"temporary-directory": scratch}),
        LocalCluster(
            n_workers=n_workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            # None alone leaves a server on dask's default port, on all interfaces
            scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
            memory_limit=0,  # dask measures the worker, not the processes of its jobs
            silence_logs=logging.CRITICAL,
            resources={MEMORY_RESOURCE: memory_bytes},
            security=Security.temporary(),
        ) as cluster,
    ):
        yield cluster


def require_workers(client: "Client") -> None:
    """Wait for a worker; UserError for one without the same version of geraf2."""
    try:
        client.wait_for_workers(1, timeout=_WORKERS_S)
    except TimeoutError:
        raise UserError(
            what="the dask scheduler has no workers",
            where=client.scheduler.address,
            hint="start some with 'dask worker'",
        ) from None
    for worker, version in client.run(_version_function()).items():
        if version != __version__:
            raise UserError(
                what="has no geraf2" if version is None else "has another geraf2",
                where=f"worker {worker}",
                expected=__version__,
                got=version or "none",
            )


def _version_function() -> Callable[[], str | None]:
    # A nested function is sent by value, so that workers without geraf2 can run it.
    def version() -> str | None:
        try:
            import geraf2  # noqa: PLC0415
        except ImportError:
            return None
        return geraf2.__version__

    return version


def tend(client: "Client") -> None:
    """Replace failed processes of this machine.

    A nanny restarts a process that dies, but not one that dies during its start.
    """
    from distributed import LocalCluster, Status  # noqa: PLC0415 - an extra

    cluster = client.cluster
    if isinstance(cluster, LocalCluster):
        gone = (Status.closed, Status.failed)
        for name in [n for n, worker in cluster.workers.items() if worker.status in gone]:
            del cluster.workers[name]
        cluster.scale(len(cluster.worker_spec))


def require_memory(client: "Client", n_bytes: float, *, where: object, hint: str) -> None:
    """Raise UserError for a task that exceeds the memory of every worker."""
    most, _ = worker_memory(client)
    if most is not None and n_bytes > most:
        raise UserError(
            what="no worker has enough memory",
            where=where,
            expected=f"about {n_bytes / 2**30:.1f} GiB",
            got=f"{most / 2**30:.1f} GiB on the largest worker",
            hint=hint,
        )


def worker_memory(client: "Client") -> tuple[float | None, bool]:
    """Memory of the largest worker [bytes] or None, and whether it is declared as a resource."""
    # client.scheduler_info() may hold no workers: the client updates it without them.
    workers = client.sync(client.scheduler.identity, n_workers=-1)["workers"].values()
    declared = [float(w.get("resources", {}).get(MEMORY_RESOURCE, 0.0)) for w in workers]
    limits = [float(w.get("memory_limit") or 0.0) for w in workers]
    most = max(declared, default=0.0) or max(limits, default=0.0)
    return most or None, any(declared)
