"""The signed-distance energy written row by row and minimised densely; slow, tiny grids only.

Lengths are centimetres throughout.
"""

from itertools import product

import numpy as np


def trilinear(values, index):
    """Value at a fractional index, from the eight corners."""
    cell = np.minimum(np.floor(index).astype(int), np.array(values.shape) - 2)
    t = index - cell
    return sum(
        np.prod([t[k] if side else 1.0 - t[k] for k, side in enumerate(corner)])
        * values[tuple(cell + corner)]
        for corner in product((0, 1), repeat=3)
    )


def _basis(shape):
    for number in range(np.prod(shape)):
        unit = np.zeros(np.prod(shape))
        unit[number] = 1.0
        yield unit.reshape(shape)


def _residuals(f, spacing, points, weights, terms):
    """All weighted linear forms of f, in a fixed order; the right sides are separate."""
    rows = []
    for p, w_p, w_n in zip(points, weights[0], weights[1], strict=True):
        rows.append(np.sqrt(terms.position * w_p) * trilinear(f, p))
        for axis in range(3):
            # A trilinear function is linear along each axis within its cell.
            low, high = p.copy(), p.copy()
            low[axis] = np.floor(p[axis])
            high[axis] = low[axis] + 1.0
            slope = (trilinear(f, high) - trilinear(f, low)) / spacing
            rows.append(np.sqrt(terms.normal * w_n) * slope)
    for a in range(3):
        for b in range(a, 3):
            bent = np.diff(np.diff(f, axis=a), axis=b) / spacing**2
            count = 1.0 if a == b else 2.0
            rows.extend(np.sqrt(terms.bending * count / bent.size) * bent.ravel())
    inner = np.zeros(f.shape, dtype=bool)
    inner[1:-1, 1:-1, 1:-1] = True
    faces = f[~inner]
    rows.extend(np.sqrt(terms.outside / faces.size) * faces)
    return np.array(rows)


def minimise(shape, spacing, points, normals, weights, terms):
    """Grid values (shape) [cm]; points in voxels, weights = (position, normal) that sum to 1."""
    matrix = np.stack(
        [_residuals(f, spacing, points, weights, terms) for f in _basis(shape)], axis=1
    )
    right = []
    for n, w_n in zip(normals, weights[1], strict=True):
        right.extend([0.0, *(np.sqrt(terms.normal * w_n) * n)])
    n_faces = np.prod(shape) - np.prod(np.array(shape) - 2)
    right.extend([0.0] * (len(matrix) - len(right) - n_faces))
    distance = 100.0 * terms.outside_distance_m
    right.extend([np.sqrt(terms.outside / n_faces) * distance] * n_faces)
    return np.linalg.lstsq(matrix, np.array(right), rcond=None)[0].reshape(shape)
