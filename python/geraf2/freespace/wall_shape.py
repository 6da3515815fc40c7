"""Shape of a far wall, from the phase of its flash: cardboard bulges by millimetres.

A bulged wall is a curved mirror: it turns the ray of each antenna, and gathers or spreads what it
sends back. All of it follows from how much longer the path is
(docs/math/free-space.md#silhouettes).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from geraf2._types import Floats

_DEGREE = 4
"""Of the polynomial that the path is: a bulge with its edges fixed is told to 2 % of it."""
_ROUNDS = 6
_OFF_RAD = 0.3
_LOOSE_RAD = 3.0
"""3 mm are 10 rad, shared out over several powers."""
_DARK = 0.3
"""Of the flash: at the edge of a shadow half of it is left, or a quarter."""
_LEAST_GAIN = 0.2
"""Least share of a flat wall's area that is gathered; nearer to a focus this does not hold."""


class PathShape(NamedTuple):
    """How much longer the path to a wall and back is than to a flat one, over the antennas."""

    length_m: Floats
    """At each antenna, (n,) [m]; its mean is meaningless."""
    slope: Floats
    """Change of it along the wall, (n, 2)."""
    curvature_1_per_m: Floats
    """Change of the slope, (n, 2, 2) [1/m]."""

    rms_m: float
    """Of it where the wall was seen: how far it is from flat, two ways [m]."""

    def gain(self, wall_m: Floats) -> Floats:
        """Amplitude of the flash over that of a flat wall at this distance, (n,)."""
        mapping = np.eye(2) - 0.5 * wall_m[:, None, None] * self.curvature_1_per_m
        return np.asarray(np.sqrt(np.maximum(np.linalg.det(mapping), _LEAST_GAIN)))


def path_shape(
    feet: Floats, response: NDArray[np.complex128], wavelength_m: float
) -> PathShape | None:
    """Fit the path of a wall's flash, whose shadows are dark or of any phase.

    Differences of phase between neighbours, which do not wrap, give a first polynomial; what is
    left of the phase itself the rest. Both fits are robust: at edges of shadows the phase is
    another.

    feet: antennas along the wall, (n, 2) [m].
    response: over that of a flat wall without shadow, (n,), any tilt of the wall taken off.
    wavelength_m: at the centre of the chirp [m].

    None where antennas are too few or too far apart to follow the phase.
    """
    wavenumber = 2.0 * np.pi / wavelength_m
    middle = 0.5 * (feet.min(axis=0) + feet.max(axis=0))
    scale = np.abs(feet - middle).max()
    places = (feet - middle) / scale
    values, slopes, curvatures = _polynomials(places)
    tree = KDTree(feet)
    step = np.median(tree.query(feet, k=2)[0][:, 1])
    i, j = tree.query_pairs(1.5 * step, output_type="ndarray").T
    if len(i) < 4 * values.shape[1] or not response.any():
        return None
    # In a shadow there is no phase to follow.
    bright = np.quantile(np.abs(response), 0.9) or 1.0
    strength = np.minimum(np.abs(response) / bright, 1.0)
    strength[strength < _DARK] = 0.0
    turned = response[j] * response[i].conj()
    found = _robust(values[j] - values[i], -np.angle(turned), strength[i] * strength[j])
    ones = np.ones((len(feet), 1))
    for _ in range(_ROUNDS):
        left = response * np.exp(1j * (values @ found))
        reference = (left * strength).sum()
        phase = np.angle(left * np.conj(reference))
        change = _robust(np.hstack([values, ones]), values @ found - phase, strength)
        found = change[:-1]
    length_m = values @ found / wavenumber
    mean_m = np.average(length_m, weights=strength)
    return PathShape(
        length_m=length_m,
        slope=slopes @ found / (wavenumber * scale),
        curvature_1_per_m=curvatures @ found / (wavenumber * scale**2),
        rms_m=float(np.sqrt(np.average((length_m - mean_m) ** 2, weights=strength))),
    )


def _polynomials(places: Floats) -> tuple[Floats, Floats, Floats]:
    """Powers up to `_DEGREE`, (n, m), their slopes, (n, 2, m), and curvatures, (n, 2, 2, m)."""
    powers = [(a, b) for a in range(_DEGREE + 1) for b in range(_DEGREE + 1 - a) if a + b > 0]

    def derivative(power: int, order: int, at: Floats) -> Floats:
        factor = np.prod([power - k for k in range(order)])
        return np.asarray(factor * at ** max(power - order, 0))

    def term(a: int, b: int, order_a: int, order_b: int) -> Floats:
        return derivative(a, order_a, places[:, 0]) * derivative(b, order_b, places[:, 1])

    def all_of(order_a: int, order_b: int) -> Floats:
        return np.stack([term(a, b, order_a, order_b) for a, b in powers], axis=-1)

    mixed = all_of(1, 1)
    curvatures = np.stack([all_of(2, 0), mixed, mixed, all_of(0, 2)], axis=1)
    return (
        all_of(0, 0),
        np.stack([all_of(1, 0), all_of(0, 1)], axis=1),
        curvatures.reshape(len(places), 2, 2, -1),
    )


def _robust(matrix: Floats, values: Floats, weights: Floats) -> Floats:
    """Least squares in which what is off by more than `_OFF_RAD` counts less and less (Cauchy).

    Coefficients are held to 0 as loosely as walls bulge, for where nothing is seen of them.
    """
    held = np.eye(matrix.shape[1]) * (_OFF_RAD / _LOOSE_RAD) ** 2
    used = weights
    for _ in range(_ROUNDS):
        weighted = matrix * used[:, None]
        found = np.linalg.solve(matrix.T @ weighted + held, weighted.T @ values)
        used = weights / (1.0 + ((values - matrix @ found) / _OFF_RAD) ** 2)
    return np.asarray(found)
