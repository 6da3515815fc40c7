"""Paths between antennas and a body in a box: through the near walls, and by far walls' images.

Each wall is a plate whose reflection and transmission are those of a plane wave in the direction
of the straight path: Airy's sums, TE and TM. A far wall shows images of the antennas. Scattering
between images and antennas holds the body's multipath via the wall and its shadow. A wall ends
as a plate of Kirchhoff's integral (Born and Wolf, Principles of Optics, 1999, 8.7).

Not held: the curvature of the wave in a wall, and paths over two far walls. What a wall returns to
the body is in `mirror`.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fresnel

from geraf2.scene import Wall

_MIN_MOMENT = 0.003  # moments below this share of the antenna's are left out


@dataclass(frozen=True, eq=False)
class Leg:
    """One path of all antennas: dipoles at their images, as seen through the walls."""

    positions: np.ndarray
    """(n, 3) [m]."""
    directions: np.ndarray
    """Moments by wavenumber, (n_k, n, 3), complex."""
    face: tuple[int, int] | None = None
    """Axis and side of the far wall of the path."""


def direct(antennas: np.ndarray, moment: np.ndarray, k: np.ndarray) -> Leg:
    """Path in free air."""
    return Leg(antennas, np.broadcast_to(moment.astype(complex), (len(k), *antennas.shape)))


def legs(antennas: np.ndarray, moment: np.ndarray, wall: Wall, k: np.ndarray) -> list[Leg]:
    """Direct path to the origin, inside the box, and one path over each far wall that shows it.

    antennas: outside, (n, 3) [m].
    moment: of all, (3,).
    """
    moments = direct(antennas, moment, k).directions
    found = [Leg(antennas, _through(antennas, np.zeros(3), moments, wall, k))]
    for axis, side in _faces():
        inner = side * (0.5 * wall.size_m[axis] - wall.thickness_m)
        is_far = side * antennas[:, axis] < abs(inner)
        if is_far.any():
            leg = _image(antennas, np.zeros(3), moments * is_far[:, None], wall, k, (axis, inner))
            if np.abs(leg.directions).max() > _MIN_MOMENT:
                found.append(replace(leg, face=(axis, side)))
    return found


def flashes(
    tx: np.ndarray, rx: np.ndarray, moment: np.ndarray, wall: Wall, k: np.ndarray
) -> np.ndarray:
    """Echo of the empty box, (n, n_k): near walls from outside, far walls from inside."""
    total = np.zeros((len(k), len(tx)), dtype=complex)
    moments = direct(tx, moment, k).directions
    for axis, side in _faces():
        outer = side * 0.5 * wall.size_m[axis]
        is_near = side * tx[:, axis] > abs(outer)
        for is_lit, at in ((is_near, outer), (~is_near, outer - side * wall.thickness_m)):
            if is_lit.any():
                lit = moments * is_lit[:, None]
                leg = _image(tx, rx, lit, wall, k, (axis, at))
                step = rx - leg.positions
                length = np.linalg.norm(step, axis=1)
                unit = step / length[:, None]
                across = moment - (unit @ moment)[:, None] * unit
                wave = np.exp(1j * np.outer(k, length)) / length
                total += (leg.directions * across).sum(-1) * wave
    return total.T


def _faces() -> Iterator[tuple[int, int]]:
    return ((axis, side) for axis in range(3) for side in (-1, 1))


def _image(
    antennas: np.ndarray,
    target: np.ndarray,
    moments: np.ndarray,
    wall: Wall,
    k: np.ndarray,
    face: tuple[int, float],
) -> Leg:
    """Antennas mirrored in a face; the target lies inside, or one outside for each antenna."""
    axis, at = face
    normal = np.eye(3)[axis]
    image = antennas - 2 * (antennas[:, axis, None] - at) * normal
    step = target - image
    # A path along the face meets it nowhere near the box.
    across = np.where(np.abs(step[:, axis]) < 1e-6, 1e-6, step[:, axis])
    meeting = image + ((at - image[:, axis]) / across)[:, None] * step
    found = _through(antennas, meeting, moments, wall, k)
    found = found - 2 * found[..., axis, None] * normal
    found = split(found, step, normal, plate(cosine_to(axis, step), wall, k)[0])
    found = found * _window(image, meeting, target, wall, axis, k)[..., None]
    if np.ndim(target) == 2:
        found = _through(target, meeting, found, wall, k)
    return Leg(image, found)


def _through(
    outside: np.ndarray, inside: np.ndarray, moments: np.ndarray, wall: Wall, k: np.ndarray
) -> np.ndarray:
    """Moments as seen through the near wall that the straight path between two points crosses."""
    step = inside - outside
    half = 0.5 * np.asarray(wall.size_m)
    with np.errstate(divide="ignore", invalid="ignore"):
        entries = (np.sign(outside) * half - outside) / step
    entries = np.where(np.abs(outside) > half, entries, -np.inf)
    axis, share = entries.argmax(axis=1), entries.max(axis=1)
    found = np.array(moments)
    for of_axis in range(3):
        rows = (axis == of_axis) & (share > 0) & (share < 1 - 1e-9)
        if rows.any():
            passed = plate(cosine_to(of_axis, step[rows]), wall, k)[1]
            found[:, rows] = split(found[:, rows], step[rows], np.eye(3)[of_axis], passed)
    return found


def split(
    moments: np.ndarray, step: np.ndarray, normal: np.ndarray, coefficients: list[np.ndarray]
) -> np.ndarray:
    """Moments whose TE and TM parts about a path are multiplied by a plate's coefficients."""
    unit = step / np.linalg.norm(step, axis=1, keepdims=True)
    # At normal incidence TE and TM are equal, and any axis across the path will do.
    te = np.cross(normal, unit) + 1e-12 * np.cross(np.roll(normal, 1), unit)
    te /= np.linalg.norm(te, axis=1, keepdims=True)
    tm = np.cross(te, unit)
    parts = [(moments * axis).sum(-1) for axis in (te, tm)]
    return sum(
        (coefficient * part)[..., None] * axis
        for coefficient, part, axis in zip(coefficients, parts, (te, tm), strict=True)
    )


