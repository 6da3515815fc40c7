"""Tasks on the workers of dask.distributed.

A worker does one task at a time and reports errors by their kind. dask repeats a task whose files
or memory were not available, and one whose worker died; other errors would come again.
"""

import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from geraf2 import __version__
from geraf2.errors import UserError

if TYPE_CHECKING:
    from distributed import Client, Future

MEMORY_RESOURCE = "MEMORY"
"""Bytes that a worker may use, as in `dask worker --resources MEMORY=...`."""
BAD_INPUT, FAILED, KILLED, LOST, MEMORY = (
    *("bad input", "failed", "killed"),
    *("lost files", "out of memory"),
)
_CHECK_S = 2.0
"""Time between two looks for new workers [s]."""
_N_TAIL = 20


@dataclass(frozen=True, kw_only=True)
class Task:
    """One call of a function; its arguments are small."""

    name: str
    arguments: tuple[Any, ...] = ()
    memory_bytes: float = 0.0


_END = Task(name="")


@dataclass(frozen=True, kw_only=True)
class Failure:
    """Why a task has no result."""

    state: str
    """bad input, failed, killed, lost files, or out of memory."""
    error: str
    """One line."""
    log_tail: tuple[str, ...] = ()
    """End of the traceback of a defect."""


class RepeatError(Exception):
    """Tells dask to repeat a task; its argument is the Failure."""


def drive(
    client: "Client",
    function: Callable[..., Any],
    tasks: Iterable[Task | None],
    *,
    retries: int = 0,
) -> Iterator[tuple[str, Any]]:
    """Yield the name of each task, and its result or Failure, as they end.

    tasks: may yield None where there is none at present.
    retries: of a task after lost files or lack of memory.

    Each thread of a worker has one task, so that dask blames no other task for the death of a
    worker, and the client's memory does not grow with their number. Raises UserError where the
    scheduler is lost.
    """
    from distributed import wait  # noqa: PLC0415 - an extra
    from distributed.client import FutureCancelledError  # noqa: PLC0415 - as above
    from distributed.comm import CommClosedError  # noqa: PLC0415 - as above

    waiting, running, has_more = iter(tasks), dict["Future", str](), True
    declared = declared_bytes(client)
    try:
        while has_more or running:
            room = max(1, sum(client.nthreads().values()))
            while has_more and len(running) < room:
                task = next(waiting, _END)
                has_more = task is not _END
                if task is None or task is _END:
                    break
                if declared and task.memory_bytes > declared:
                    yield task.name, _too_large(task.memory_bytes, declared)
                    continue
                running[_submit(client, function, task, retries, declared)] = task.name
            if not running:
                continue
            with suppress(TimeoutError):
                wait(list(running), timeout=_CHECK_S, return_when="FIRST_COMPLETED")
            for future in [future for future in running if future.done()]:
                yield running.pop(future), _answer(future)
    except (CommClosedError, FutureCancelledError):
        hint = "finished work is kept, the same command continues"
        raise UserError(what="the scheduler was lost", hint=hint) from None
    finally:
        if client.status == "running":
            client.cancel(list(running))


def declared_bytes(client: "Client") -> float:
    """Memory that the largest worker declares as a resource; 0 where none does [bytes]."""
    # client.scheduler_info() may hold no workers: the client updates it without them.
    workers = client.sync(client.scheduler.identity, n_workers=-1)["workers"].values()
    found = [float(w.get("resources", {}).get(MEMORY_RESOURCE, 0.0)) for w in workers]
    return max(found, default=0.0)


def _too_large(n_bytes: float, declared: float) -> Failure:
    error = UserError(
        what="no worker has enough memory",
        expected=f"about {n_bytes / 2**30:.1f} GiB",
        got=f"{declared / 2**30:.1f} GiB on the largest worker",
        hint="take fewer --workers, or larger ones",
    )
    return Failure(state=MEMORY, error=str(error))


def _submit(
    client: "Client", function: Callable[..., Any], task: Task, retries: int, declared: float
) -> "Future":
    return client.submit(
        attempt,
        function,
        __version__,
        *task.arguments,
        pure=False,
        retries=retries,
        resources={MEMORY_RESOURCE: task.memory_bytes} if declared else None,
    )


def attempt(function: Callable[..., Any], version: str, *arguments: Any) -> Any:
    """Call a function on a worker; its result, a Failure, or RepeatError.

    version: of the client's geraf2; workers that came later may have another one.
    """
    if version != __version__:
        error = f"the worker has geraf2 {__version__}, the client {version}"
        return Failure(state=FAILED, error=error)
    try:
        return function(*arguments)
    except Exception as error:
        failure = _make_failure(error)
        if failure.state in (LOST, MEMORY):
            raise RepeatError(failure) from None
        return failure


def _answer(future: "Future") -> Any:
    from distributed import KilledWorker  # noqa: PLC0415 - an extra

    error = future.exception()
    if error is None:
        return future.result()
    if isinstance(error, RepeatError):
        return error.args[0]
    if isinstance(error, KilledWorker):
        n_died = error.allowed_failures + 1
        return Failure(state=KILLED, error=f"its worker died {n_died} times while it ran")
    return _make_failure(error)


def _make_failure(error: BaseException) -> Failure:
    state, line = error_state(error), " ".join(str(error).split())
    if state != FAILED:
        return Failure(state=state, error=line or type(error).__name__)
    tail = "".join(traceback.format_exception(error)).splitlines()[-_N_TAIL:]
    line = f"internal error: {type(error).__name__}: {line}"
    return Failure(state=FAILED, error=line, log_tail=tuple(tail))


def error_state(error: BaseException) -> str:
    """State of a task that raised an exception."""
    causes = list(_causes(error))
    if any(isinstance(e, MemoryError) or "can't allocate memory" in str(e) for e in causes):
        return MEMORY
    # Parsers may raise OSError, too; system errors have a number.
    if any(isinstance(e, OSError) and e.errno is not None for e in causes):
        return LOST
    if any(type(e).__module__.startswith("obstore") for e in causes):  # read by zarr itself
        return LOST
    return BAD_INPUT if isinstance(error, UserError) else FAILED


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
