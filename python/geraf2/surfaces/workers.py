"""Independent pieces of work side by side, their results in order."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Self, TypeVar

from geraf2.ops._threads import resolve_num_threads

_T = TypeVar("_T")


class Workers:
    """Threads for pieces that spend their time in kernels of one thread each.

    So no result depends on the number of threads, and none waits for another at the end of each
    kernel.

    num_threads: torch's number when torch is loaded, else all cores, when None.
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
        """Results of `work` for the first of all arguments, the second, and so on.

        on_result: called with their number as they come, in their order, by the caller's thread.
        """
        results: list[_T] = []
        for result in (map if self._pool is None else self._pool.map)(work, *arguments):
            results.append(result)
            if on_result is not None:
                on_result(len(results))
        return results

    def start(self, work: Callable[[], _T]) -> Callable[[], _T]:
        """Begin a piece beside the caller; what is returned waits for its result."""
        return work if self._pool is None else self._pool.submit(work).result
