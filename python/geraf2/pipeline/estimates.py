"""Estimated time and memory of a run, from measured rates."""

import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geraf2._memory import available_memory_bytes, memory_of_parts, require_memory
from geraf2.imaging.slabs import SLAB_BYTES_PER_VOXEL, SLAB_GIB, Slabs
from geraf2.scene import Capture, Grid, LosPrior
from geraf2.scene.summary import CaptureSummary
from geraf2.surfaces.config import SurfaceFitConfig
from geraf2.surfaces.fit_memory import fit_bytes

__all__ = [
    "Estimate",
    "available_memory_bytes",
    "image_estimate",
    "n_threads",
    "reconstruct_estimate",
    "require_memory",
    "require_renderable",
]

# Processor seconds of `geraf2 reconstruct` with a preset: what threads do not share (imports,
# pictures), what they do (fits, mesh), and of each antenna sample; 36 planes at 3 mm have 9e6.
_RECONSTRUCT_S = {"fast": (6.0, 0.0, 0.25e-6), "best": (8.0, 10.0, 0.55e-6)}
# Python with its libraries and the pictures of a report: 304 MiB were the peak of a small scan.
# Then bytes per antenna sample.
_RECONSTRUCT_FIXED_BYTES = 320e6
_RECONSTRUCT_BYTES_PER_SAMPLE = 32.0
_BYTES_PER_SAMPLE = 24.0
# Nanoseconds per voxel-antenna pair of the block kernel with 64 samples and AVX2, one thread.
_IMAGE_NS_PER_PAIR = 0.9
# 174 MiB were the peak of an image of 70 thousand voxels, 199 MiB of one of four million.
_IMAGE_FIXED_BYTES = 190e6
_BYTES_PER_IMAGE_VOXEL = 12.0
_RENDER_FIXED_BYTES = 400e6
_BYTES_PER_VOXEL = 24.0
# The same of the factorised kernel: 3 s for 192^3 voxels and 2025 antennas.
_FACTORISED_NS_PER_PAIR = 0.2
# Python with its libraries and the kernel's nodes: 122, 177 and 369 MiB were the peaks of slabs of
# 16, 64 and 256 MiB with 900 antennas, within 5 % of this.
_SLAB_FIXED_BYTES = 115e6
# Elements of surfaces in the simulator and in the fits to heat maps, with what is computed of them.
BYTES_PER_ELEMENT = 500.0
# Of a part of a surface: its echo at a plane, and its images with what a fit makes of them. With
# 96 parts, 15 planes and 2268 antennas 889 MB were the peak, 885 are expected.
_BYTES_PER_PART_SAMPLE = 8.0
_BYTES_PER_PART_TARGET = 76.0
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


def reconstruct_estimate(summary: CaptureSummary) -> Estimate:
    """Cost of `geraf2 reconstruct`."""
    return reconstruct_cost(summary.n_antennas * summary.waveform.n_samples, n_threads())


def reconstruct_cost(n_samples: int, num_threads: int = 1, *, preset: str = "best") -> Estimate:
    """Cost of `geraf2 reconstruct` of so many samples, over all antennas; other presets as best."""
    alone, shared, per_sample = _RECONSTRUCT_S.get(preset, _RECONSTRUCT_S["best"])
    return Estimate(
        seconds=alone + (shared + per_sample * n_samples) / num_threads,
        memory_bytes=_RECONSTRUCT_FIXED_BYTES + _RECONSTRUCT_BYTES_PER_SAMPLE * n_samples,
    )


