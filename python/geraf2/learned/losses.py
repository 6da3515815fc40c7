"""The three terms of equations 13 and 16 of the paper."""

import torch
from torch import Tensor

from geraf2.ops.lensless import length_defect


def charbonnier(difference: Tensor, width: float) -> Tensor:
    """Mean of sqrt(d^2 + width^2) - width: quadratic near zero, linear beyond `width`."""
    return (torch.sqrt(difference.square() + width * width) - width).mean()


def heatmap_loss(rendered: Tensor, measured: Tensor, scale: float, width: float) -> Tensor:
    """L_MF: Charbonnier of the difference of two heat maps (n_targets,), in units of `scale`."""
    return charbonnier((rendered - measured) / scale, width)


def eikonal_loss(gradient: Tensor) -> Tensor:
    """L_GRAD: mean of (|grad f| - 1)^2 over samples (n, 3). Gropp et al. 2020, equation 2."""
    return length_defect(gradient)


def depth_loss(radar: Tensor, vision: Tensor) -> Tensor:
    """L_RSDF: mean |d_v - d_r| of expected depths along primary rays (n_rays,) [m].

    Equations 14 and 15 of the paper, with d = integral of u rho T du as it stands there.
    """
    return (vision - radar).abs().mean()
