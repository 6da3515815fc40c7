"""Objects to train the completion with: creatures, vessels, containers, tools, furniture, machines.

Each is a smooth union of simple solids whose sizes are drawn. As in `geraf2.simulation.implicit`,
z is up and a unit is about a centimetre; `train_completion.py` gives every object its length.
"""

import numpy as np
import trimesh

from geraf2.geometry.triangles import enclosed_volume_m3
from geraf2.io.mesh import TriangleMesh
from geraf2.simulation.implicit import (
    Solid,
    arc,
    ball,
    blend,
    block,
    grid_points,
    limb,
    revolve,
    ring,
    zero_level,
)

# Grid on which solids become meshes: half of its side, and its step.
HALF_SIDE, STEP = 9.0, 0.21


def creature(rng: np.random.Generator) -> TriangleMesh:
    """Make a body on two or four legs with a head, and often with ears, a tail, or arms."""
    uniform = rng.uniform
    length, height, radius = uniform(2, 4), uniform(1.5, 4.5), uniform(0.8, 2.2)
    parts = [ball((0, 0, height), (length, radius, radius * uniform(0.8, 1.3)))]
    four = rng.choice([1, 2]) == 2
    for x in (-0.6 * length, 0.6 * length) if four else (uniform(-0.3, 0.3) * length,):
        parts += legs(rng, x, height, uniform(0.6, 0.95) * radius)
    head_x, head_z = length * uniform(0.8, 1.2), height + uniform(0.3, 4)
    head = np.array([head_x, 0, head_z])
    neck = (0.7 * length, 0, height + 0.3)
    parts.append(limb(neck, head, uniform(0.5, 1.3), uniform(0.4, 0.9)))
    size = uniform(0.6, 1.6)
    parts.append(ball((head_x + 0.3 * size, 0, head_z), (size * uniform(1, 1.5), size, size)))
    if rng.random() < 0.7:
        tip = (head_x + size * uniform(1.5, 2.5), 0, head_z - uniform(0, 0.6))
        parts.append(limb(head, tip, size * 0.5, size * 0.35))
    if rng.random() < 0.6:
        parts += ears(rng, head_x, head_z, size)
    if rng.random() < 0.7:
        thick = uniform(0.2, 0.6)
        tip = (-length - uniform(0.5, 3), 0, height + uniform(-1.5, 2.5))
        parts.append(limb((-0.9 * length, 0, height), tip, thick * 1.4, thick))
    if rng.random() < 0.35:
        for side in (-1, 1):
            shoulder = (uniform(0, 0.6) * length, side * radius * 0.8, height + 0.5)
            hand_x, hand_y = uniform(0, 0.9) * length, side * (radius + uniform(1, 3))
            hand = (hand_x, hand_y, height + uniform(-1, 2))
            parts.append(limb(shoulder, hand, uniform(0.3, 0.6), uniform(0.2, 0.4)))
    return mesh_of(parts, uniform(0.2, 0.6))


def legs(rng: np.random.Generator, x: float, height: float, aside: float) -> list[Solid]:
    """Make a pair of legs from hip to ground, with feet on most of them."""
    uniform, parts = rng.uniform, []
    thick, knee = uniform(0.25, 0.8), x + uniform(-0.6, 0.6)
    for y in (-aside, aside):
        knee_z = height * uniform(0.4, 0.6)
        parts.append(limb((x, y, height), (knee, y, knee_z), thick * 1.3, thick))
        ankle = (x + uniform(-0.3, 0.3), y, thick)
        parts.append(limb((knee, y, height * 0.5), ankle, thick, thick * 0.8))
        if rng.random() < 0.6:
            toe = (x + uniform(0.4, 1.2), y, thick * 0.7)
            parts.append(limb((x, y, thick * 0.8), toe, thick * 0.8, thick * 0.6))
    return parts


def ears(rng: np.random.Generator, x: float, z: float, size: float) -> list[Solid]:
    """Make a pair of ears, or horns, on a head of a size."""
    uniform, parts = rng.uniform, []
    thick = uniform(0.1, 0.4)
    for side in (-1, 1):
        tip_x, tip_y = x + uniform(-0.4, 0.2), side * size * uniform(0.6, 1.4)
        tip = (tip_x, tip_y, z + size * uniform(1, 2.4))
        parts.append(limb((x, side * size * 0.5, z + size * 0.6), tip, thick * 1.3, thick))
    return parts


