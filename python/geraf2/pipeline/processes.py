"""Calls in separate processes, so that their memory and crashes do not affect the caller."""

import ctypes
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, ParamSpec, TypeVar

from geraf2.errors import UserError, speaking_of_flags

_P = ParamSpec("_P")
_T = TypeVar("_T")

# With -P, modules of the working directory are not imported.
_COMMAND = (sys.executable, "-P", "-c", "from geraf2.pipeline.processes import serve; serve()")
_PR_SET_PDEATHSIG = 1
_PATIENCE_S = 5.0
"""Time that a process gets to clean up before it is killed [s]."""


class Processes:
    """Calls functions, each in a new process; `stop` ends the processes."""

    def __init__(self) -> None:
        self._running: set[subprocess.Popen[bytes]] = set()
        self._stopped = False
        self._lock = threading.Lock()

    def call(
        self, function: Callable[_P, _T], *args: _P.args, **kwargs: _P.kwargs
    ) -> tuple[_T, float]:
        """Call a function of a module -> its result, CPU time of its process [s].

        Raises UserError with one line if it raises or its process dies, and KeyboardInterrupt if
        that was interrupted. Several threads may call.
        """
        with self._lock:
            if self._stopped:
                raise KeyboardInterrupt
            pipe = subprocess.PIPE
            command = (*_COMMAND, str(os.getpid()))
            process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe)
            self._running.add(process)
        try:
            answer, errors = process.communicate(pickle.dumps((function, args, kwargs)))
        finally:
            process.kill()
            self._running.discard(process)
        code = process.returncode
        if code == -signal.SIGINT:
            raise KeyboardInterrupt
        if code < 0:
            raise UserError(what=f"its process was ended by {signal.Signals(-code).name}")
        if code > 0:
            lines = errors.decode(errors="replace").split("\n")
            raise UserError(what=[f"exit code {code}", *filter(str.strip, lines)][-1])
        value, seconds = pickle.loads(answer)
        return value, seconds

    def stop(self) -> None:
        """End all running processes, and start no further ones."""
        with self._lock:
            self._stopped = True
            running = list(self._running)
        for process in running:
            process.terminate()
        for process in running:
            with suppress(subprocess.TimeoutExpired):
                process.wait(_PATIENCE_S)
            process.kill()


def end_with(parent: int) -> None:
    """Make the kernel kill this process when the thread that started it ends.

    parent: process id of that thread; exits at once if it has already ended.
    """
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:
        sys.exit(1)


def serve() -> None:
    """Execute one call from stdin; the result goes to stdout, an error to stderr."""
    end_with(int(sys.argv[1]))
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # clean up as after Ctrl-C
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # keep the output of libraries out of the result
    function, args, kwargs = pickle.load(sys.stdin.buffer)
    try:
        with speaking_of_flags():
            value: Any = function(*args, **kwargs)
    except UserError as error:
        with speaking_of_flags():
            sys.exit(str(error))
    pickle.dump((value, time.process_time()), answer)
    answer.close()
