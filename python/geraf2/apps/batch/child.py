"""A process that does one call after another, so that a worker outlives what it is given.

Python and torch start once. A call that takes too long, or whose process dies, ends alone, and the
next one gets a new process. None outlives its worker: the kernel ends it with the thread that
started it. Calls and answers are lines of JSON.
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

from geraf2.pipeline.processes import end_with

_COMMAND = "from geraf2.apps.batch.child import serve; serve()"
TIMEOUT_NAME = "timeout"
_TICK_S = 5.0
"""How often a caller hears that its call goes on [s]."""
_N_TAIL = 20

# The kernel's signal comes when the thread that started a process ends, not its process: this one
# lives as long as the worker.
_STARTER = ThreadPoolExecutor(1, thread_name_prefix="geraf2-starter")
_IDLE: list["Child"] = []
_LOCK = Lock()


class ChildEndedError(Exception):
    """The process of a call is gone: the signal's name, or TIMEOUT_NAME."""


class Child:
    """One process; calls are done one at a time."""

    def __init__(self, num_threads: int) -> None:
        self.num_threads = num_threads
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - as long as the process
        self._process = _STARTER.submit(self._start).result()
        self._rest = b""

    def call(
        self,
        function: Callable[..., dict[str, Any]],
        *arguments: Any,
        timeout_s: float | None = None,
        tick: Callable[[], None] = lambda: None,
    ) -> dict[str, Any]:
        """Answer of a function of a module to arguments that JSON has; ChildEndedError."""
        self._said.seek(0)
        self._said.truncate()
        end = None if timeout_s is None else time.monotonic() + timeout_s
        line = json.dumps([function.__module__, function.__qualname__, arguments])
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(line.encode() + b"\n")
            self._process.stdin.flush()
        except OSError:
            raise ChildEndedError(self._ended()) from None
        return dict(json.loads(self._answer(end, tick)))

    def _answer(self, end: float | None, tick: Callable[[], None]) -> bytes:
        assert self._process.stdout is not None
        pipe = self._process.stdout.fileno()
        while b"\n" not in self._rest:
            left = _TICK_S if end is None else min(_TICK_S, end - time.monotonic())
            if left <= 0:
                self.stop()
                raise ChildEndedError(TIMEOUT_NAME)
            if not select.select([pipe], [], [], left)[0]:
                tick()
                continue
            part = os.read(pipe, 1 << 16)
            if not part:
                raise ChildEndedError(self._ended())
            self._rest += part
        answer, _, self._rest = self._rest.partition(b"\n")
        return answer

    def tail(self) -> list[str]:
        """Last lines that it wrote to its standard error."""
        self._said.seek(0)
        return self._said.read().decode(errors="replace").splitlines()[-_N_TAIL:]

    def stop(self) -> None:
        """End it now."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            with suppress(OSError):  # what was still to be sent has no reader
                pipe.close()

    def _start(self) -> "subprocess.Popen[bytes]":
        environment = {
            "OPENBLAS_NUM_THREADS": "1",
            "OMP_WAIT_POLICY": "PASSIVE",  # as the command line has it
            **os.environ,
            "OMP_NUM_THREADS": str(self.num_threads),
            "PYTHONFAULTHANDLER": "1",  # a crash says where
        }
        # dask has its workers give memory back at once, which costs a reconstruction of a small
        # scene 0.86 instead of 0.65 s of processor time.
        environment.pop("MALLOC_TRIM_THRESHOLD_", None)
        pipe = subprocess.PIPE
        command = [sys.executable, "-c", _COMMAND, str(os.getpid())]
        return subprocess.Popen(
            command, stdin=pipe, stdout=pipe, stderr=self._said, env=environment
        )

    def _ended(self) -> str:
        self.stop()
        code = self._process.returncode
        return signal.Signals(-code).name if code < 0 else f"exit code {code}"


@contextmanager
def child(num_threads: int) -> Iterator[Child]:
    """Lend a process: one that waits, or a new one; it is ended where the body raises."""
    with _LOCK:
        found = next((one for one in _IDLE if one.num_threads == num_threads), None)
        if found is not None:
            _IDLE.remove(found)
    lent = found or Child(num_threads)
    try:
        yield lent
    except BaseException:
        lent.stop()
        raise
    with _LOCK:
        _IDLE.append(lent)


def serve() -> None:
    """Do the calls that come on stdin, until it ends or the process that asked is gone."""
    end_with(int(sys.argv[1]))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the client; this ends with it
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print is no answer
    for line in sys.stdin:
        module, name, arguments = json.loads(line)
        answer = getattr(importlib.import_module(module), name)(*arguments)
        answers.write(json.dumps(answer) + "\n")
        answers.flush()
