"""Matrix of a grid energy written difference by difference; dense, tiny grids only."""

import numpy as np


def matrix(shape, spacing, bending, sparse, diagonal):
    """A with f^T A f = bending * mean squared Hessian + f^T sparse f + sum diagonal f^2."""
    n = int(np.prod(shape))
    fields = np.eye(n).reshape(n, *shape)
    total = np.array(sparse, dtype=float) + np.diag(diagonal)
    for a in range(3):
        for b in range(a, 3):
            bent = np.diff(np.diff(fields, axis=a + 1), axis=b + 1) / (spacing[a] * spacing[b])
            rows = bent.reshape(n, -1)
            if rows.shape[1]:
                total += bending * (1.0 if a == b else 2.0) / rows.shape[1] * rows @ rows.T
    return total


def chebyshev(matrix, right, field, degree, low, high):
    """Steps of D^-1-weighted Richardson iteration at the roots of the Chebyshev polynomial."""
    scale = 1.0 / np.diag(matrix)
    k = np.arange(degree)
    roots = 0.5 * (high + low) + 0.5 * (high - low) * np.cos(np.pi * (k + 0.5) / degree)
    for root in roots:
        field = field + scale * (right - matrix @ field) / root
    return field
