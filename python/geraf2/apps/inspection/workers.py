"""Independent tasks in parallel threads, with results in order."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Self, TypeVar

from geraf2.ops._threads import resolve_num_threads

_T = TypeVar("_T")


class Workers:
    """Pool of threads for tasks whose kernels use one thread each.

    No result depends on the number of threads, and tasks do not wait for each other.

    num_threads: when None, torch's number if torch is loaded, else all cores.
    """

    def __init__(self, num_threads: int | None = None) -> None:
        n_workers = resolve_num_threads(num_threads)
        self._pool = ThreadPoolExecutor(n_workers) if n_workers > 1 else None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def each(
        self,
        work: Callable[..., _T],
        *arguments: Iterable[object],
        on_result: Callable[[int], None] | None = None,
    ) -> list[_T]:
        """Map `work` over the arguments in parallel; results are in the arguments' order.

        on_result: called after each result with their number so far, in the caller's thread.
        """
        results: list[_T] = []
        for result in (map if self._pool is None else self._pool.map)(work, *arguments):
            results.append(result)
            if on_result is not None:
                on_result(len(results))
        return results
