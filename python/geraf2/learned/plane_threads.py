"""The planes of a step side by side: most of a step is native code, which lets others run."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import torch

T = TypeVar("T")
R = TypeVar("R")


class PlaneThreads:
    """Threads that share the planes of a step; one plane after the other where there is one.

    n_planes: of a step.
    num_threads: in all; torch's number when None.
    """

    def __init__(self, n_planes: int, *, num_threads: int | None = None) -> None:
        self._n_all = torch.get_num_threads() if num_threads is None else num_threads
        self._n_side_by_side = max(min(n_planes, self._n_all), 1)
        self.n_of_plane = max(self._n_all // self._n_side_by_side, 1)
        """Threads that each plane has for itself."""
        self._pool = (
            ThreadPoolExecutor(self._n_side_by_side, "plane") if self._n_side_by_side > 1 else None
        )

    def map(self, work: Callable[[T], R], items: Iterable[T]) -> list[R]:
        """Do `work` on each item; what it makes, in their order."""
        if self._pool is None:
            return [work(item) for item in items]

        n_before = torch.get_num_threads()

        def alone(item: T) -> R:
            # torch keeps a number for each thread that has one, and gives the last to new threads.
            torch.set_num_threads(self.n_of_plane)
            return work(item)

        try:
            return list(self._pool.map(alone, items))
        finally:
            torch.set_num_threads(n_before)
