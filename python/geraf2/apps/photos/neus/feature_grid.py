"""Features on those nodes of a grid that lie near a surface."""

from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from geraf2._types import Bools
from geraf2._validation import require_shape
from geraf2.scene import Grid

_CORNERS = torch.tensor([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


class FeatureGrid(nn.Module):
    """Trilinear features, stored for a band of nodes only; all others share row zero.

    grid: the nodes.
    active: nodes with features of their own, grid.shape.
    """

    def __init__(self, grid: Grid, active: Bools, n_features: int) -> None:
        super().__init__()
        require_shape("active", active, grid.shape)
        self.grid = grid
        rows = np.zeros(active.size, dtype=np.int32)
        n_active = int(np.count_nonzero(active))
        rows[active.ravel()] = np.arange(1, n_active + 1, dtype=np.int32)
        self.rows: Tensor
        self.register_buffer("rows", torch.from_numpy(rows))
        self.table = nn.Parameter(torch.zeros(n_active + 1, n_features))

    def forward(self, points: Tensor) -> Tensor:
        """Features at points (n, 3) [m], (n, n_features); outside points use the nearest rim.

        Differentiable with respect to the features only.
        """
        index, share = self._corners(points)
        out: Tensor = _Gather.apply(self.table, index, share)  # type: ignore[no-untyped-call]
        return out

    def copy_from(self, other: "FeatureGrid") -> None:
        """Copy the features of another grid at this one's nodes."""
        index = torch.stack(torch.unravel_index(torch.nonzero(self.rows)[:, 0], self.grid.shape), 1)
        points = torch.tensor(self.grid.origin_m) + self.grid.spacing_m * index
        with torch.no_grad():
            self.table[0] = other.table.mean(dim=0)
            self.table[1:] = other(points.to(other.table.dtype))

    def restore(self, rows: Tensor) -> None:
        """Set the rows of a stored grid, with an empty table to be loaded afterwards."""
        self.rows = rows
        self.table = nn.Parameter(torch.zeros(int(rows.max()) + 1, self.table.shape[1]))

    def _corners(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Rows (n, 8) and shares (n, 8) of the eight nodes around each point."""
        shape = torch.tensor(self.grid.shape)
        origin = torch.tensor(self.grid.origin_m, dtype=points.dtype)
        position = (points.detach() - origin) / self.grid.spacing_m
        position = torch.minimum(position.clamp(min=0.0), (shape - 1).to(position.dtype))
        low = torch.minimum(position.long(), (shape - 2).clamp(min=0))
        part = position - low
        _, ny, nz = self.grid.shape
        offsets = (_CORNERS[:, 0] * ny + _CORNERS[:, 1]) * nz + _CORNERS[:, 2]
        first = (low[:, 0] * ny + low[:, 1]) * nz + low[:, 2]
        index = self.rows[first[:, None] + offsets]
        pair = torch.stack([1.0 - part, part], dim=2)
        plane = (pair[:, 0, :, None] * pair[:, 1, None, :]).reshape(-1, 4, 1)
        return index, (plane * pair[:, 2, None, :]).reshape(-1, 8).to(self.table.dtype)


class _Gather(torch.autograd.Function):
    """Weighted sums of rows; the backward of torch's own embedding_bag takes twice as long."""

    @staticmethod
    def forward(ctx: Any, table: Tensor, index: Tensor, share: Tensor) -> Tensor:
        ctx.save_for_backward(index, share)
        ctx.shape = table.shape
        return torch.nn.functional.embedding_bag(index, table, per_sample_weights=share, mode="sum")

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        index, share = ctx.saved_tensors
        parts = (share[:, :, None] * grad[:, None]).reshape(-1, grad.shape[1])
        total = grad.new_zeros(ctx.shape).index_add_(0, index.reshape(-1), parts)
        return total, None, None  # index, share
