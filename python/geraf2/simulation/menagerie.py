"""Procedural stand-ins for the objects of the paper's table.

Bunny, elephant, deer, chicken, boat, ball: own shapes, after the names only; none copies a scanned
mesh. Units of about a centimetre, +x is forward.
"""

import itertools

import numpy as np

from geraf2.simulation.implicit import Figure, Solid, ball, blend, block, limb, turned


def bunny() -> Figure:
    """Sitting rabbit: round body, long ears back, a tail."""
    parts = [
        ball((-0.6, 0.0, 3.3), (3.3, 2.6, 3.2)),
        limb((1.2, 0.0, 4.6), (2.5, 0.0, 7.0), 1.9, 1.5),
        ball((2.9, 0.0, 7.6), (1.85, 1.5, 1.55)),
        ball((-3.9, 0.0, 2.2), (0.95, 0.95, 0.95)),
    ]
    for y in (-1.0, 1.0):
        parts += [
            limb((2.2, 0.6 * y, 8.8), (0.6, 1.1 * y, 12.6), 0.62, 0.42),
            ball((-1.0, 2.0 * y, 1.8), (2.1, 1.1, 1.7)),
            limb((-0.6, 2.0 * y, 0.55), (1.9, 1.9 * y, 0.5), 0.7, 0.5),
            limb((1.7, 1.0 * y, 3.6), (2.6, 0.9 * y, 0.5), 0.8, 0.5),
        ]
    return Figure(blend(parts, 0.6), (-5.2, -3.6, -0.6), (5.4, 3.6, 13.6))


def elephant() -> Figure:
    """Standing elephant: trunk down, ears spread, two tusks."""
    trunk = [(4.3, 7.2), (5.6, 6.0), (6.1, 4.2), (6.0, 2.6), (6.6, 1.6)]
    radii = (1.0, 0.8, 0.65, 0.55, 0.45)
    parts = [
        ball((-0.6, 0.0, 6.4), (3.9, 2.6, 2.8)),
        ball((3.3, 0.0, 8.2), (1.9, 1.7, 1.9)),
        limb((-4.3, 0.0, 6.6), (-4.9, 0.0, 3.8), 0.3, 0.25),
    ]
    for (a, b), (r, s) in zip(itertools.pairwise(trunk), itertools.pairwise(radii), strict=True):
        parts.append(limb((a[0], 0.0, a[1]), (b[0], 0.0, b[1]), r, s))
    for y in (-1.0, 1.0):
        parts += [
            ball((2.5, 2.6 * y, 8.4), (0.55, 1.7, 2.0)),
            limb((4.4, 0.9 * y, 6.9), (6.0, 1.3 * y, 5.6), 0.36, 0.22),
            limb((-2.7, 1.4 * y, 5.4), (-2.8, 1.5 * y, 0.7), 1.15, 0.95),
            limb((1.6, 1.4 * y, 5.4), (1.7, 1.5 * y, 0.7), 1.1, 0.95),
        ]
    return Figure(blend(parts, 0.5), (-5.8, -4.8, -0.6), (7.6, 4.8, 11.2))


def deer() -> Figure:
    """Standing deer: slender legs, head up, branched antlers."""
    parts = [
        limb((-2.6, 0.0, 6.2), (1.6, 0.0, 6.4), 1.45, 1.5),
        limb((2.0, 0.0, 6.9), (3.3, 0.0, 9.6), 1.05, 0.7),
        limb((3.3, 0.0, 9.9), (5.1, 0.0, 9.4), 0.8, 0.42),
        limb((-3.7, 0.0, 6.9), (-4.4, 0.0, 7.2), 0.4, 0.25),
    ]
    for y in (-1.0, 1.0):
        parts += [
            limb((3.0, 0.4 * y, 10.4), (2.3, 1.7 * y, 12.3), 0.34, 0.28),
            limb((2.3, 1.7 * y, 12.3), (3.1, 2.2 * y, 14.0), 0.28, 0.22),
            limb((2.5, 1.4 * y, 11.8), (4.0, 1.5 * y, 12.8), 0.26, 0.2),
            limb((2.9, 0.7 * y, 10.3), (2.5, 1.7 * y, 10.3), 0.32, 0.2),
            limb((-2.7, 0.8 * y, 5.6), (-3.2, 0.9 * y, 3.0), 0.75, 0.42),
            limb((-3.2, 0.9 * y, 3.0), (-2.8, 0.9 * y, 0.4), 0.42, 0.36),
            limb((1.7, 0.8 * y, 5.6), (1.8, 0.9 * y, 0.4), 0.62, 0.36),
        ]
    return Figure(blend(parts, 0.45), (-5.2, -2.9, -0.4), (6.0, 2.9, 14.8))


