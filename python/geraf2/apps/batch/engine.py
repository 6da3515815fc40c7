"""Execution of tasks on the workers of dask.distributed, a few for each worker at a time.

Results of tasks are small. Tasks are created when workers have room and released when done, so that
the memory of a client does not grow with their number.
"""

import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from geraf2.errors import UserError

if TYPE_CHECKING:
    from distributed import Client, Future

WINDOW = 4
"""Short tasks submitted for each thread of a worker, so that no thread waits."""
MEMORY_RESOURCE = "MEMORY"
"""Bytes that a worker may use, by `dask worker --resources MEMORY=...`."""
_CHECK_S = 2.0
"""Time between two checks of the workers [s]."""
_POLL_S = (0.001, 0.2)
"""Shortest and longest time between two polls for an answer [s]; doubled each time."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """One call of a function; its arguments are plain values, no arrays."""

    name: str
    arguments: tuple[Any, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    memory_bytes: float = 0.0
    attempt: int = 1
    losses: int = 0
    """Number of workers that died with the task."""
    rest_s: float = 0.0
    """Delay before a repeated task is submitted [s]."""


Answer = Any
"""Result of a task, or the exception raised by it or by the loss of its worker."""


def drive(
    client: "Client",
    function: Callable[..., Any],
    tasks: Iterable[Task],
    again: Callable[[Task, Answer], Task | None] = lambda task, answer: None,
    *,
    per_thread: int = WINDOW,
    declare_memory: bool = False,
    tend: Callable[[], None] = lambda: None,
) -> Iterator[tuple[Task, Answer]]:
    """Yield tasks and their answers as they end.

    again: a task to be submitted after this answer instead of yielding it; None to yield it.
    per_thread: tasks submitted for each thread of a worker. One where tasks take minutes: waiting
        tasks do not move to idle workers.
    declare_memory: limit tasks by the memory that workers declare.
    tend: called regularly, to maintain the workers.

    Raises UserError where the scheduler is lost.
    """
    from distributed.client import (  # noqa: PLC0415 - an extra
        FutureCancelledError,
        as_completed,
    )
    from distributed.comm import CommClosedError  # noqa: PLC0415 - as above

    waiting, resting, running = iter(tasks), deque[tuple[float, Task]](), dict["Future", Task]()
    done, room, checked_s, has_more = as_completed(), per_thread, -_CHECK_S, True
    poll_s = _POLL_S[0]

    try:
        while has_more or running or resting:
            if time.monotonic() - checked_s > _CHECK_S:
                tend()
                n_threads = max(1, sum(client.nthreads().values()))
                room, checked_s = per_thread * n_threads, time.monotonic()
            while len(running) < room:
                is_rested = resting and resting[0][0] <= time.monotonic()
                task = resting.popleft()[1] if is_rested else next(waiting, None)
                has_more = task is not None
                if task is None:
                    break
                future = _submit(client, function, task, declare_memory=declare_memory)
                running[future] = task
                done.add(future)
            if not done.has_ready():
                time.sleep(poll_s)
                poll_s = min(2.0 * poll_s, _POLL_S[1])
                continue
            poll_s = _POLL_S[0]
            future = next(done)
            task, answer = running.pop(future), _answer(future)
            repeated = again(task, answer)
            if repeated is None:
                yield task, answer
            else:
                resting.append((time.monotonic() + repeated.rest_s, repeated))
    except (CommClosedError, FutureCancelledError, TimeoutError):  # cancelled while it is read
        raise _lost() from None
    finally:
        if client.status == "running":
            client.cancel(list(running))


def _submit(
    client: "Client", function: Callable[..., Any], task: Task, *, declare_memory: bool
) -> "Future":
    return client.submit(
        function,
        *task.arguments,
        **task.options,
        key=f"{task.name}-{uuid.uuid4().hex}",
        pure=False,
        resources={MEMORY_RESOURCE: task.memory_bytes} if declare_memory else None,
    )


def _answer(future: "Future") -> Answer:
    if future.status == "cancelled":
        raise _lost()
    error = future.exception()
    return future.result() if error is None else error


def _lost() -> UserError:
    hint = "finished work is kept, the same command continues"
    return UserError(what="the scheduler was lost", hint=hint)
