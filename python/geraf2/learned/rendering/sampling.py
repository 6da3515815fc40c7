"""Lensless sampling: parallel primary rays through the scene, shared by all antennas of a plane."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from geraf2._types import Bools, Floats
from geraf2._validation import require_least, require_positive
from geraf2.ops.lensless import sample_rays
from geraf2.ops.visibility import MeshScene
from geraf2.scene import LosPrior


@dataclass(frozen=True, kw_only=True)
class SamplingConfig:
    """How densely the scene is sampled for one step."""

    n_cells: int = 32
    """Cells along the side of the scene's disc; a ray starts in each: 804 for 32."""
    n_samples: int = 32
    """Intervals of a ray; their ends are jittered within their share of it."""
    disc_radius: float = 1.05
    """Radius of the disc over the prior's largest half side; a carton's corners stay outside."""
    margin: float = 1.1
    """Boundary of the scene: the prior grown by this factor about its middle."""

    def __post_init__(self) -> None:
        require_least(self, n_cells=1, n_samples=2)
        require_positive("disc_radius", self.disc_radius)
        if self.margin <= 1.0:
            msg = f"margin must exceed 1, got {self.margin!r}"
            raise ValueError(msg)


class PrimaryRays(NamedTuple):
    """Parallel rays through the scene and their samples."""

    cells: Tensor
    """Number of each ray's cell in the disc, (n_rays,)."""
    starts: Tensor
    """Where each ray enters the scene, (n_rays, 3) [m]."""
    direction: Tensor
    """Unit vector w_p of all rays, (3,)."""
    points: Tensor
    """Mid-intervals, (n_rays, n_samples, 3) [m]."""
    step: Tensor
    """Lengths of the contiguous intervals, (n_rays, n_samples) [m]."""
    offset: Tensor
    """From `starts` to the first interval, (n_rays,) [m]."""

    def to(self, device: torch.device) -> "PrimaryRays":
        """Return the same rays on a device."""
        return PrimaryRays(*(tensor.to(device) for tensor in self))


class LenslessSampler:
    """Primary rays of scan planes around one box.

    config: density.
    inner: where samples lie; the whole scene when None. Rays still start at the scene's boundary.
    dtype: of the samples.

    Notes
    -----
    Section 3.2 of the paper: rays are parallel to the radar's direction w_p and start at the
    boundary of the scene, which Embree finds.
    """

    def __init__(
        self,
        prior: LosPrior,
        config: SamplingConfig | None = None,
        *,
        inner: LosPrior | None = None,
        dtype: torch.dtype = torch.float32,
        num_threads: int | None = None,
    ) -> None:
        self.config = config if config is not None else SamplingConfig()
        self.dtype = dtype
        self.center = np.asarray(prior.center_m)
        grown = self.center + self.config.margin * (prior.vertices - self.center)
        self.boundary = MeshScene(grown, prior.faces, num_threads=num_threads)
        self.sampled = (
            self.boundary
            if inner is None
            else MeshScene(inner.vertices, inner.faces, num_threads=num_threads)
        )
        self.radius_m = 0.5 * self.config.disc_radius * max((inner or prior).size_m)
        self._reach_m = float(np.linalg.norm(grown - self.center, axis=1).max()) + 0.01
        side = (np.arange(self.config.n_cells) + 0.5) / self.config.n_cells * 2.0 - 1.0
        cells = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
        # Middles of the disc's cells, in its radius, (n_rays, 2).
        self.cells = cells[np.linalg.norm(cells, axis=1) <= 1.0]

    @property
    def n_rays(self) -> int:
        """Cells of the disc."""
        return int(self.cells.shape[0])

    def cell_rays(self, axes: Floats) -> tuple[Floats, ...]:
        """Rays through the middles of all cells for a plane with these axes (3, 3).

        Returns origins (n_rays, 3) [m] and directions (n_rays, 3).
        """
        return self._rays(axes, self.cells)

    def _rays(self, axes: Floats, places: Floats) -> tuple[Floats, Floats]:
        forward, across, up = np.asarray(axes, dtype=np.float64)
        origins = (
            self.center
            - self._reach_m * forward
            + self.radius_m * (places[:, :1] * across + places[:, 1:] * up)
        )
        return origins, np.broadcast_to(forward, origins.shape)

    def sample(
        self, axes: Floats, generator: torch.Generator, *, keep: Bools | None = None
    ) -> PrimaryRays:
        """Draw one ray a cell and its intervals.

        axes: rows: looking direction w_p, horizontal, vertical, (3, 3).
        generator: of the jitter.
        keep: cells to use, (n_rays,); all when None. Rays that miss the scene are left out.
        """
        config = self.config
        n_rays = self.n_rays
        jitter = torch.rand((n_rays, 2), generator=generator, dtype=torch.float64)
        ends = torch.rand((n_rays, config.n_samples + 1), generator=generator, dtype=torch.float64)
        places = self.cells + (2.0 * jitter.numpy() - 1.0) / config.n_cells
        origins, directions = self._rays(axes, places)
        # A closed box without dents has one stretch a ray; of several, all is between.
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

    def secondary_starts(self, antennas: Floats, points: Floats) -> Floats:
        """Where the straight ways from antennas to points enter the scene, pair by pair.

        antennas: (n, 3) [m], outside the scene.
        points: (n, 3) [m]. For one outside the scene, the place nearest on its way is taken: the
            point itself.

        Returns (n, 3) [m].
        """
        return self.boundary.first_meetings(antennas, points)
