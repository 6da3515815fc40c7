"""Slabs of a grid: parts of a volume that are imaged in sequence or by several workers."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from geraf2.errors import UserError
from geraf2.scene import Grid

SLAB_BYTES_PER_VOXEL = 16.0
"""Memory: complex image of a pose, its magnitude, and the sum over poses."""
SLAB_GIB = 0.25
"""Default memory of a slab, 16.8 million voxels or 256 a side."""
# Block lengths of the matched filter's interpolation: slabs that cut no block need no extra time
# (docs/math/block-and-factorised.md#factorised-method).
_WHOLE_LAYERS = (64, 16, 4)


@dataclass(frozen=True, kw_only=True)
class Slabs:
    """Parts of a grid along its longest axis; only grid and memory determine the cuts."""

    grid: Grid
    axis: int
    n_layers: int
    """Layers of voxels in each slab; the last may have fewer."""

    @classmethod
    def of(cls, grid: Grid, max_bytes: float) -> "Slabs":
        """Slabs as thick as the memory allows [bytes]; UserError where a layer does not fit.

        Their number of layers is a multiple of 64, 16 or 4 if possible.
        """
        axis = max(range(3), key=lambda a: grid.shape[a])
        n_all = grid.shape[axis]
        layer_bytes = SLAB_BYTES_PER_VOXEL * grid.n_voxels / n_all
        fitting = int(max_bytes // layer_bytes)
        if fitting < 1:
            raise UserError(
                what="not even one layer of voxels fits into the memory of a slab",
                expected=f"at least {layer_bytes / 2**30:.2g} GiB",
                got=f"{max_bytes / 2**30:.2g} GiB",
                hint="raise --slab-gib",
            )
        if fitting < n_all:
            step = next((n for n in _WHOLE_LAYERS if n <= fitting), 1)
            fitting -= fitting % step
        return cls(grid=grid, axis=axis, n_layers=min(fitting, n_all))

    def __len__(self) -> int:
        return math.ceil(self.grid.shape[self.axis] / self.n_layers)

    def __iter__(self) -> Iterator[tuple[tuple[slice, ...], Grid]]:
        """Yield the index of each slab in the volume, and its voxels."""
        for number in range(len(self)):
            yield self.index(number), self.part(number)

    @property
    def n_voxels(self) -> int:
        """Number of voxels of the largest slab."""
        return self.n_layers * self.grid.n_voxels // self.grid.shape[self.axis]

    def index(self, number: int) -> tuple[slice, ...]:
        """Index of a slab in the volume."""
        first = number * self.n_layers
        last = min(first + self.n_layers, self.grid.shape[self.axis])
        whole: list[slice] = [slice(0, n) for n in self.grid.shape]
        whole[self.axis] = slice(first, last)
        return tuple(whole)

    def part(self, number: int) -> Grid:
        """Voxels of a slab."""
        index = self.index(number)
        if len(self) == 1:
            return self.grid
        x, y, z = (
            o + self.grid.spacing_m * s.start
            for o, s in zip(self.grid.origin_m, index, strict=True)
        )
        nx, ny, nz = (s.stop - s.start for s in index)
        return Grid(origin_m=(x, y, z), spacing_m=self.grid.spacing_m, shape=(nx, ny, nz))