def vessel(rng: np.random.Generator) -> TriangleMesh:
    """Make a solid of revolution; many have a handle, a spout, a knob, or a hollow."""
    uniform = rng.uniform
    height, n = uniform(4, 11), rng.integers(3, 6)
    heights = np.sort(np.concatenate([[0.2, height], uniform(0.3, height - 0.3, n - 2)]))
    radii = uniform(0.9, 3.6, n)
    if rng.random() < 0.5:
        radii = np.convolve(np.pad(radii, 1, mode="edge"), [0.25, 0.5, 0.25], mode="valid")
    parts, cuts = [revolve(np.stack([heights, radii], axis=1))], [block((0, 0, -5), (12, 12, 5))]
    widest = radii.max()
    if rng.random() < 0.5:
        center = (-widest * 0.85, 0, height * uniform(0.45, 0.6))
        handle = (uniform(1.2, 2.4), uniform(1.2, 0.42 * height))
        parts.append(arc(center, handle, (80, 280), uniform(0.25, 0.5)))
    if rng.random() < 0.4:
        bend = (widest + uniform(0.8, 1.8), 0, height * uniform(0.5, 0.8))
        root = (widest * 0.6, 0, height * 0.4)
        parts.append(limb(root, bend, uniform(0.5, 0.9), uniform(0.35, 0.6)))
        if rng.random() < 0.5:
            bend, mouth = (widest + 1.2, 0, height * 0.65), widest + uniform(1.8, 2.6)
            end = (mouth, 0, height * uniform(0.8, 1))
            parts.append(limb(bend, end, 0.5, uniform(0.3, 0.45)))
    if rng.random() < 0.4:
        knob = (radii[-1] * uniform(0.3, 0.8),) * 2
        parts.append(ball((0, 0, height + radii[-1] * 0.6), (*knob, uniform(0.4, 0.9))))
    if rng.random() < 0.5:
        cuts.append(block((0, 0, height + uniform(0, 1) + 6), (9, 9, 6)))
    if rng.random() < 0.4:
        hollow = np.array([height * uniform(0.3, 0.6), height + 3])
        wall = uniform(0.4, 0.8)
        inner = np.maximum(0.3, np.interp(hollow, heights, radii) - wall)
        cuts.append(revolve(np.stack([hollow, inner], axis=1)))
    return mesh_of(parts, uniform(0.15, 0.4), cuts)


def tool(rng: np.random.Generator) -> TriangleMesh:
    """Make a handle with a block, a blade, a fork, or an eye at its end, and often a grip."""
    uniform = rng.uniform
    length, radius = uniform(3, 6), uniform(0.35, 0.9)
    parts, end = [limb((0, 0, -length), (0, 0, length), radius * uniform(0.8, 1.3), radius)], length
    kind = rng.integers(4)
    if kind == 0:
        center, half = (uniform(-1, 1), 0, end), (uniform(1, 3), *uniform(0.5, 1.1, 2))
        parts.append(block(center, half, 0.15))
    elif kind == 1:
        parts.append(ball((0, 0, end), (uniform(0.8, 2.2), uniform(0.4, 1.5), uniform(0.8, 2.5))))
    elif kind == 2:
        for side in (1, -1):
            tip = (side * uniform(0.6, 2), 0, end)
            parts.append(limb((0, 0, end * 0.3), tip, radius * 0.8, radius * 0.6))
    else:
        parts.append(ring((0, 0, end), uniform(1, 2, 2), uniform(0.3, 0.6)))
    if rng.random() < 0.4:
        center = (0, 0, -length * uniform(0.4, 0.9))
        half = (uniform(0.5, 1.5), uniform(0.4, 1), uniform(0.4, 1.5))
        parts.append(block(center, half, 0.2))
    return mesh_of(parts, uniform(0.1, 0.4))


