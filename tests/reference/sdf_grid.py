"""Grid interpolation straight from its equation, in torch; slow."""

import itertools


def weights(r, interpolation):
    """[(tap, weight)] for the position r between tap 0 and tap 1."""
    if interpolation == "linear":
        return [(0, 1 - r), (1, r)]
    return [
        (-1, (-r + 2 * r**2 - r**3) / 2),
        (0, (2 - 5 * r**2 + 3 * r**3) / 2),
        (1, (r + 4 * r**2 - 3 * r**3) / 2),
        (2, (-(r**2) + r**3) / 2),
    ]


def sdf_grid(values, grid, points, interpolation):
    """Value at points (n, 3); its gradient is left to autograd."""
    taps = []
    for axis, length in enumerate(values.shape):
        position = (points[:, axis] - grid.origin_m[axis]) / grid.spacing_m
        position = position.clamp(0, length - 1)
        cell = position.detach().floor().clamp(0, max(length - 2, 0))
        taps.append(
            [
                ((cell.long() + tap).clamp(0, length - 1), weight)
                for tap, weight in weights(position - cell, interpolation)
            ]
        )
    total = 0.0
    for (i, a), (j, b), (k, c) in itertools.product(*taps):
        total = total + a * b * c * values[i, j, k]
    return total
