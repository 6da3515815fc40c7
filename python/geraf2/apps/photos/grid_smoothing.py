"""Smoothing and quick redistancing of values on a grid."""

import numpy as np
from scipy import ndimage
from torch import Tensor

from geraf2._types import Bools, Floats, Floats32

_NEAR_VOXELS = 2.5
"""Limit of the first-order distance, value over slope; beyond, voxel distances are used."""
_SMALLEST_SLOPE = 0.1
_SMALLEST_PART = 0.02
"""Least volume of a body over that of the largest one."""


def binomial_blur(values: Tensor, passes: int = 1) -> Tensor:
    """Filter (nx, ny, nz) by (1, 2, 1) / 4 along each axis; the rim repeats. Not differentiable."""
    for _ in range(passes):
        for axis in range(3):
            n = values.shape[axis]
            blurred = 0.5 * values
            blurred.narrow(axis, 1, n - 1).add_(values.narrow(axis, 0, n - 1), alpha=0.25)
            blurred.narrow(axis, 0, n - 1).add_(values.narrow(axis, 1, n - 1), alpha=0.25)
            for end in (0, n - 1):
                blurred.narrow(axis, end, 1).add_(values.narrow(axis, end, 1), alpha=0.25)
            values = blurred
    return values


def steps_to_outline(inside: Bools) -> Floats:
    """Signed distance of cells from the outline of a set, negative inside [cells]."""
    outward = ndimage.distance_transform_edt(~inside) - 0.5
    return np.asarray(np.where(inside, 0.5 - ndimage.distance_transform_edt(inside), outward))


def quick_redistance(values: Floats32, spacing_m: float) -> Floats32:
    """Signed distance with the same zero level, to first order near it.

    Within 2.5 voxels of the zero level f / |grad f|, which does not move it; farther out the
    distance between voxels, with an error of up to half a voxel.
    """
    slope = np.sqrt(sum(np.square(g) for g in np.gradient(values, spacing_m)))
    near = values / np.maximum(slope, _SMALLEST_SLOPE)
    inside = values < 0.0
    if inside.all() or not inside.any():
        return values
    far = spacing_m * steps_to_outline(inside)
    bound = _NEAR_VOXELS * spacing_m
    # the larger of the two beyond the bound, so that no second zero level appears
    keep = (np.abs(near) < bound) & (np.abs(far) < 2.0 * bound)
    return np.asarray(np.where(keep, near, far), dtype=np.float32)


def close_body(values: Floats32, spacing_m: float) -> Floats32:
    """Field whose inside is closed at the grid's rim, without small parts and hollows.

    Inside parts of less than 2 % of the largest one's volume become outside, and outside parts that
    the rim does not reach become inside: no photo shows either.
    """
    closed = values.copy()
    for axis in range(3):
        for end in (0, -1):
            rim = np.moveaxis(closed, axis, 0)[end]
            np.maximum(rim, 0.5 * spacing_m, out=rim)
    parts, _ = ndimage.label(closed < 0.0)
    volumes = np.bincount(parts.ravel())
    volumes[0] = 0
    crumbs = volumes < _SMALLEST_PART * volumes.max()
    crumbs[0] = False
    closed = np.where(crumbs[parts], np.abs(closed), closed)
    outside, _ = ndimage.label(closed >= 0.0)
    hollow = (outside > 0) & (outside != outside[0, 0, 0])
    return np.where(hollow, -np.abs(closed) - 1e-3 * spacing_m, closed).astype(np.float32)
