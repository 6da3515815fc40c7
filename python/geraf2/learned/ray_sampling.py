"""Lensless sampling: parallel primary rays shared by all antennas of a plane."""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from geraf2._types import Bools, Floats
from geraf2.ops.lensless import sample_rays
from geraf2.ops.visibility import MeshScene
from geraf2.scene import LosPrior

_DISC_RADIUS = 1.05
"""Radius of the disc over the prior's largest half side; a carton's corners stay outside."""
_MARGIN = 1.1
"""Boundary of the scene: the prior grown by this factor about its middle."""


class PrimaryRays(NamedTuple):
    """Parallel rays through the scene and their samples."""

    cells: Tensor
    """Number of each ray's cell in the disc, (n_rays,)."""
    starts: Tensor
    """Entry of each ray into the scene, (n_rays, 3) [m]."""
    direction: Tensor
    """Unit vector w_p of all rays, (3,)."""
    points: Tensor
    """Mid-intervals, (n_rays, n_samples, 3) [m]."""
    step: Tensor
    """Lengths of the contiguous intervals, (n_rays, n_samples) [m]."""
    offset: Tensor
    """From `starts` to the first interval, (n_rays,) [m]."""

    def to(self, device: torch.device) -> "PrimaryRays":
        """Copy of the rays on a device."""
        return PrimaryRays(*(tensor.to(device) for tensor in self))


class LenslessSampler:
    """Primary rays of scan planes around one box.

    n_cells: cells along the side of the scene's disc; one ray each: 804 rays for 32.
    n_samples: intervals of a ray; their ends are jittered within their share of it.
    inner: region of the samples; the whole scene when None. Rays start at the scene's boundary.
    dtype: of the samples.

    Section 3.2 of the paper: rays are parallel to the radar's direction w_p and start at the
    boundary of the scene, which Embree finds.
    """

    def __init__(
        self,
        prior: LosPrior,
        *,
        n_cells: int = 32,
        n_samples: int = 32,
        inner: LosPrior | None = None,
        dtype: torch.dtype = torch.float32,
        num_threads: int | None = None,
    ) -> None:
        self.n_cells, self.n_samples, self.dtype = n_cells, n_samples, dtype
        self.center = np.asarray(prior.center_m)
        grown = self.center + _MARGIN * (prior.vertices - self.center)
        self.boundary = MeshScene(grown, prior.faces, num_threads=num_threads)
        self.sampled = (
            self.boundary
            if inner is None
            else MeshScene(inner.vertices, inner.faces, num_threads=num_threads)
        )
        self.radius_m = 0.5 * _DISC_RADIUS * max((inner or prior).size_m)
        self._reach_m = float(np.linalg.norm(grown - self.center, axis=1).max()) + 0.01
        side = (np.arange(n_cells) + 0.5) / n_cells * 2.0 - 1.0
        cells = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
        # Middles of the disc's cells, in its radius, (n_rays, 2).
        self.cells = cells[np.linalg.norm(cells, axis=1) <= 1.0]

    @property
    def n_rays(self) -> int:
        """Cells of the disc."""
        return int(self.cells.shape[0])

    def cell_rays(self, axes: Floats, at: Floats | None = None) -> tuple[Floats, Floats]:
        """Rays through all cells for a plane with these axes (3, 3).

        at: positions in the disc, in its radius, (n_rays, 2); the cells' middles when None.

        Returns origins (n_rays, 3) [m] and directions (n_rays, 3).
        """
        at = self.cells if at is None else at
        forward, across, up = np.asarray(axes, dtype=np.float64)
        origins = (
            self.center
            - self._reach_m * forward
            + self.radius_m * (at[:, :1] * across + at[:, 1:] * up)
        )
        return origins, np.broadcast_to(forward, origins.shape)

    def sample(
        self, axes: Floats, generator: torch.Generator, *, keep: Bools | None = None
    ) -> PrimaryRays:
        """One random ray a cell, with its intervals.

        axes: rows: viewing direction w_p, horizontal, vertical, (3, 3).
        generator: of the jitter.
        keep: cells to use, (n_rays,); all when None. Rays that miss the scene are left out.
        """
        n_rays, n_ends = self.n_rays, self.n_samples + 1
        jitter = torch.rand((n_rays, 2), generator=generator, dtype=torch.float64)
        ends = torch.rand((n_rays, n_ends), generator=generator, dtype=torch.float64)
        positions = self.cells + (2.0 * jitter.numpy() - 1.0) / self.n_cells
        origins, directions = self.cell_rays(axes, positions)
        # A convex box has one interval a ray; of several, their hull is used.
        enters, leaves = self.boundary.spans(origins, directions)
        near, far = enters, leaves
        if self.sampled is not self.boundary:
            near, far = self.sampled.spans(origins, directions)
            near, far = np.maximum(near, enters), np.minimum(far, leaves)
        used = np.isfinite(near) & (far > near)
        if keep is not None:
            used = used & keep
        cells = np.flatnonzero(used)
        samples = sample_rays(
            *(origins[cells], directions[0], near[cells], far[cells], ends.numpy()[cells]),
            dtype=self.dtype,
        )
        before = torch.from_numpy(near[cells] - enters[cells])
        direction = torch.from_numpy(np.array(directions[0]))
        starts = samples.starts.double() - before[:, None] * direction
        return PrimaryRays(
            cells=torch.from_numpy(cells),
            starts=starts.to(self.dtype),
            direction=direction.to(self.dtype),
            points=samples.points,
            step=samples.step,
            offset=samples.offset + before.to(self.dtype),
        )
