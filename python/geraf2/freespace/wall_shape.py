"""Shape of a far wall from the phase of its flash: cardboard bulges by millimetres.

A bulged wall is a curved mirror. It tilts the ray of each antenna, and focuses or spreads the
return. Both follow from the excess path length (docs/math/free-space.md#silhouettes).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from geraf2._types import Floats

_DEGREE = 4
"""Degree of the polynomial of the path: for a bulge with fixed edges its error is 2 %."""
_ROUNDS = 6
_OFF_RAD = 0.3
"""Scale of the robust loss [rad]."""
_LOOSE_RAD = 3.0
"""Standard deviation of a coefficient [rad]: 3 mm are 10 rad, shared by several powers."""
_DARK = 0.3
"""Relative amplitude of a shadow; at its edge it is a half, or a quarter after two passes."""
_MIN_GAIN = 0.2
"""Lower bound of the squared gain; near a focus the model is invalid."""


class PathShape(NamedTuple):
    """Excess two-way path to a wall over that to a flat one, at the antennas."""

    length_m: Floats
    """Excess path of each antenna, (n,) [m]; its mean has no meaning."""
    slope: Floats
    """Gradient of the path along the wall, (n, 2)."""
    curvature_1_per_m: Floats
    """Hessian of the path along the wall, (n, 2, 2) [1/m]."""

    rms_m: float
    """RMS of the path over the bright antennas [m]."""

    def gain(self, wall_m: Floats) -> Floats:
        """Amplitude of the flash relative to a flat wall at this distance, (n,)."""
        mapping = np.eye(2) - 0.5 * wall_m[:, None, None] * self.curvature_1_per_m
        return np.asarray(np.sqrt(np.maximum(np.linalg.det(mapping), _MIN_GAIN)))


def path_shape(
    feet: Floats, response: NDArray[np.complex128], wavelength_m: float
) -> PathShape | None:
    """Fit the excess path of a wall's flash, whose shadows are dark or have any phase.

    Phase differences between neighbours, which do not wrap, give a first polynomial; the residual
    phase gives the rest. Both fits are robust, since the phase changes at the edges of shadows.

    feet: foot points of the antennas on the wall, (n, 2) [m].
    response: signal relative to a flat wall without shadow, without the wall's tilt, (n,).
    wavelength_m: at the centre of the chirp [m].

    Returns None if the antennas are too few or too far apart to follow the phase.
    """
    wavenumber = 2.0 * np.pi / wavelength_m
    middle = 0.5 * (feet.min(axis=0) + feet.max(axis=0))
    scale = np.abs(feet - middle).max()
    scaled = (feet - middle) / scale
    values, slopes, curvatures = _polynomials(scaled)
    tree = KDTree(feet)
    step = np.median(tree.query(feet, k=2)[0][:, 1])
    i, j = tree.query_pairs(1.5 * step, output_type="ndarray").T
    if len(i) < 4 * values.shape[1] or not response.any():
        return None
    # The phase of a shadow has no meaning.
    bright = np.quantile(np.abs(response), 0.9) or 1.0
    strength = np.minimum(np.abs(response) / bright, 1.0)
    strength[strength < _DARK] = 0.0
    difference = response[j] * response[i].conj()
    found = _robust(values[j] - values[i], -np.angle(difference), strength[i] * strength[j])
    ones = np.ones((len(feet), 1))
    for _ in range(_ROUNDS):
        residual = response * np.exp(1j * (values @ found))
        reference = (residual * strength).sum()
        phase = np.angle(residual * np.conj(reference))
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


def _polynomials(points: Floats) -> tuple[Floats, Floats, Floats]:
    """Powers up to `_DEGREE`, (n, m), their gradients, (n, 2, m), and Hessians, (n, 2, 2, m)."""
    powers = [(a, b) for a in range(_DEGREE + 1) for b in range(_DEGREE + 1 - a) if a + b > 0]
    x, y = ([at**power for power in range(_DEGREE + 1)] for at in points.T)

    def derivative(power: int, order: int, raised: list[Floats]) -> Floats:
        factor = np.prod([power - k for k in range(order)])
        return np.asarray(factor * raised[max(power - order, 0)])

    def term(a: int, b: int, order_a: int, order_b: int) -> Floats:
        return derivative(a, order_a, x) * derivative(b, order_b, y)

    def all_of(order_a: int, order_b: int) -> Floats:
        return np.stack([term(a, b, order_a, order_b) for a, b in powers], axis=-1)

    mixed = all_of(1, 1)
    curvatures = np.stack([all_of(2, 0), mixed, mixed, all_of(0, 2)], axis=1)
    return (
        all_of(0, 0),
        np.stack([all_of(1, 0), all_of(0, 1)], axis=1),
        curvatures.reshape(len(points), 2, 2, -1),
    )


def _robust(matrix: Floats, values: Floats, weights: Floats) -> Floats:
    """Robust least squares with Cauchy weights of scale `_OFF_RAD`.

    A weak prior holds coefficients near 0, for directions without data.
    """
    held = np.eye(matrix.shape[1]) * (_OFF_RAD / _LOOSE_RAD) ** 2
    used = weights
    for _ in range(_ROUNDS):
        weighted = matrix * used[:, None]
        found = np.linalg.solve(matrix.T @ weighted + held, weighted.T @ values)
        used = weights / (1.0 + ((values - matrix @ found) / _OFF_RAD) ** 2)
    return np.asarray(found)
