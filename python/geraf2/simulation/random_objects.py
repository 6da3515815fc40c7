"""Random objects of the population: one to three bodies, each a smooth union of simple parts."""

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from geraf2._types import Floats
from geraf2.geometry.components import face_labels
from geraf2.geometry.triangles import face_areas
from geraf2.io.mesh import TriangleMesh, merge_duplicate_vertices
from geraf2.simulation.implicit import (
    Solid,
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
from geraf2.simulation.population_settings import POPULATION, Population, Weights

RANDOM_NAME = re.compile(r"random-(\d{1,18})")
"""Name of a random object in a spec: `random-` and its seed."""
_CELLS = 90
"""Cells of the fine grid along a body."""
_CELL_M = (0.0007, 0.0014)
"""Least and largest cell [m]: half of the thinnest plate, with a margin, at the most."""
_COARSE_CELLS = 48
"""Cells of the grid that finds where a body lies."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RandomObject:
    """Bodies with what was drawn to make them."""

    mesh: TriangleMesh
    """Closed surface of all bodies, the middle of its bounding box at the origin [m]."""
    parts: tuple[tuple[str, ...], ...]
    """Kinds of parts of each body."""
    standing: bool
    """Whether the bodies stand on one floor."""
    permittivity: float
    """Relative permittivity; 0: metal."""
    loss_tangent: float
    """Loss tangent; 0: metal."""

    @property
    def extents_m(self) -> Floats:
        """Sides of the bounding box, (3,) [m]."""
        return np.asarray(np.ptp(self.mesh.vertices, axis=0))


@dataclass(frozen=True, kw_only=True)
class _Body:
    """Smooth union of parts, and a box that holds it."""

    solid: Solid
    low: Floats
    high: Floats
    kinds: tuple[str, ...]


def random_object(
    seed: int | np.random.Generator, population: Population = POPULATION
) -> RandomObject:
    """Random object of the population; the same seed gives the same bytes.

    seed: of all draws, or the generator that makes them.
    population: the distributions.

    >>> from geraf2.simulation.random_objects import random_object
    >>> thing = random_object(0)
    >>> bool(0.05 <= thing.extents_m.max() <= 0.18)  # [m]
    True
    """
    rng = np.random.default_rng(seed)
    n_bodies = int(choose(rng, population.bodies))
    size_m = rng.uniform(*population.size_m[n_bodies - 1])
    standing = bool(rng.random() < population.standing)
    is_plastic = rng.random() < population.plastic
    permittivity = rng.uniform(*population.permittivity)
    loss_tangent = rng.uniform(*population.loss_tangent)
    bodies, meshes = [], list[TriangleMesh]()
    for _ in range(n_bodies):
        share = rng.uniform(*population.body_share[n_bodies - 1])
        body = _sized_body(rng, population, share * size_m, upright=standing)
        bodies.append(body)
        meshes.append(_place(rng, population, _body_mesh(body), meshes, standing=standing))
    joined = TriangleMesh.joined(meshes)
    low, high = joined.vertices.min(axis=0), joined.vertices.max(axis=0)
    scale = size_m / float((high - low).max())
    vertices = (joined.vertices - 0.5 * (low + high)) * scale
    return RandomObject(
        mesh=TriangleMesh(vertices=vertices, faces=joined.faces),
        parts=tuple(body.kinds for body in bodies),
        standing=standing,
        permittivity=permittivity if is_plastic else 0.0,
        loss_tangent=loss_tangent if is_plastic else 0.0,
    )


def choose(rng: np.random.Generator, weights: Weights) -> str:
    """Draw one of the names."""
    names, shares = zip(*weights, strict=True)
    return str(names[int(rng.choice(len(names), p=shares))])


def _sized_body(
    rng: np.random.Generator, population: Population, size_m: float, *, upright: bool
) -> _Body:
    """Body of about one extent; the thickness of its plates and wires is drawn in metres."""
    # The same draws are made twice: at first to see how large the body becomes.
    state = rng.bit_generator.state
    first_m = size_m
    for _ in range(2):
        rng.bit_generator.state = state
        body = _body(rng, population, first_m, upright=upright)
        low, high = _extents(body)
        first_m *= size_m / float((high - low).max())
    return body


def _body(
    rng: np.random.Generator, population: Population, first_m: float, *, upright: bool
) -> _Body:
    """Smooth union of a first part, at the origin, and further ones on its surface."""
    fillet_m = first_m * rng.uniform(*population.fillet_share)
    turn = Rotation.random(rng=rng)
    if upright:
        turn = Rotation.from_euler("z", rng.uniform(0.0, 360.0), degrees=True)
    kinds = [choose(rng, population.first_part)]
    solids = [_move(_PARTS[kinds[0]](rng, population, first_m), turn, np.zeros(3))]
    low, high = np.full(3, -1.1 * first_m), np.full(3, 1.1 * first_m)
    for _ in range(int(rng.integers(*population.n_further_parts, endpoint=True))):
        position, normal = _surface_point(rng, blend(solids, fillet_m), low, high)
        part_m = first_m * rng.uniform(*population.further_share)
        turn = Rotation.random(rng=rng)
        if turn.apply([0.0, 0.0, 1.0]) @ normal < 0.0:  # most parts extend along +z
            turn = turn * Rotation.from_euler("x", np.pi)
        kinds.append(choose(rng, population.further_part))
        solids.append(_move(_PARTS[kinds[-1]](rng, population, part_m), turn, position))
        low = np.minimum(low, position - 1.1 * part_m)
        high = np.maximum(high, position + 1.1 * part_m)
    return _Body(solid=blend(solids, fillet_m), low=low, high=high, kinds=tuple(kinds))


def _move(solid: Solid, turn: Rotation, position: Floats) -> Solid:
    """Solid that is turned about its origin and then moved."""
    matrix = turn.as_matrix()
    return lambda points: solid((points - position) @ matrix)


def _surface_point(
    rng: np.random.Generator, solid: Solid, low: Floats, high: Floats
) -> tuple[Floats, Floats]:
    """Random point near the surface of a solid, and the outward normal there."""
    points = rng.uniform(low, high, (20000, 3))
    near = np.argsort(np.abs(solid(points)), kind="stable")[:20]
    point = points[near[int(rng.integers(len(near)))]][None]
    for _ in range(3):
        point, normal = _towards_surface(solid, point, np.inf)
    return point[0], normal[0]


def _towards_surface(solid: Solid, points: Floats, max_m: float) -> tuple[Floats, Floats]:
    """Newton step of points to the zero level, at most so long, and the unit normals, (n, 3)."""
    step = 1e-5 * np.eye(3)
    slope = np.stack([(solid(points + e) - solid(points - e)) / 2e-5 for e in step], axis=-1)
    length = np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-3)
    normals = slope / length
    move = np.clip(solid(points)[:, None] / length, -max_m, max_m)
    return points - move * normals, normals


# Parts: each holds its origin, and extends by at most its size from it.


def _capsule(rng: np.random.Generator, population: Population, size_m: float) -> Solid:
    start, end = 0.5 * size_m * rng.uniform(*population.width_share, 2)
    length = max(size_m - end, 0.2 * size_m)
    return limb((0.0, 0.0, 0.0), (0.0, 0.0, length), 0.8 * start, 0.8 * end)


def _ball(rng: np.random.Generator, population: Population, size_m: float) -> Solid:
    radii = 0.5 * size_m * rng.uniform(*population.side_share, 3)
    return ball((0.0, 0.0, 0.0), tuple(radii))


def _box(rng: np.random.Generator, population: Population, size_m: float) -> Solid:
    half = 0.5 * size_m * rng.uniform(*population.side_share, 3)
    rounding = half.min() * rng.uniform(*population.rounding_share)
    return block((0.0, 0.0, 0.0), tuple(half), rounding)


def _torus(rng: np.random.Generator, population: Population, size_m: float) -> Solid:
    radius = size_m * rng.uniform(*population.ring_share)
    long = 0.5 * size_m - radius
    radii = (long * rng.uniform(*population.flattening), long)
    return ring((0.0, 0.0, long), radii, radius)


def _lathe(rng: np.random.Generator, population: Population, size_m: float) -> Solid:
    heights = np.linspace(-0.4, 0.4, 5) * size_m
    radii = 0.5 * size_m * rng.uniform(*population.width_share, 5)
    fine = np.linspace(heights[0], heights[-1], 13)
    smooth = np.maximum(CubicSpline(heights, radii)(fine), 0.3 * radii.min())
    return revolve(np.stack([fine, np.minimum(smooth, 0.4 * size_m)], axis=1))


def _plate(rng: np.random.Generator, population: Population, size_m: float) -> Solid:
    thickness = rng.uniform(*population.thickness_m)
    width, height = 0.5 * size_m * rng.uniform(*population.side_share, 2)
    return block((0.0, 0.0, 0.0), (0.5 * thickness, width, height), 0.45 * thickness)


def _wire(rng: np.random.Generator, population: Population, size_m: float) -> Solid:
    radius = rng.uniform(*population.wire_radius_m)
    knots = rng.uniform(-0.45, 0.45, (5, 3)) * size_m
    knots[0] = 0.0
    curve = CubicSpline(np.arange(5.0), knots)(np.linspace(0.0, 4.0, 41))
    reach = np.linalg.norm(curve, axis=1).max()
    return tube(curve * min(1.0, size_m / reach), radius)


def _pipe(rng: np.random.Generator, population: Population, size_m: float) -> Solid:
    """Open round pipe, exact: a rounded rectangle turned about an axis."""
    half_wall = 0.5 * rng.uniform(*population.thickness_m)
    radius = 0.4 * size_m * rng.uniform(*population.width_share) + half_wall
    half = 0.4 * size_m * rng.uniform(*population.side_share)
    profile = block((0.0, 0.0, 0.0), (half_wall, half, 1.0), 0.9 * half_wall)

    def distance(points: Floats) -> Floats:
        around = np.hypot(points[..., 0] - radius, points[..., 1])
        return profile(np.stack([around - radius, points[..., 2], 0.0 * around], axis=-1))

    return distance


_PARTS: dict[str, Callable[[np.random.Generator, Population, float], Solid]] = {
    make.__name__[1:]: make
    for make in (_capsule, _ball, _box, _torus, _lathe, _plate, _wire, _pipe)
}


def _extents(body: _Body) -> tuple[Floats, Floats]:
    """Box about a body, at most a coarse cell too large on each side."""
    step = float((body.high - body.low).max()) / _COARSE_CELLS
    points = grid_points(body.low, body.high, step)
    inside = points[body.solid(points) < step]
    return inside.min(axis=0) - step, inside.max(axis=0) + step


def _body_mesh(body: _Body) -> TriangleMesh:
    """Largest closed piece of a body's surface; its vertices lie on the surface to a micrometre."""
    low, high = _extents(body)
    step = float(np.clip((high - low).max() / _CELLS, *_CELL_M))
    points = grid_points(low, high, step)
    mesh = zero_level(np.pad(body.solid(points), 1, constant_values=step), step)
    vertices = mesh.vertices + points[0, 0, 0] - step
    for _ in range(2):
        vertices, _ = _towards_surface(body.solid, vertices, 0.5 * step)
    mesh = merge_duplicate_vertices(TriangleMesh(vertices=vertices, faces=mesh.faces))
    labels, _ = face_labels(mesh.faces)
    largest = int(np.argmax(np.bincount(labels, weights=face_areas(mesh.corners))))
    return mesh.with_faces(mesh.faces[labels == largest])


def _place(
    rng: np.random.Generator,
    population: Population,
    mesh: TriangleMesh,
    others: list[TriangleMesh],
    *,
    standing: bool,
) -> TriangleMesh:
    """Body moved towards the others along a random line, up to a gap; standing: on z = 0."""
    gap_m = rng.uniform(*population.gap_m)
    angle, rise = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-0.5, 0.5)
    direction = np.array([np.cos(angle), np.sin(angle), 0.0 if standing else rise])
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    foot = 0.5 * (low + high)
    if standing:
        foot[2] = low[2]
    vertices = mesh.vertices - foot
    if others:
        rest = np.concatenate([other.vertices for other in others])
        center = 0.5 * (rest.min(axis=0) + rest.max(axis=0)) * ([1, 1, 0] if standing else [1] * 3)
        tree = KDTree(rest)
        reach = np.linalg.norm(rest - center, axis=1).max() + np.linalg.norm(vertices, axis=1).max()
        # From where they cannot meet; no step is longer than the free distance.
        along, moving = reach + gap_m, vertices[::3] + center
        while along > 0.0:
            free_m = float(tree.query(moving + along * direction)[0].min()) - gap_m
            if free_m <= 0.0:
                break
            along -= max(free_m, 0.0005)
        vertices = vertices + center + along * direction
    return TriangleMesh(vertices=vertices, faces=mesh.faces)