def container(rng: np.random.Generator) -> TriangleMesh:
    """Make a can, a carton, or a bottle: walls upright, ends flat, some with a step or a neck."""
    uniform, kind = rng.uniform, rng.integers(3)
    height, wide, deep = uniform(4, 14), uniform(1.5, 5), uniform(1.5, 5)
    low, high = -0.5 * height, 0.5 * height
    profile = [[low, wide], [high, wide]]
    if kind == 2:
        neck, shoulder = wide * uniform(0.25, 0.7), low + height * uniform(0.5, 0.85)
        slope = shoulder + uniform(0.2, 0.5) * (high - shoulder)
        profile = [[low, wide], [shoulder, wide], [slope, neck], [high, neck]]
    walls = revolve(np.array(profile))
    parts: list[Solid] = [lambda at: np.maximum(walls(at), np.abs(at[..., 2]) - high)]
    if kind == 1:
        parts = [block((0, 0, 0), (wide, deep, high), uniform(0, 0.4))]
    if kind < 2 and rng.random() < 0.4:
        side, rise = wide * uniform(0.3, 0.8), uniform(0.4, 2)
        parts.append(block((0, 0, high + 0.5 * rise), (side, side, rise), 0.1))
    return mesh_of(parts, uniform(0.05, 0.3))


def furniture(rng: np.random.Generator) -> TriangleMesh:
    """Make a square or round top on three or four legs, often with a back."""
    uniform = rng.uniform
    long, wide, height, thick = uniform(2, 4.5), uniform(2, 4), uniform(2, 7), uniform(0.2, 0.6)
    square = rng.random() < 0.6
    top = block((0, 0, height), (long, wide, thick), 0.12)
    parts = [top if square else ball((0, 0, height), (long, long, thick * 1.4))]
    radius, n = uniform(0.25, 0.6), rng.choice([3, 4])
    for number in range(n):
        turn = 2 * np.pi * (number + 0.5) / n
        x = np.cos(turn) * long * 0.85
        y = np.sin(turn) * (wide if n == 4 else long) * 0.85
        splay = uniform(1, 1.2)
        foot = (x * splay, y * splay, radius)
        parts.append(limb((x, y, height), foot, radius, radius * uniform(0.7, 1)))
    if rng.random() < 0.4:
        center = (-long * 0.85, 0, height + uniform(1.5, 3))
        parts.append(block(center, (thick, wide * 0.9, uniform(1.5, 3)), 0.12))
    return mesh_of(parts, uniform(0.1, 0.3))


def mechanical(rng: np.random.Generator) -> TriangleMesh:
    """Make a block with one to three blocks, balls or rods on it, half of them with a bore."""
    uniform = rng.uniform
    parts, cuts = [block((0, 0, 0), uniform(0.8, 3, 3), uniform(0, 0.4))], []
    for _ in range(rng.integers(1, 4)):
        at = uniform(-2, 2, 3)
        shapes = (
            block(at, uniform(0.5, 2, 3), uniform(0, 0.3)),
            ball(at, uniform(0.6, 2, 3)),
            limb(at, at + uniform(-3, 3, 3), uniform(0.4, 1.2), uniform(0.4, 1.2)),
        )
        parts.append(shapes[rng.integers(3)])
    if rng.random() < 0.5:
        at, along = uniform(-1, 1, 3), rng.standard_normal(3)
        along /= np.linalg.norm(along)
        radius = uniform(0.4, 1)
        cuts.append(limb(at - 8 * along, at + 8 * along, radius, radius))
    return mesh_of(parts, uniform(0.1, 0.3), cuts)


MAKERS = {f.__name__: f for f in (creature, vessel, container, tool, furniture, mechanical)}


def mesh_of(parts: list[Solid], fillet: float, cuts: list[Solid] | None = None) -> TriangleMesh:
    """Blend solids with fillets, cut others off, and keep the largest piece of the surface."""
    corner = np.full(3, HALF_SIDE)
    points = grid_points(-corner, corner, STEP)
    distances = blend(parts, fillet)(points)
    for cut in cuts or ():
        distances = np.maximum(distances, -cut(points))
    mesh = zero_level(distances, STEP)
    pieces = trimesh.Trimesh(mesh.vertices, mesh.faces).split(only_watertight=False)
    piece = max(pieces, key=lambda piece: len(piece.faces))
    vertices, faces = np.asarray(piece.vertices), np.asarray(piece.faces, np.int64)
    if enclosed_volume_m3(vertices, faces) < 0.0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    return TriangleMesh(vertices=vertices, faces=faces)
