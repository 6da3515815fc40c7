"""How many threads a kernel may use."""

import sys

from geraf2 import _core  # noqa: TID251 - ops is the package that wraps the native module


def resolve_num_threads(num_threads: int | None) -> int:
    """Threads to use: the given number, else torch's when torch is loaded, else OpenMP's."""
    if num_threads is None:
        torch = sys.modules.get("torch")
        return _core.max_threads() if torch is None else int(torch.get_num_threads())
    if isinstance(num_threads, bool) or not isinstance(num_threads, int):
        msg = f"num_threads must be an int or None, got {num_threads!r}"
        raise TypeError(msg)
    if num_threads < 1:
        msg = f"num_threads must be at least 1, got {num_threads}"
        raise ValueError(msg)
    return num_threads