def chicken() -> Figure:
    """Hen on a foot plate: comb, beak, wattle, tail fan, wings."""
    parts = [
        ball((-0.4, 0.0, 5.2), (3.0, 2.2, 2.4)),
        limb((1.6, 0.0, 6.4), (2.6, 0.0, 9.0), 1.35, 0.95),
        ball((2.7, 0.0, 9.4), (1.15, 1.0, 1.1)),
        limb((3.6, 0.0, 9.3), (4.7, 0.0, 9.0), 0.4, 0.15),
        ball((3.5, 0.0, 8.2), (0.35, 0.3, 0.6)),
        ball((0.0, 0.0, 0.4), (2.6, 2.0, 0.45)),
    ]
    parts += [ball((2.0 + 0.6 * k, 0.0, 10.6), (0.42, 0.3, 0.75)) for k in range(3)]
    for lean in (-0.5, 0.0, 0.5):
        parts.append(limb((-2.6, 0.6 * lean, 6.0), (-4.6, 2.2 * lean, 8.9), 0.8, 0.45))
    for y in (-1.0, 1.0):
        parts += [
            ball((-0.7, 2.05 * y, 5.5), (1.9, 0.55, 1.3)),
            limb((0.0, 0.8 * y, 3.6), (0.2, 0.9 * y, 0.5), 0.45, 0.4),
        ]
    return Figure(blend(parts, 0.4), (-5.6, -3.0, -0.4), (5.4, 3.0, 11.8))


def toy_boat() -> Figure:
    """Toy boat: pointed hull, cabin, funnel, mast."""
    heights = np.linspace(0.6, 3.2, 12)
    hull: list[Solid] = [
        limb((-3.6 - 0.15 * z, 0.0, z), (2.0, 0.0, z), 1.2 + 0.35 * z, 1.0 + 0.3 * z)
        for z in heights
    ]
    hull += [
        limb((2.0, 0.0, z), (5.0 + 0.35 * z, 0.0, z + 0.3), 1.0 + 0.3 * z, 0.3) for z in heights
    ]
    keep_flat = block((0.6, 0.0, 2.2), (8.0, 3.2, 2.2), 0.2)

    def cut(points: np.ndarray) -> np.ndarray:
        return np.asarray(np.maximum(blend(hull, 0.3)(points), keep_flat(points)))

    above = [
        block((-1.2, 0.0, 5.4), (2.0, 1.4, 1.4), 0.3),
        limb((-2.0, 0.0, 6.6), (-2.0, 0.0, 8.8), 0.7, 0.7),
        limb((2.2, 0.0, 4.2), (2.2, 0.0, 10.0), 0.4, 0.3),
    ]
    return Figure(blend([cut, *above], 0.3), (-7.2, -3.6, -0.4), (7.6, 3.6, 10.8))


def hung_ball() -> Figure:
    """Christmas ball: a ball with a ribbed cap and a ring on top."""
    cap = np.array([[9.0, 1.5], [10.2, 1.3]])
    angle = np.linspace(0.0, 2.0 * np.pi, 25)
    places = [(0.75 * np.cos(a), 0.0, 11.4 + 0.75 * np.sin(a)) for a in angle]
    ring = [limb(start, end, 0.28, 0.28) for start, end in itertools.pairwise(places)]
    return Figure(
        blend([ball((0.0, 0.0, 4.8), (4.8, 4.8, 4.8)), turned(cap), *ring], 0.25),
        (-5.4, -5.4, -0.6),
        (5.4, 5.4, 13.0),
    )
