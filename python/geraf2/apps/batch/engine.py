"""Tasks on the workers of dask.distributed, a few for each worker at a time.

What a task gives is small: state and a line. Tasks are made when there is room for them, and
forgotten when they are done, so that a client holds as much for ten thousand as for ten.
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
"""Tasks of seconds for each thread of a worker: one that runs, and some so that none waits."""
MEMORY_RESOURCE = "MEMORY"
"""Bytes that a worker may use, by `dask worker --resources MEMORY=...`."""
_LOOK_S = 2.0
_POLL_S = (0.001, 0.2)
"""Shortest and longest rest between two looks for an answer; twice as long each time."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """One call of a function: its arguments are plain values, no arrays."""

    name: str
    arguments: tuple[Any, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    memory_bytes: float = 0.0
    attempt: int = 1
    losses: int = 0
    """How often the worker that had it died."""
    rest_s: float = 0.0
    """How long it waits before it is submitted, where it comes again [s]."""


Answer = Any
"""What a task gave, or the exception that it, or the loss of its worker, raised."""


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
    per_thread: tasks submitted for each thread of a worker. One where tasks take minutes: what
        waits at a busy worker is not moved to an idle one.
    declare_memory: hold tasks to the memory that workers declare.
    tend: is called now and then, to look after the workers.

    Raises UserError where the scheduler is lost.
    """
    from distributed import as_completed  # noqa: PLC0415 - an extra
    from distributed.comm import CommClosedError  # noqa: PLC0415 - as above

    waiting, resting, running = iter(tasks), deque[tuple[float, Task]](), dict["Future", Task]()
    done, room, looked, left = as_completed(), per_thread, -_LOOK_S, True
    rest_s = _POLL_S[0]

    def next_task() -> Task | None:
        if resting and resting[0][0] <= time.monotonic():
            return resting.popleft()[1]
        return next(waiting, None)

    try:
        while left or running or resting:
            if time.monotonic() - looked > _LOOK_S:
                tend()
                n_threads = max(1, sum(client.nthreads().values()))
                room, looked = per_thread * n_threads, time.monotonic()
            while len(running) < room:
                task = next_task()
                left = task is not None
                if task is None:
                    break
                future = _submit(client, function, task, declare_memory=declare_memory)
                running[future] = task
                done.add(future)
            if not done.has_ready():
                time.sleep(rest_s)
                rest_s = min(2.0 * rest_s, _POLL_S[1])
                continue
            rest_s = _POLL_S[0]
            future = next(done)
            task, answer = running.pop(future), _answer(future)
            once_more = again(task, answer)
            if once_more is None:
                yield task, answer
            else:
                resting.append((time.monotonic() + once_more.rest_s, once_more))
    except (CommClosedError, TimeoutError):
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
    hint = "what is finished is kept, the same command continues"
    return UserError(what="the scheduler was lost", hint=hint)
