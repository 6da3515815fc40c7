"""Workers of this machine or of a running scheduler."""

import asyncio
import logging
from collections.abc import Iterator
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
    from distributed import Client, LocalCluster

_CONNECT_S = 10.0
_WORKERS_S = 60.0
"""Time to wait for the first worker [s]: a queue may start them later."""
_REPAIR_S = 2.0
# Besides security, these reduce dask's own monitoring, up to a hundred calls a second: overhead
# falls from 5.3 % to 1.5 % of two cores.
_SETTINGS = {
    # One running task for each thread of a worker: its death blames no other task.
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.scheduler.work-stealing-interval": "1s",
    # Pages of dask have no password.
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.nanny.pre-spawn-environ": {
        "OMP_NUM_THREADS": 1,  # kernels are told their number
        "OPENBLAS_NUM_THREADS": 1,
        "OMP_WAIT_POLICY": "PASSIVE",  # as on the command line
        "PYTHONSAFEPATH": 1,  # modules of the working directory are not imported
    },
}


@contextmanager
def connect_workers(options: BatchOptions, memory_bytes: float = 0.0) -> Iterator["Client"]:
    """Yield a client of the given scheduler, or of processes of this machine.

    memory_bytes: of the largest job; limits the default number of processes.

    Raises UserError where no scheduler answers, or a worker has not the same geraf2.
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
            asyncio.run(asyncio.wait_for(_ask_identity(options.scheduler), _CONNECT_S))
            client = distributed.Client(options.scheduler, timeout=_CONNECT_S)
        except TimeoutError:
            what = f"no dask scheduler answers within {_CONNECT_S:g} s"
            raise UserError(what=what, where=options.scheduler) from None
        except Exception as error:  # of its protocol, TLS and others: any type
            raise UserError(
                what=f"no dask scheduler answers: {error}", where=options.scheduler
            ) from None
        with client:
            require_workers(client)
            yield client
        return
    free = available_memory_bytes() or float("inf")
    fitting = max(1, min(n_threads(), int(free // max(memory_bytes, 1.0))))
    n_workers = options.workers or fitting
    with (
        local_cluster(n_workers, free / n_workers, options.retries) as cluster,
        distributed.Client(cluster) as client,
    ):
        require_workers(client)
        yield client


async def _ask_identity(address: str) -> None:
    """Ask a scheduler for its identity; a client would wait for ever for one that is silent."""
    from distributed import Security, rpc  # noqa: PLC0415 - an extra

    arguments = Security().get_connection_args("client")
    async with rpc(address, timeout=_CONNECT_S, connection_args=arguments) as scheduler:
        await scheduler.identity()


@contextmanager
def local_cluster(
    n_workers: int, memory_bytes: float, retries: int = 2
) -> Iterator["LocalCluster"]:
    """Yield a cluster of single-threaded processes of this machine that declare memory.

    retries: of a task whose worker died.

    A scheduler executes what it is sent: certificates of this cluster keep other users of the
    machine out.
    """
    import dask  # noqa: PLC0415 - an extra
    from distributed import LocalCluster, Security  # noqa: PLC0415 - as above
    from tornado.ioloop import PeriodicCallback  # noqa: PLC0415 - of distributed

    failures = {"distributed.scheduler.allowed-failures": retries}
    with (
        # dask imports modules of its scratch folder, which by default all users share
        TemporaryDirectory(prefix="geraf2-", ignore_cleanup_errors=True) as scratch,
        dask.config.set(_SETTINGS | failures | {"temporary-directory": scratch}),
        LocalCluster(
            n_workers=n_workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            # None alone leaves a server on dask's default port, on all interfaces
            scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
            memory_limit=0,  # the machine's memory is shared by jobs of different sizes
            silence_logs=logging.CRITICAL,
            resources={MEMORY_RESOURCE: memory_bytes},
            security=Security.temporary(),
        ) as cluster,
    ):
        repairs = PeriodicCallback(lambda: _repair(cluster), 1e3 * _REPAIR_S)
        cluster.loop.add_callback(repairs.start)
        try:
            yield cluster
        finally:
            cluster.loop.add_callback(repairs.stop)


def _repair(cluster: "LocalCluster") -> None:
    """Start a process again that died during its start: its nanny has given up."""
    from distributed import Status  # noqa: PLC0415 - an extra

    gone = (Status.closed, Status.failed)
    for name in [n for n, worker in cluster.workers.items() if worker.status in gone]:
        del cluster.workers[name]
    cluster.scale(len(cluster.worker_spec))


def require_workers(client: "Client") -> None:
    """Wait for a worker; UserError for one of several threads, or without the same geraf2."""
    where = client.scheduler.address
    try:
        client.wait_for_workers(1, timeout=_WORKERS_S)
    except TimeoutError:
        hint = "start some with 'dask worker'"
        raise UserError(what="the dask scheduler has no workers", where=where, hint=hint) from None
    for worker, known in client.get_versions(packages=["geraf2"])["workers"].items():
        version = known["packages"].get("geraf2")
        if version != __version__:
            raise UserError(
                what="has no geraf2" if version is None else "has another geraf2",
                where=f"worker {worker}",
                expected=__version__,
                got=version or "none",
            )
    for worker, n in client.nthreads().items():
        if n > 1:
            hint = "start it with 'dask worker --nworkers N --nthreads 1'"
            what = f"does {n} jobs in one process, which may disturb each other"
            raise UserError(what=what, where=f"worker {worker}", hint=hint)
