"""Dielectric plates: reflection, transmission, and excess path of rays that cross them."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Bools, Floats, Ints
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.scene import Wall


def phasors(paths_m: Floats, frequencies_hz: Floats) -> NDArray[np.complex64]:
    """exp(-j 2 pi f d / c) at equidistant frequencies, (n_frequencies, *paths.shape).

    Whole turns are dropped in float64; a step from one frequency to the next costs a product.
    """
    start = frequencies_hz[0] / SPEED_OF_LIGHT_M_PER_S
    step = (frequencies_hz[-1] - frequencies_hz[0]) / max(len(frequencies_hz) - 1, 1)
    found = np.empty((len(frequencies_hz), *paths_m.shape), dtype=np.complex64)
    found[0] = _turn(paths_m * start)
    factor = _turn(paths_m * (step / SPEED_OF_LIGHT_M_PER_S))
    for number in range(1, len(frequencies_hz)):
        np.multiply(found[number - 1], factor, out=found[number])
    return found


def _turn(turns: Floats) -> NDArray[np.complex64]:
    angle = ((np.rint(turns) - turns) * (2.0 * np.pi)).astype(np.float32)
    found = np.empty(turns.shape, dtype=np.complex64)
    np.cos(angle, out=found.real)
    np.sin(angle, out=found.imag)
    return found


def face_reflection(cosine: Floats, permittivity: float) -> Floats:
    """Fresnel's reflection coefficient of one face from outside, TE: (c - q) / (c + q).

    cosine: of the angle of incidence, c; q = sqrt(permittivity - 1 + c^2).
    """
    inner = np.sqrt(permittivity - 1.0 + cosine**2)
    return np.asarray((cosine - inner) / (cosine + inner))


def slab_reflection(
    cosine: Floats,
    slab: Wall,
    frequencies_hz: Floats,
    *,
    crossing: float = 1.0,
) -> NDArray[np.complex64]:
    """Reflection coefficient of a plate at the face that is met first, TE, (n, n_frequencies).

    r (1 - (1 - r^2) E), E = a^2 exp(-2 j k t q): both faces once.

    cosine: of the angle of incidence, (n,).
    frequencies_hz: equidistant.
    crossing: amplitude factor of one crossing of the plate, a.
    """
    r = face_reflection(cosine, slab.permittivity).astype(np.float32)[:, None]
    inner = np.sqrt(slab.permittivity - 1.0 + cosine**2)
    turn = phasors(2.0 * slab.thickness_m * inner, frequencies_hz).T * np.float32(crossing**2)
    return np.asarray(r * (1.0 - (1.0 - r**2) * turn))


def cross_walls(
    points: Floats, end: Floats, walls: Sequence[Wall], amplitude: float = 1.0
) -> tuple[Floats, Floats]:
    """Effect of walls on a wave along the straight path between points and one position.

    points: (n_points, 3) [m].
    end: (3,) [m].
    walls: closed shells; a path may cross each once or twice.
    amplitude: factor of one crossing, beside the reflection of the wall's faces.

    Returns transmission, (n_points,), and excess path, (n_points,) [m], of the one-way path.
    """
    transmission, excess_m = np.ones(len(points)), np.zeros(len(points))
    for wall, met, cosine in _crossings(points, end, walls):
        passed, longer_m = cross_plate(cosine, wall)
        transmission *= np.where(met, amplitude * passed, 1.0)
        excess_m += np.where(met, longer_m, 0.0)
    return transmission, excess_m


def cross_plate(cosine: Floats, plate: Wall) -> tuple[Floats, Floats]:
    """Amplitude that both faces of a plate let pass, TE, and excess path [m], (n,) each.

    cosine: of the angle of incidence, (n,).
    """
    inner = np.sqrt(plate.permittivity - 1.0 + cosine**2)
    r = face_reflection(cosine, plate.permittivity)
    return 1.0 - r**2, plate.thickness_m * (inner - cosine)


def n_crossings(starts: Floats, points: Floats, walls: Sequence[Wall]) -> Ints:
    """Count the walls that each straight leg crosses, (n_starts, n_points).

    starts: outside of all boxes, (n_starts, 3) [m].
    points: in the air outside, between or inside the boxes, (n_points, 3) [m].
    walls: the boxes.
    """
    counts = np.zeros((len(starts), len(points)), dtype=np.int64)
    for number, start in enumerate(starts):
        for _, met, _ in _crossings(points, start, walls):
            counts[number] += met
    return counts


def _crossings(
    points: Floats, end: Floats, walls: Sequence[Wall]
) -> Iterator[tuple[Wall, Bools, Floats]]:
    """Yield each wall twice: where paths enter and leave it between points and end, and cosines."""
    leg = np.ascontiguousarray((end - points).T)  # axis by axis: reductions are three times as fast
    length = np.sqrt((leg**2).sum(axis=0))
    for wall in walls:
        half = 0.5 * np.asarray(wall.size_m)[:, None]
        start = points.T - np.asarray(wall.center_m)[:, None]
        # A leg along a side divides by zero: its bounds are then infinite, as they should be.
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = (-half - start) / leg, (half - start) / leg
        near, far = np.fmin(*ends), np.fmax(*ends)
        enters, leaves = near.max(axis=0), far.min(axis=0)
        for share, axis in ((enters, near.argmax(axis=0)), (leaves, far.argmin(axis=0))):
            met = (enters < leaves) & (share > 0.0) & (share < 1.0)
            yield wall, met, np.abs(np.take_along_axis(leg, axis[None], 0)[0]) / length
