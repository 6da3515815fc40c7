"""Opacity, transmittance and weight of samples along rays through a signed distance."""

from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

import numpy as np

from geraf2 import _core  # noqa: TID251 - ops is the package that wraps the native module
from geraf2.ops._geometry import any_tensor, require_samples
from geraf2.ops._threads import resolve_num_threads

if TYPE_CHECKING:
    import torch

    from geraf2._types import Array

TwoWay = Literal["unbiased", "squared", "none"]


class RayMarch(NamedTuple):
    """Result of a ray march; tensors if any argument was a tensor, else arrays."""

    alpha: "Array | torch.Tensor"
    """Opacity of each interval, (n_rays, n_samples)."""
    transmittance: "Array | torch.Tensor"
    """Transmittance before each interval, as it enters the weight, (n_rays, n_samples)."""
    weight: "Array | torch.Tensor"
    """transmittance * alpha, (n_rays, n_samples)."""
    depth: "Array | torch.Tensor"
    """Sum of weight times the distance of mid-interval from the ray's start, (n_rays,) [m]."""


def ray_march(
    sdf: Any,
    cos: Any,
    step: Any,
    inv_s: Any,
    *,
    two_way: TwoWay = "unbiased",
    num_threads: int | None = None,
) -> RayMarch:
    r"""Volume-rendering weights of a signed distance along rays.

    .. math:: \alpha_i = \max\left(0, 1 - \frac{\Phi(f_i + c_i \delta_i / 2)}
                              {\Phi(f_i - c_i \delta_i / 2)}\right), \quad
              T_i = \prod_{j < i} (1 - \alpha_j), \quad
              \Phi(x) = \frac{1}{1 + e^{-s x}}

    Each sample represents an interval of length `step` about it: the opacity belongs to
    mid-interval. Without a surface left behind, T telescopes to Phi.

    sdf: signed distance f at mid-interval, (n_rays, n_samples) [m], float32 or float64.
    cos: its derivative c along the ray, (n_rays, n_samples); where it is positive, the ray leaves a
        surface and the opacity is zero.
    step: length delta of the contiguous intervals, (n_rays, n_samples) [m]. Not differentiable.
    inv_s: sharpness s of Phi [1/m], positive; a number or a tensor of one element.
    two_way: "unbiased": T is the transmittance of the two-way path, weight = T alpha. It
        peaks at the zero level. "squared": T is the one-way one, weight = T^2 alpha, equation 4 of
        the paper. It peaks at f = ln 2 / s, in front of the surface. "none": one-way, for
        photos; the same numbers as "unbiased", with the one-way T.

    Returns RayMarch of alpha, transmittance (T, or T^2 for "squared"), weight and depth.

    Differentiable once with respect to sdf, cos and inv_s. A NaN spreads to what lies behind it on
    its ray. The opacity is that of NeuS (Wang et al. 2021, equation 13), in a form without
    cancellation or overflow: docs/math/ray-march-and-lensless.md#ray-march.
    """
    if two_way not in get_args(TwoWay):
        msg = f"two_way must be one of {', '.join(map(repr, get_args(TwoWay)))}, got {two_way!r}"
        raise ValueError(msg)
    power = 2 if two_way == "squared" else 1
    threads = resolve_num_threads(num_threads)
    if any_tensor(sdf, cos, step, inv_s):
        from geraf2.ops._ray_march_torch import ray_march_tensor  # noqa: PLC0415 - torch

        return RayMarch(*ray_march_tensor(sdf, cos, step, inv_s, power, threads))
    f, c, delta = (np.ascontiguousarray(v) for v in (sdf, cos, step))
    require_samples(f, c, delta, inv_s)
    return RayMarch(*_core.ray_march_fwd(f, c, delta, float(inv_s), power, threads))
