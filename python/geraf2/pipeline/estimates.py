"""Estimated time and memory of jobs, from rates measured on one machine."""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geraf2._memory import require_memory
from geraf2.scene import Capture, LosPrior
from geraf2.scene.summary import CaptureSummary
from geraf2.surfaces.config import SurfaceFitConfig
from geraf2.surfaces.fit_memory import fit_bytes

# CPU seconds of `geraf2 reconstruct` by preset: serial part (imports, pictures), parallel part
# (fits, mesh), and parallel part per antenna sample.
_RECONSTRUCT_S = {"fast": (6.0, 0.0, 0.25e-6), "best": (8.0, 10.0, 0.55e-6)}
# Python with its libraries and the pictures of a report, then bytes per antenna sample.
_RECONSTRUCT_FIXED_BYTES = 320e6
_RECONSTRUCT_BYTES_PER_SAMPLE = 32.0
# Time per voxel-antenna pair of the block kernel on one thread, for 64 samples and AVX2 [ns].
_IMAGE_NS_PER_PAIR = 0.9
_IMAGE_FIXED_BYTES = 190e6
_BYTES_PER_IMAGE_VOXEL = 12.0
_RENDER_FIXED_BYTES = 400e6
_BYTES_PER_VOXEL = 24.0
# Time per voxel-antenna pair of the factorised kernel on one thread [ns].
_FACTORISED_NS_PER_PAIR = 0.2
# Per surface element in the simulator and in the fits to heat maps.
BYTES_PER_ELEMENT = 500.0
# Per part of a surface: per sample of its echo, and per target of its images.
_BYTES_PER_PART_SAMPLE = 8.0
_BYTES_PER_PART_TARGET = 76.0
# Depths of the default image of a single plane.
_N_SLICES = 32


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Cost of a job on this machine."""

    seconds: float
    memory_bytes: float

    def __str__(self) -> str:
        minutes, seconds = divmod(round(self.seconds), 60)
        time = f"{minutes} min {seconds} s" if minutes else f"{max(seconds, 1)} s"
        return f"{time} and {self.memory_bytes / 2**30:.1f} GiB on {n_threads()} threads"


def n_threads() -> int:
    """Count the CPUs that this process may use."""
    return len(os.sched_getaffinity(0))


def reconstruct_estimate(summary: CaptureSummary) -> Estimate:
    """Cost of `geraf2 reconstruct`."""
    return reconstruct_cost(summary.n_antennas * summary.waveform.n_samples, n_threads())


def reconstruct_cost(n_samples: int, num_threads: int = 1, *, preset: str = "best") -> Estimate:
    """Cost of `geraf2 reconstruct` for n_samples over all antennas; unknown presets as best."""
    alone, shared, per_sample = _RECONSTRUCT_S.get(preset, _RECONSTRUCT_S["best"])
    return Estimate(
        seconds=alone + (shared + per_sample * n_samples) / num_threads,
        memory_bytes=_RECONSTRUCT_FIXED_BYTES + _RECONSTRUCT_BYTES_PER_SAMPLE * n_samples,
    )


def require_reconstructable(
    summary: CaptureSummary, config: object, size_m: Sequence[float], where: object
) -> None:
    """Raise UserError if a reconstruction in a box of this size does not fit into memory."""
    if hasattr(config, "paper"):  # the training checks its own memory
        return
    holders = (config, getattr(config, "refine", None))
    fits = [holder.fit for holder in holders if hasattr(holder, "fit")]
    # The grid is a cube around the content, about as large as the box with its margin.
    voxels = [min(fit.max_voxels, (max(size_m) / fit.spacing_m) ** 3) for fit in fits]
    needed = max(reconstruct_estimate(summary).memory_bytes, fit_bytes(max(voxels, default=0.0)))
    hint = "raise the fit's spacing-m, lower its max-voxels, or leave planes out"
    require_memory(needed, hint, where=where)


def image_estimate(summary: CaptureSummary, n_voxels: int | None = None) -> Estimate:
    """Cost of `geraf2 image`, for its default grid if n_voxels is None."""
    if n_voxels is None and summary.is_plane:
        n_voxels = _N_SLICES * round(np.prod(summary.aperture_m) / DEFAULT_IMAGE_SPACING_M**2)
    if n_voxels is None:
        side = summary.scene_width_m or DEFAULT_IMAGE_SIDE_M
        n_voxels = (round(side / DEFAULT_IMAGE_SPACING_M) + 1) ** 3
    pairs = float(n_voxels) * summary.n_antennas
    return Estimate(
        seconds=2.0 + 1e-9 * _IMAGE_NS_PER_PAIR * pairs / n_threads(),
        memory_bytes=_image_bytes(
            n_voxels,  # poses are read one at a time
            max((pose.n_antennas for pose in summary.poses), default=0)
            * summary.waveform.n_samples,
        ),
    )


def _image_bytes(n_voxels: float, n_samples: int) -> float:
    """Memory of an image; n_samples: of the largest pose, over all its antennas."""
    return _IMAGE_FIXED_BYTES + _BYTES_PER_IMAGE_VOXEL * n_voxels + 8.0 * n_samples


def fine_image(
    sides_m: Sequence[float], wavelength_m: float, pose_sizes: Sequence[int], n_samples: int
) -> str:
    """Describe the cost of `geraf2 image` with four voxels per wavelength.

    sides_m: of the volume. pose_sizes: antennas of each pose. n_samples: of each antenna.
    """
    spacing = 0.25 * wavelength_m
    n_voxels = math.prod(int(side / spacing) + 1 for side in sides_m)
    seconds = 1e-9 * _FACTORISED_NS_PER_PAIR * n_voxels * sum(pose_sizes)
    memory = _image_bytes(n_voxels, n_samples * max(pose_sizes, default=0))
    cpu = (
        f"{max(seconds, 1.0):.0f} CPU s"
        if seconds < 3600.0
        else f"{seconds / 3600.0:.1f} CPU hours"
    )
    return (
        f"{n_voxels / 1e6:.3g} million voxels of {1e3 * spacing:.2g} mm: about {cpu} and "
        f"{memory / 2**30:.1f} GiB (geraf2 image --spacing-m {spacing:.2g})"
    )


def require_renderable(
    prior: LosPrior, capture: Capture, spacing_m: float, echo: SurfaceFitConfig
) -> None:
    """Raise UserError if heat maps of a surface in a box do not fit into memory."""
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
    """Surface area of a box [m^2]."""
    x, y, z = size_m
    return 2.0 * (x * y + y * z + z * x)


DEFAULT_IMAGE_SIDE_M = 0.24
DEFAULT_IMAGE_SPACING_M = 0.004
