"""Procedural objects: smooth unions of simple solids, meshed by marching cubes.

Most are tables of parts in the TOML files beside; those with curves or cuts are functions.
"""

import itertools
from collections.abc import Callable
from functools import partial
from importlib.resources import files
from typing import Any

import numpy as np

from geraf2._types import Floats
from geraf2.io.mesh import TriangleMesh
from geraf2.io.toml import read_table
from geraf2.simulation.implicit import (
    Figure,
    Solid,
    arc,
    ball,
    blend,
    block,
    grid_points,
    limb,
    revolve,
    ring,
    tube,
    zero_level,
)

# Of each kind of part: how many numbers each argument has, and which of them are coordinates y.
_PARTS: dict[str, tuple[Callable[..., Solid], tuple[int, ...], tuple[int, ...]]] = {
    "limb": (limb, (3, 3, 1, 1), (1, 4)),
    "ball": (ball, (3, 3), (1,)),
    "block": (block, (3, 3, 1), (1,)),
    "ring": (ring, (3, 2, 1), (1,)),
    "arc": (arc, (3, 2, 2, 1), (1,)),
}


def _part(row: str, side: float) -> Solid:
    kind, *words = row.split()
    numbers = np.array([float(word) for word in words])
    if kind == "lathe":
        return revolve(numbers.reshape(-1, 2))
    make, sizes, along_y = _PARTS[kind]
    numbers[list(along_y)] *= side
    arguments = np.split(numbers, np.cumsum(sizes)[:-1])
    return make(*(a if a.size > 1 else float(a[0]) for a in arguments))


def _figure_of_table(table: dict[str, Any]) -> Figure:
    parts: list[Solid] = []
    for entry in table["parts"]:
        rows, sides = (entry, (-1.0, 1.0)) if isinstance(entry, list) else ([entry], (1.0,))
        parts += [_part(row, side) for side in sides for row in rows]
    body, cuts = blend(parts, table["fillet"]), [_part(row, 1.0) for row in table.get("cuts", ())]

    def distance(points: Floats) -> Floats:
        return np.asarray(np.maximum.reduce([body(points), *(-cut(points) for cut in cuts)]))

    return Figure(distance, tuple(table["low"]), tuple(table["high"]))


def _jug() -> Figure:
    profile = np.array([[2.2, 2.2], [3.8, 2.9], [5.2, 2.6], [7.0, 1.6], [8.6, 1.3], [9.4, 1.6]])
    arc = np.linspace(-0.45 * np.pi, 0.5 * np.pi, 16)
    handle = np.stack([-1.8 - 2.6 * np.cos(arc), 0 * arc, 5.8 + 2.9 * np.sin(arc)], axis=1)
    spout = limb((2.2, 0.0, 4.2), (4.9, 0.0, 7.6), 0.9, 0.45)
    parts = [revolve(profile), tube(handle, 0.45), spout]
    return Figure(blend(parts, 0.5), (-5.2, -3.2, -0.4), (5.7, 3.2, 11.5))


def _knot() -> Figure:
    t = np.linspace(0.0, 2.0 * np.pi, 121)
    radius = 2.0 + np.cos(3.0 * t)
    path = 1.5 * np.stack([np.sin(3.0 * t), radius * np.cos(2.0 * t), radius * np.sin(2.0 * t)], 1)
    return Figure(tube(path, 0.8), (-2.8, -5.8, -5.8), (2.8, 5.8, 5.8))


def _boat() -> Figure:
    """Toy boat: pointed hull with a flat keel, cabin, funnel, mast."""
    heights = np.linspace(0.6, 3.2, 12)
    hull = [
        limb((-3.6 - 0.15 * z, 0.0, z), (2.0, 0.0, z), 1.2 + 0.35 * z, 1.0 + 0.3 * z)
        for z in heights
    ]
    hull += [
        limb((2.0, 0.0, z), (5.0 + 0.35 * z, 0.0, z + 0.3), 1.0 + 0.3 * z, 0.3) for z in heights
    ]
    body, flat = blend(hull, 0.3), block((0.6, 0.0, 2.2), (8.0, 3.2, 2.2), 0.2)
    parts = [
        lambda points: np.maximum(body(points), flat(points)),
        block((-1.2, 0.0, 5.4), (2.0, 1.4, 1.4), 0.3),
        limb((-2.0, 0.0, 6.6), (-2.0, 0.0, 8.8), 0.7, 0.7),
        limb((2.2, 0.0, 4.2), (2.2, 0.0, 10.0), 0.4, 0.3),
    ]
    return Figure(blend(parts, 0.3), (-7.2, -3.6, -0.4), (7.6, 3.6, 10.8))


def _hung_ball() -> Figure:
    """Christmas ball with a ribbed cap and a ring on top."""
    positions = [
        (0.75 * np.cos(a), 0.0, 11.4 + 0.75 * np.sin(a)) for a in np.linspace(0.0, 2.0 * np.pi, 25)
    ]
    parts = [ball((0.0, 0.0, 4.8), (4.8, 4.8, 4.8)), revolve(np.array([[9.0, 1.5], [10.2, 1.3]]))]
    parts += [limb(start, end, 0.28, 0.28) for start, end in itertools.pairwise(positions)]
    return Figure(blend(parts, 0.25), (-5.4, -5.4, -0.6), (5.4, 5.4, 13.0))


def _mug() -> Figure:
    """Empty mug with a thin wall and a handle."""
    outside = revolve(np.array([[0.9, 3.0], [1.0, 3.1], [7.2, 3.1], [7.3, 3.1]]))
    inside = revolve(np.array([[3.1, 2.8], [12.0, 2.8]]))
    arc = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 25)
    handle = np.stack([3.0 + 2.1 * np.cos(arc), 0.0 * arc, 4.4 + 2.2 * np.sin(arc)], axis=1)
    body = blend([outside, tube(handle, 0.38)], 0.25)

    def mug_distance(points: Floats) -> Floats:
        z = points[..., 2]  # cut off below 0 and above 8.4
        return np.asarray(np.maximum.reduce([body(points), z - 8.4, -z, -inside(points)]))

    return Figure(mug_distance, (-3.8, -3.8, -0.6), (6.0, 3.8, 9.0))


FIGURES: dict[str, Callable[[], Figure]] = {
    **{
        name: partial(_figure_of_table, table)
        for file in ("figures.toml", "ordinary.toml")
        for name, table in read_table(files("geraf2.simulation") / file).items()
    },
    "jug": _jug,
    "knot": _knot,
    "boat": _boat,
    "ball": _hung_ball,
    "mug": _mug,
}
"""Procedural objects by name; each builds its solid."""
_N_VERTICAL = 80  # grid cells over the height of an object


def build_figure(name: str) -> TriangleMesh:
    """Mesh of a procedural object of :data:`FIGURES`, one unit high, standing on z = 0."""
    figure = FIGURES[name]()
    low, high = np.asarray(figure.low), np.asarray(figure.high)
    step = float(high[2] - low[2]) / _N_VERTICAL
    mesh = zero_level(figure.solid(grid_points(low, high, step)), step)
    vertices = mesh.vertices - mesh.vertices.min(axis=0)
    return TriangleMesh(vertices=vertices / vertices[:, 2].max(), faces=mesh.faces)
