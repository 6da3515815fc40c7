"""Sines and cosines of coordinates."""

import math

import torch
from torch import Tensor


def encoded_size(n_octaves: int) -> int:
    """Length of the encoding of a point."""
    return 3 + 6 * n_octaves


def octave_weights(n_open: Tensor, n_octaves: int) -> Tensor:
    """Weights of octaves that open one after another -> (n_octaves,), each from 0 to 1.

    n_open: how many are open, without dimensions; of 2.5 the third is half open.

    A raised cosine an octave: Park et al., Nerfies, 2021, and Lin et al., BARF, 2021.
    """
    numbers = torch.arange(n_octaves, dtype=n_open.dtype, device=n_open.device)
    return 0.5 * (1.0 - torch.cos(math.pi * (n_open - numbers).clamp(0.0, 1.0)))


def positional_encoding(
    coordinates: Tensor, n_octaves: int, weights: Tensor | None = None
) -> Tensor:
    r"""Coordinates with sines and cosines of growing frequency.

    .. math:: \gamma(y) = (y, \sin(\pi 2^0 y), \cos(\pi 2^0 y), \ldots,
                           \sin(\pi 2^{L-1} y), \cos(\pi 2^{L-1} y))

    coordinates: (n, 3) in [-1, 1].
    n_octaves: L; 0 gives the coordinates alone.
    weights: (L,), factors of the waves of each octave; 1 when None.

    Returns (n, 3 + 6 L), first the coordinates. Differentiable.

    Equation 4 of Mildenhall et al., NeRF, 2020.
    """
    if n_octaves == 0:
        return coordinates
    scales = math.pi * 2.0 ** torch.arange(
        n_octaves, dtype=coordinates.dtype, device=coordinates.device
    )
    phases = coordinates[:, None, :] * scales[:, None]
    waves = torch.stack([torch.sin(phases), torch.cos(phases)], dim=2)
    if weights is not None:
        waves = waves * weights[:, None, None]
    return torch.cat([coordinates, waves.flatten(1)], dim=1)
