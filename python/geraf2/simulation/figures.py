"""Procedural objects: smooth unions of simple solids, meshed by marching cubes."""

from collections.abc import Callable

import numpy as np

from geraf2.io.mesh import TriangleMesh
from geraf2.simulation import menagerie, thin
from geraf2.simulation.implicit import (
    Figure,
    ball,
    blend,
    block,
    grid_points,
    limb,
    tube,
    turned,
    zero_level,
)


def _llama() -> Figure:
    legs = [
        part
        for x, lean in ((-2.4, -0.2), (2.3, 0.15))
        for y in (-1.05, 1.05)
        for part in (
            limb((x, y, 5.6), (x + lean, y, 0.45), 0.95, 0.5),
            limb((x + lean, y, 0.4), (x + lean + 0.45, y, 0.35), 0.5, 0.4),
        )
    ]
    ears = [limb((3.75, y, 12.0), (3.45, 1.55 * y, 13.35), 0.36, 0.17) for y in (-0.5, 0.5)]
    body = [
        ball((-0.2, 0.0, 6.4), (3.9, 1.95, 2.0)),
        limb((2.7, 0.0, 6.9), (3.9, 0.0, 11.2), 1.35, 0.85),
        limb((4.0, 0.0, 11.5), (5.7, 0.0, 11.05), 0.98, 0.55),
        limb((-3.8, 0.0, 7.4), (-4.75, 0.0, 8.3), 0.5, 0.3),
    ]
    return Figure(blend([*body, *legs, *ears], 0.7), (-5.6, -2.6, -0.6), (6.8, 2.6, 14.0))


def _jug() -> Figure:
    profile = np.array([[2.2, 2.2], [3.8, 2.9], [5.2, 2.6], [7.0, 1.6], [8.6, 1.3], [9.4, 1.6]])
    arc = np.linspace(-0.45 * np.pi, 0.5 * np.pi, 16)
    handle = np.stack([-1.8 - 2.6 * np.cos(arc), 0 * arc, 5.8 + 2.9 * np.sin(arc)], axis=1)
    spout = limb((2.2, 0.0, 4.2), (4.9, 0.0, 7.6), 0.9, 0.45)
    parts = [turned(profile), tube(handle, 0.45), spout]
    return Figure(blend(parts, 0.5), (-5.2, -3.2, -0.4), (5.7, 3.2, 11.5))


def _hammer() -> Figure:
    parts = [
        limb((0.0, 0.0, 0.6), (0.0, 0.0, 9.0), 0.65, 0.45),
        block((0.4, 0.0, 10.0), (1.5, 0.85, 0.85), 0.2),
        limb((2.0, 0.0, 10.0), (3.0, 0.0, 10.0), 1.05, 1.05),
        limb((-1.0, 0.0, 10.1), (-3.4, 0.0, 9.3), 0.8, 0.3),
    ]
    return Figure(blend(parts, 0.3), (-4.4, -1.8, -0.6), (4.7, 1.8, 11.8))


def _dog() -> Figure:
    parts = [
        limb((-1.6, 0.0, 2.2), (0.9, 0.0, 6.6), 2.2, 1.5),
        ball((1.4, 0.0, 9.0), (1.6, 1.45, 1.5)),
        limb((2.4, 0.0, 8.7), (3.7, 0.0, 8.4), 0.85, 0.6),
        limb((0.9, 0.0, 6.8), (1.3, 0.0, 8.4), 1.3, 1.2),
        limb((-3.2, 0.0, 1.2), (-5.2, 0.0, 2.2), 0.5, 0.3),
    ]
    for y in (-1.0, 1.0):
        parts += [
            limb((1.5, y, 5.6), (2.2, 1.05 * y, 0.5), 0.8, 0.55),
            limb((2.2, 1.05 * y, 0.45), (2.9, 1.05 * y, 0.4), 0.55, 0.42),
            ball((-1.3, 1.7 * y, 1.7), (1.7, 0.8, 1.6)),
            limb((-0.8, 1.9 * y, 0.5), (1.0, 1.9 * y, 0.45), 0.6, 0.45),
            limb((1.0, 1.25 * y, 9.7), (0.9, 1.7 * y, 8.0), 0.5, 0.4),
        ]
    return Figure(blend(parts, 0.5), (-6.0, -3.2, -0.5), (4.8, 3.2, 11.0))


def _knot() -> Figure:
    t = np.linspace(0.0, 2.0 * np.pi, 121)
    ring = 2.0 + np.cos(3.0 * t)
    path = 1.5 * np.stack([np.sin(3.0 * t), ring * np.cos(2.0 * t), ring * np.sin(2.0 * t)], 1)
    return Figure(tube(path, 0.8), (-2.8, -5.8, -5.8), (2.8, 5.8, 5.8))


def _chair() -> Figure:
    seat = block((0.0, 0.0, 5.0), (2.6, 2.6, 0.35), 0.15)
    parts = [seat, block((-2.3, 0.0, 8.4), (0.3, 2.5, 2.0), 0.15)]
    for y in (-2.2, 2.2):
        parts.append(limb((-2.25, y, 0.4), (-2.25, y, 7.0), 0.38, 0.38))
        parts.append(limb((2.25, y, 0.4), (2.2, y, 5.0), 0.38, 0.38))
    return Figure(blend(parts, 0.15), (-3.2, -3.2, -0.4), (3.2, 3.2, 11.0))


def _shoe() -> Figure:
    sole = block((0.0, 0.0, 0.5), (5.0, 1.7, 0.5), 0.15)
    heel = block((-3.2, 0.0, 3.0), (1.8, 1.6, 2.6), 0.4)
    toe = ball((1.6, 0.0, 1.4), (3.2, 1.65, 1.6))
    return Figure(blend([sole, heel, toe], 0.8), (-5.6, -2.3, -0.5), (5.6, 2.3, 6.5))


FIGURES: dict[str, Callable[[], Figure]] = {
    "llama": _llama,
    "jug": _jug,
    "hammer": _hammer,
    "dog": _dog,
    "knot": _knot,
    "chair": _chair,
    "shoe": _shoe,
    "bunny": menagerie.bunny,
    "elephant": menagerie.elephant,
    "deer": menagerie.deer,
    "chicken": menagerie.chicken,
    "boat": menagerie.toy_boat,
    "ball": menagerie.hung_ball,
    "slatted_chair": thin.slatted_chair,
    "spectacles": thin.spectacles,
    "key": thin.key,
    "mug": thin.mug,
    "scissors": thin.scissors,
}
"""Procedural objects by name; each builds its solid."""


def build_figure(name: str, n_vertical: int = 80) -> TriangleMesh:
    """Mesh of a procedural object, one unit high, standing on z = 0.

    name: a key of :data:`FIGURES`.
    n_vertical: Grid cells over the object's height.
    """
    figure = FIGURES[name]()
    low, high = np.asarray(figure.low), np.asarray(figure.high)
    step = float(high[2] - low[2]) / n_vertical
    mesh = zero_level(figure.solid(grid_points(low, high, step)), step)
    vertices = mesh.vertices - mesh.vertices.min(axis=0)
    return TriangleMesh(vertices=vertices / vertices[:, 2].max(), faces=mesh.faces)
