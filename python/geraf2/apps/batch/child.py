"""Child process for calls, so that the caller survives their failures.

Python and torch start once. A call that takes too long, or whose process dies, fails alone, and the
next call gets a new process. The kernel ends a child with the thread that started it.
"""

import ctypes
import os
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from threading import Lock
from typing import Any, TypeVar

from geraf2.errors import UserError

_T = TypeVar("_T")

# With -P, modules of the working directory are not imported.
_COMMAND = (sys.executable, "-P", "-c", "from geraf2.apps.batch.child import serve; serve()")
_PR_SET_PDEATHSIG = 1
TIMEOUT_NAME = "timeout"
_TICK_S = 5.0
"""Time between two ticks during a call [s]."""
_PATIENCE_S = 5.0
"""Time that a process gets to clean up before it is killed [s]."""
_N_TAIL = 20

# The kernel ends a child with the thread that started it, not with its process: this thread exists
# as long as the worker.
_STARTER = ThreadPoolExecutor(1, thread_name_prefix="geraf2-starter")
_IDLE: list["Child"] = []
_LOCK = Lock()


class ChildEndedError(Exception):
    """The process of a call has ended: name of the signal, exit code, or TIMEOUT_NAME."""


class Child:
    """One process, which executes one call at a time.

    num_threads: threads of its kernels; all when None.
    """

    def __init__(self, num_threads: int | None) -> None:
        self.num_threads = num_threads
        self.cpu_seconds = 0.0
        """Processor time of the process until its last answer [s]."""
        self._printed = tempfile.TemporaryFile()  # noqa: SIM115 - as long as the process
        self._connection, theirs = Pipe()
        with theirs:
            self._process = _STARTER.submit(self._start, theirs.fileno()).result()

    def call(
        self,
        function: Callable[..., _T],
        *arguments: Any,
        timeout_s: float | None = None,
        tick: Callable[[], None] = lambda: None,
    ) -> _T:
        """Call a function of a module.

        Raises UserError with one line where it raises, and ChildEndedError.
        """
        self._printed.seek(0)
        self._printed.truncate()
        end = None if timeout_s is None else time.monotonic() + timeout_s
        try:
            self._connection.send((function, arguments))
            wait_s = 0.0
            while not self._connection.poll(wait_s):
                wait_s = _TICK_S if end is None else min(_TICK_S, end - time.monotonic())
                if wait_s <= 0:
                    self._end()
                    raise ChildEndedError(TIMEOUT_NAME)
                tick()
            value: _T
            value, error, self.cpu_seconds = self._connection.recv()
        except (EOFError, OSError):
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_PATIENCE_S)
            self._end()
            code = self._process.returncode
            name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
            raise ChildEndedError(name) from None
        if error is not None:
            raise UserError(what=error)
        return value

    def tail(self) -> list[str]:
        """Last lines that it printed."""
        self._printed.seek(0)
        return self._printed.read().decode(errors="replace").splitlines()[-_N_TAIL:]

    def close(self) -> None:
        """End the process, which cleans up as after Ctrl-C, and forget what it printed."""
        self._end()
        self._printed.close()

    def _end(self) -> None:
        self._process.terminate()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_PATIENCE_S)
        self._process.kill()
        self._process.wait()
        self._connection.close()

    def _start(self, descriptor: int) -> "subprocess.Popen[bytes]":
        environment = {
            "OPENBLAS_NUM_THREADS": "1",
            "OMP_WAIT_POLICY": "PASSIVE",  # as on the command line
            **os.environ,
            "PYTHONFAULTHANDLER": "1",  # crashes print a traceback
        }
        if self.num_threads is not None:
            environment["OMP_NUM_THREADS"] = str(self.num_threads)
        # dask makes its workers return memory at once: 0.86 instead of 0.65 s of processor time for
        # a small scene.
        environment.pop("MALLOC_TRIM_THRESHOLD_", None)
        return subprocess.Popen(
            [*_COMMAND, str(os.getpid()), str(descriptor)],
            pass_fds=[descriptor],
            stdin=subprocess.DEVNULL,
            stdout=self._printed,
            stderr=self._printed,
            env=environment,
        )


@contextmanager
def child(num_threads: int) -> Iterator[Child]:
    """Yield an idle process, or a new one; it is ended where the body raises."""
    with _LOCK:
        found = next((one for one in _IDLE if one.num_threads == num_threads), None)
        if found is not None:
            _IDLE.remove(found)
    process = found or Child(num_threads)
    try:
        yield process
    except BaseException:
        process.close()
        raise
    with _LOCK:
        _IDLE.append(process)


def serve() -> None:
    """Execute calls until the parent process, or its end of the connection, ends."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != int(sys.argv[1]):
        sys.exit(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the client
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    connection: Connection[Any, Any] = Connection(int(sys.argv[2]))
    while True:
        try:
            function, arguments = connection.recv()
        except EOFError:
            return
        value, line = None, None
        try:
            value = function(*arguments)
        except UserError as error:
            line = error.args[0]
        except Exception as error:
            traceback.print_exc()
            line = f"{type(error).__name__}: {error}"
        connection.send((value, line, time.process_time()))
