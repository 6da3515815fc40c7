"""Sines and cosines of coordinates."""

import math

import torch
from torch import Tensor


def encoded_size(n_octaves: int) -> int:
    """Length of the encoding of a point."""
    return 3 + 6 * n_octaves


def positional_encoding(coordinates: Tensor, n_octaves: int) -> Tensor:
    r"""Coordinates with sines and cosines of growing frequency.

    .. math:: \gamma(y) = (y, \sin(\pi 2^0 y), \cos(\pi 2^0 y), \ldots,
                           \sin(\pi 2^{L-1} y), \cos(\pi 2^{L-1} y))

    coordinates: (n, 3) in [-1, 1].
    n_octaves: L; 0 gives the coordinates alone.

    Returns (n, 3 + 6 L), first the coordinates. Differentiable.

    Notes
    -----
    Equation 4 of Mildenhall et al., NeRF, 2020.
    """
    if n_octaves == 0:
        return coordinates
    scales = math.pi * 2.0 ** torch.arange(
        n_octaves, dtype=coordinates.dtype, device=coordinates.device
    )
    phases = coordinates[:, None, :] * scales[:, None]
    waves = torch.stack([torch.sin(phases), torch.cos(phases)], dim=2)
    return torch.cat([coordinates, waves.flatten(1)], dim=1)
