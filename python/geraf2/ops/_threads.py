"""How many threads a kernel may use."""

import os
import sys
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

from geraf2 import _core  # noqa: TID251 - ops is the package that wraps the native module
from geraf2._bounds import MAX_THREADS, BoundsError

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")

# Whether a kernel may have started threads here; whether this process is a fork of such a one.
_started = False
_is_fork = False


def resolve_num_threads(num_threads: int | None) -> int:
    """Threads to use: the given number, else torch's when torch is loaded, else OpenMP's.

    One in a fork of a process whose kernels ran: OpenMP's threads stay behind, and waiting for
    them would not end. Start processes by "spawn" for more.
    """
    global _started  # noqa: PLW0603 - one pool of threads, one process
    wanted = _count_wanted(num_threads)
    if _is_fork:
        return 1
    _started = _started or wanted > 1
    return wanted


def _count_wanted(num_threads: int | None) -> int:
    if num_threads is None:
        torch = sys.modules.get("torch")
        n_found = _core.max_threads() if torch is None else int(torch.get_num_threads())
        if n_found > MAX_THREADS:
            raise BoundsError(
                what="OpenMP has too many threads",
                expected=f"at most {MAX_THREADS}",
                got=n_found,
                hint="is OMP_NUM_THREADS right?",
            )
        return n_found
    if isinstance(num_threads, bool) or not isinstance(num_threads, int):
        msg = f"num_threads must be an int or None, got {num_threads!r}"
        raise TypeError(msg)
    if not 1 <= num_threads <= MAX_THREADS:
        bound = "at least 1" if num_threads < 1 else f"at most {MAX_THREADS}"
        msg = f"num_threads must be {bound}, got {num_threads}"
        raise ValueError(msg)
    return num_threads


def _note_fork() -> None:
    global _is_fork  # noqa: PLW0603 - as above
    _is_fork = _started or "torch" in sys.modules  # whose operations share the threads


os.register_at_fork(after_in_child=_note_fork)


def limit_blas_threads(call: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Decorate a function whose many small matrix products and solves NumPy makes.

    Threads of OpenBLAS spin while they wait: a reconstruction took three times as long with them.
    Their number also changes the last bits of a product, on processors without AVX-512.
    """

    @wraps(call)
    def call_limited(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        with ThreadpoolController().select(internal_api="openblas").limit(limits=1):
            return call(*args, **kwargs)

    return call_limited