def cosine_to(axis: int, step: np.ndarray) -> np.ndarray:
    return np.abs(step[:, axis]) / np.linalg.norm(step, axis=1)


def plate(
    cosine: np.ndarray, wall: Wall, k: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Reflection at the first face, and transmission over that of air; TE and TM, (n_k, n) each.

    TM is signed as a mirror image: -1 for metal, equal to TE at normal incidence.
    """
    inner = np.sqrt(wall.permittivity - 1 + cosine**2)
    turn = np.exp(1j * np.outer(k, wall.thickness_m * inner))
    air = np.exp(-1j * np.outer(k, wall.thickness_m * cosine))
    reflected, passed = [], []
    for r in (
        (cosine - inner) / (cosine + inner),
        (inner - wall.permittivity * cosine) / (inner + wall.permittivity * cosine),
    ):
        whole = 1 - r**2 * turn**2
        reflected.append(r * (1 - turn**2) / whole)
        passed.append((1 - r**2) * turn * air / whole)
    return reflected, passed


def _window(
    image: np.ndarray, meeting: np.ndarray, target: np.ndarray, wall: Wall, axis: int, k: np.ndarray
) -> np.ndarray:
    """Field by a wall's face over that by the whole plane, (n_k, n)."""
    before = np.maximum(np.linalg.norm(meeting - image, axis=1), 1e-6)
    after = np.maximum(np.linalg.norm(target - meeting, axis=1), 1e-6)
    unit = (meeting - image) / before[:, None]
    found = np.ones((len(k), len(image)), dtype=complex)
    for other in {0, 1, 2} - {axis}:
        bend = (1 / before + 1 / after) * (1 - unit[:, other] ** 2)
        scale = np.sqrt(np.outer(k, bend) / np.pi)
        half = 0.5 * wall.size_m[other]
        ends = [fresnel(scale * (end - meeting[:, other])) for end in (-half, half)]
        (sine_low, cosine_low), (sine_high, cosine_high) = ends
        found *= (cosine_high - cosine_low + 1j * (sine_high - sine_low)) / (1 + 1j)
    return found
