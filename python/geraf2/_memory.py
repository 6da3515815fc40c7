"""Memory: what is free, what a user allows, and whether work fits in before it begins."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from geraf2.errors import UserError

_LIMIT_BYTES: ContextVar[float] = ContextVar("memory limit", default=math.inf)


@contextmanager
def memory_limit(n_bytes: float) -> Iterator[None]:
    """Refuse work that is estimated to take more memory than this, inside the block."""
    before = _LIMIT_BYTES.set(n_bytes)
    try:
        yield
    finally:
        _LIMIT_BYTES.reset(before)


def available_memory_bytes() -> float | None:
    """Memory that new processes may use without swapping; None where it is unknown."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    for line in lines:
        if line.startswith("MemAvailable:"):
            return 1024.0 * float(line.split()[1])
    return None


def require_memory(needed_bytes: float, hint: str, *, where: object = None) -> None:
    """Raise UserError where work takes more memory than is free, or more than --max-memory.

    hint: what to do, with the setting that makes it large.
    """
    free = available_memory_bytes()
    allowed = _LIMIT_BYTES.get()
    if needed_bytes <= min(allowed, math.inf if free is None else free):
        return
    is_limit = free is None or allowed < free
    raise UserError(
        what="the run will not fit into memory",
        where=where,
        expected=f"about {_gib(needed_bytes)}",
        got=f"{_gib(allowed)} of --max-memory" if is_limit else f"{_gib(free or 0.0)} free",
        hint=hint,
    )


def _gib(n_bytes: float) -> str:
    return f"{n_bytes / 2**30:.3g} GiB"
