"""How long a run will take and how much memory, from measured rates."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geraf2.errors import UserError
from geraf2.scene.summary import CaptureSummary

# Processor seconds per antenna sample, and seconds that no thread shares, of `geraf2 reconstruct`:
# 1 s of processor time for 4.5e6 antenna samples, then the solver, the mesh and the pictures.
_RECONSTRUCT_S_PER_SAMPLE = 0.25e-6
_RECONSTRUCT_FIXED_S = 6.0
# Python with its libraries, the solver's matrices, then bytes per antenna sample.
_RECONSTRUCT_FIXED_BYTES = 240e6
_BYTES_PER_SAMPLE = 24.0
# Nanoseconds per voxel-antenna pair of the block kernel with 64 samples and AVX2, one thread.
_IMAGE_NS_PER_PAIR = 0.9
_IMAGE_FIXED_BYTES = 400e6
_BYTES_PER_VOXEL = 24.0
# Of the depths before a single plane.
_N_SLICES = 32


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Cost of a run on this machine."""

    seconds: float
    memory_bytes: float

    def __str__(self) -> str:
        minutes, seconds = divmod(round(self.seconds), 60)
        time = f"{minutes} min {seconds} s" if minutes else f"{max(seconds, 1)} s"
        return f"{time} and {self.memory_bytes / 2**30:.1f} GiB on {n_threads()} threads"


def n_threads() -> int:
    """CPUs that this process may use."""
    return len(os.sched_getaffinity(0))


def available_memory_bytes() -> float | None:
    """Memory that new processes may use without swapping; None where the system does not say."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    for line in lines:
        if line.startswith("MemAvailable:"):
            return 1024.0 * float(line.split()[1])
    return None


def require_memory(needed_bytes: float, hint: str) -> None:
    """Raise UserError where a run will not fit into the memory that is free."""
    free = available_memory_bytes()
    if free is not None and needed_bytes > free:
        raise UserError(
            what="the run will not fit into memory",
            expected=f"about {needed_bytes / 2**30:.1f} GiB",
            got=f"{free / 2**30:.1f} GiB free",
            hint=hint,
        )


def reconstruct_estimate(summary: CaptureSummary) -> Estimate:
    """Cost of `geraf2 reconstruct`."""
    return reconstruct_cost(summary.n_antennas * summary.waveform.n_samples, n_threads())


def reconstruct_cost(n_samples: int, num_threads: int = 1) -> Estimate:
    """Cost of `geraf2 reconstruct` of so many samples, over all antennas."""
    return Estimate(
        seconds=_RECONSTRUCT_FIXED_S + _RECONSTRUCT_S_PER_SAMPLE * n_samples / num_threads,
        memory_bytes=_RECONSTRUCT_FIXED_BYTES + _BYTES_PER_SAMPLE * n_samples,
    )


def image_estimate(summary: CaptureSummary, n_voxels: int | None = None) -> Estimate:
    """Cost of `geraf2 image`; by default of its default grid."""
    if n_voxels is None and summary.is_plane:
        n_voxels = _N_SLICES * round(np.prod(summary.aperture_m) / DEFAULT_IMAGE_SPACING_M**2)
    if n_voxels is None:
        side = summary.scene_width_m or DEFAULT_IMAGE_SIDE_M
        n_voxels = (round(side / DEFAULT_IMAGE_SPACING_M) + 1) ** 3
    pairs = float(n_voxels) * summary.n_antennas
    return Estimate(
        seconds=2.0 + 1e-9 * _IMAGE_NS_PER_PAIR * pairs / n_threads(),
        memory_bytes=_IMAGE_FIXED_BYTES
        + _BYTES_PER_VOXEL * n_voxels
        + 8.0 * summary.n_antennas * summary.waveform.n_samples,
    )


DEFAULT_IMAGE_SIDE_M = 0.24
DEFAULT_IMAGE_SPACING_M = 0.004
