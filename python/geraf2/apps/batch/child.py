"""Child process for successive calls, so that a worker survives their failures.

Python and torch start once. A call that takes too long, or whose process dies, fails alone, and the
next call gets a new process. The kernel ends a child with the thread that started it. Calls and
answers are lines of JSON.
"""

import importlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from threading import Lock
from typing import Any

from geraf2.io.text import parse_json
from geraf2.pipeline.processes import end_with

# With -P, modules of the working directory are not imported.
_COMMAND = "from geraf2.apps.batch.child import serve; serve()"
TIMEOUT_NAME = "timeout"
_TICK_S = 5.0
"""Time between two ticks during a call [s]."""
_N_TAIL = 20

# The kernel ends a child with the thread that started it, not with its process: this thread exists
# as long as the worker.
_STARTER = ThreadPoolExecutor(1, thread_name_prefix="geraf2-starter")
_IDLE: list["Child"] = []
_LOCK = Lock()


class ChildEndedError(Exception):
    """The process of a call has ended: name of the signal, or TIMEOUT_NAME."""


class Child:
    """One process, which executes one call at a time."""

    def __init__(self, num_threads: int) -> None:
        self.num_threads = num_threads
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115 - as long as the process
        self._process = _STARTER.submit(self._start).result()
        self._rest = b""

    def call(
        self,
        function: Callable[..., dict[str, Any]],
        *arguments: Any,
        timeout_s: float | None = None,
        tick: Callable[[], None] = lambda: None,
    ) -> dict[str, Any]:
        """Call a module's function with arguments of JSON types; ChildEndedError."""
        self._stderr.seek(0)
        self._stderr.truncate()
        end = None if timeout_s is None else time.monotonic() + timeout_s
        line = json.dumps([function.__module__, function.__qualname__, arguments])
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(line.encode() + b"\n")
            self._process.stdin.flush()
        except OSError:
            raise ChildEndedError(self._ended()) from None
        return dict(parse_json(self._answer(end, tick)))

    def _answer(self, end: float | None, tick: Callable[[], None]) -> bytes:
        assert self._process.stdout is not None
        pipe = self._process.stdout.fileno()
        while b"\n" not in self._rest:
            wait_s = _TICK_S if end is None else min(_TICK_S, end - time.monotonic())
            if wait_s <= 0:
                self.stop()
                raise ChildEndedError(TIMEOUT_NAME)
            if not select.select([pipe], [], [], wait_s)[0]:
                tick()
                continue
            part = os.read(pipe, 1 << 16)
            if not part:
                raise ChildEndedError(self._ended())
            self._rest += part
        answer, _, self._rest = self._rest.partition(b"\n")
        return answer

    def tail(self) -> list[str]:
        """Last lines of its standard error."""
        self._stderr.seek(0)
        return self._stderr.read().decode(errors="replace").splitlines()[-_N_TAIL:]

    def stop(self) -> None:
        """Kill the process."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            with suppress(OSError):  # unsent data have no reader
                pipe.close()

    def _start(self) -> "subprocess.Popen[bytes]":
        environment = {
            "OPENBLAS_NUM_THREADS": "1",
            "OMP_WAIT_POLICY": "PASSIVE",  # as on the command line
            **os.environ,
            "OMP_NUM_THREADS": str(self.num_threads),
            "PYTHONFAULTHANDLER": "1",  # crashes print a traceback
        }
        # dask makes its workers return memory at once: 0.86 instead of 0.65 s of processor time for
        # a small scene.
        environment.pop("MALLOC_TRIM_THRESHOLD_", None)
        pipe = subprocess.PIPE
        command = [sys.executable, "-P", "-c", _COMMAND, str(os.getpid())]
        return subprocess.Popen(
            command, stdin=pipe, stdout=pipe, stderr=self._stderr, env=environment
        )

    def _ended(self) -> str:
        self.stop()
        code = self._process.returncode
        return signal.Signals(-code).name if code < 0 else f"exit code {code}"


@contextmanager
def child(num_threads: int) -> Iterator[Child]:
    """Yield an idle process, or a new one; it is killed where the body raises."""
    with _LOCK:
        found = next((one for one in _IDLE if one.num_threads == num_threads), None)
        if found is not None:
            _IDLE.remove(found)
    process = found or Child(num_threads)
    try:
        yield process
    except BaseException:
        process.stop()
        raise
    with _LOCK:
        _IDLE.append(process)


def serve() -> None:
    """Execute calls from stdin, until it ends or the parent process ends."""
    end_with(int(sys.argv[1]))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the client
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # output of libraries is no answer
    for line in sys.stdin:
        module, name, arguments = parse_json(line)
        answer = getattr(importlib.import_module(module), name)(*arguments)
        answers.write(json.dumps(answer) + "\n")
        answers.flush()