def require_reconstructable(
    summary: CaptureSummary, config: object, size_m: Sequence[float], where: object
) -> None:
    """Raise UserError where a reconstruction in a box of this size does not fit into memory."""
    if hasattr(config, "paper"):  # its fields are checked by themselves
        return
    holders = (config, getattr(config, "refine", None))
    fits = [holder.fit for holder in holders if hasattr(holder, "fit")]
    # The grid is a cube around the content, about as large as the box with room around it.
    voxels = [min(fit.max_voxels, (max(size_m) / fit.spacing_m) ** 3) for fit in fits]
    needed = max(reconstruct_estimate(summary).memory_bytes, fit_bytes(max(voxels, default=0.0)))
    hint = "raise the fit's spacing-m, lower its max-voxels, or leave planes out"
    require_memory(needed, hint, where=where)


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
        + _BYTES_PER_IMAGE_VOXEL * n_voxels
        + 8.0
        * max((pose.n_antennas for pose in summary.poses), default=0)
        * summary.waveform.n_samples,  # poses are read one at a time
    )


def slab_bytes(slabs: Slabs, n_samples: int) -> float:
    """Memory of a process that images one slab.

    n_samples: of the largest pose, over all its antennas.
    """
    return _SLAB_FIXED_BYTES + SLAB_BYTES_PER_VOXEL * slabs.n_voxels + _BYTES_PER_SAMPLE * n_samples


def fine_image(
    sides_m: Sequence[float], wavelength_m: float, pose_sizes: Sequence[int], n_samples: int
) -> str:
    """Cost of an image with four voxels a wavelength, by `geraf2 image --tiles`, in words.

    sides_m: of the volume. pose_sizes: antennas of each pose.
    """
    spacing = 0.25 * wavelength_m
    shape = [int(side / spacing) + 1 for side in sides_m]
    with memory_of_parts():
        grid = Grid.centered((0.0, 0.0, 0.0), spacing, shape)
    slabs = Slabs.of(
        grid, max(SLAB_GIB * 2.0**30, SLAB_BYTES_PER_VOXEL * grid.n_voxels / max(shape))
    )
    seconds = 1e-9 * _FACTORISED_NS_PER_PAIR * grid.n_voxels * sum(pose_sizes)
    memory = slab_bytes(slabs, n_samples * max(pose_sizes, default=0))
    cpu = f"{seconds:.0f} CPU s" if seconds < 3600.0 else f"{seconds / 3600.0:.1f} CPU hours"
    return (
        f"{grid.n_voxels / 1e6:.3g} million voxels of {1e3 * spacing:.2g} mm, "
        f"{4e-9 * grid.n_voxels:.2g} GB in {len(slabs)} slab{'s' * (len(slabs) > 1)}: about {cpu} "
        f"in all, {memory / 2**30:.1f} GiB a process (geraf2 image --tiles)"
    )


def require_renderable(
    prior: LosPrior, capture: Capture, spacing_m: float, echo: SurfaceFitConfig
) -> None:
    """Raise UserError where heat maps of a surface in a box do not fit into memory."""
    area = box_area_m2(prior.size_m)
    n_antennas = max(pose.n_antennas for pose in capture.poses)
    of_node = _BYTES_PER_PART_SAMPLE * n_antennas * capture.waveform.n_samples
    of_node += _BYTES_PER_PART_TARGET * echo.n_planes * echo.n_targets
    parts = {
        "--echo.n-nodes": of_node * echo.n_nodes,
        "--echo.max-edge-m": BYTES_PER_ELEMENT * area / echo.max_edge_m**2,
        "--echo.wall-edge-m": BYTES_PER_ELEMENT * area / echo.wall_edge_m**2,
        "--spacing-m": _BYTES_PER_VOXEL * float(np.prod(prior.size_m)) / spacing_m**3,
    }
    largest = max(parts, key=parts.__getitem__)
    change = "lower" if largest == "--echo.n-nodes" else "raise"
    require_memory(_RENDER_FIXED_BYTES + sum(parts.values()), f"{change} {largest}")


def box_area_m2(size_m: tuple[float, float, float]) -> float:
    """Area of a box [m2]."""
    x, y, z = size_m
    return 2.0 * (x * y + y * z + z * x)


DEFAULT_IMAGE_SIDE_M = 0.24
DEFAULT_IMAGE_SPACING_M = 0.004
