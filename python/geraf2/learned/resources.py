"""Device, threads and memory of a training."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import torch

from geraf2.errors import UserError
from geraf2.learned.config import PaperConfig
from geraf2.scene import Capture

T = TypeVar("T")
R = TypeVar("R")

# Measured as the growth of the largest resident set (single precision, forward and backward).
_BASE_BYTES = 500e6
_BYTES_PER_POINT = 900.0
_BYTES_PER_POINT_AND_GROUP = 80.0
_MLP_BYTES_PER_NEURON = 26.0
_MLP_NEURONS = 8 * 256 + 4 * 256
_BYTES_PER_VOXEL = 40.0


def training_device(config: PaperConfig) -> torch.device:
    """Device of a config; UserError for a GPU that torch does not have.

    A step of voxels launches many small operations: the C++ kernels outrun a GPU there.
    """
    has_gpu = torch.cuda.is_available()
    if config.device == "cuda" and not has_gpu:
        raise UserError(
            what="torch has no GPU here",
            where="--paper.device cuda",
            hint="use --paper.device auto, or install a torch with CUDA",
        )
    pays = config.device == "cuda" or config.field != "grid"
    return torch.device("cuda" if has_gpu and pays and config.device != "cpu" else "cpu")


def training_bytes(config: PaperConfig, capture: Capture, n_threads: int = 1) -> float:
    """Largest resident set of a training on a CPU [bytes], within a factor of 1.5."""
    n_points = 0.79 * config.n_cells**2 * config.n_samples  # the disc in its square
    n_groups = config.n_clusters or config.n_antennas
    per_point = _BYTES_PER_POINT + _BYTES_PER_POINT_AND_GROUP * n_groups
    if config.field == "mlp":
        per_point += _MLP_BYTES_PER_NEURON * _MLP_NEURONS
    n_voxels = config.grid_n[-1] ** 3 + config.reflectivity_n**3 + config.mesh_n**3
    n_samples = sum(pose.signal.size for pose in capture.poses)
    if config.field != "mlp":
        n_points *= min(config.n_planes, len(capture.poses), n_threads)  # planes in parallel
    return _BASE_BYTES + n_points * per_point + _BYTES_PER_VOXEL * n_voxels + 8.0 * n_samples


class PlaneThreads:
    """Pool of threads that render the planes of a step in parallel.

    Most of a step is native code, which releases the interpreter's lock.

    n_planes: planes of a step; with one, no pool is made.
    num_threads: threads in all; torch's number when None.
    """

    def __init__(self, n_planes: int, *, num_threads: int | None = None) -> None:
        n_all = torch.get_num_threads() if num_threads is None else num_threads
        n_parallel = max(min(n_planes, n_all), 1)
        self.n_of_plane = max(n_all // n_parallel, 1)
        """Threads of each plane."""
        self._pool = ThreadPoolExecutor(n_parallel, "plane") if n_parallel > 1 else None

    def map(self, function: Callable[[T], R], items: Iterable[T]) -> list[R]:
        """Results of a function for each item, in the order of the items."""
        if self._pool is None:
            return [function(item) for item in items]

        n_before = torch.get_num_threads()

        def call(item: T) -> R:
            # torch keeps a number of threads per thread; a new thread takes the last one set.
            torch.set_num_threads(self.n_of_plane)
            return function(item)

        try:
            return list(self._pool.map(call, items))
        finally:
            torch.set_num_threads(n_before)
