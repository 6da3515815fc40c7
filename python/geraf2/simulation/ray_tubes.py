"""Tubes of rays at a figure: reflected once more on it, or refracted to its back face.

Each tube is one ray from the middle of a block of antennas with its derivatives across (Igehy,
Tracing ray differentials, 1999), so that its footprint at the last hit needs no second ray.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Bools, Floats, Ints
from geraf2.geometry.triangles import barycentric, face_vectors, unit_normals
from geraf2.ops.physical_optics import AntennaBlocks
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Wall, Waveform
from geraf2.simulation.dielectric import face_reflection, phasors, walls_crossed
from geraf2.simulation.walls import n_crossings

_CREASE_COSINE = float(np.cos(np.deg2rad(30.0)))
"""Faces that meet at a flatter angle than this are one smooth surface."""
_LIFT_M = 2e-5  # rays leave a surface this far from it
_PAIRS_PER_STEP = 30_000  # antennas times tubes at once: their phasors are 8 MB at 32 samples


class Hits(NamedTuple):
    """Where rays meet the figure, with derivatives to two directions across the rays."""

    points: Floats
    """(n, 3) [m]."""
    across: Floats
    """Derivatives of the points on the surface, (n, 2, 3)."""
    normals: Floats
    """Outward unit normals of the smooth surface, (n, 3)."""
    turns: Floats
    """Derivatives of the normals, (n, 2, 3)."""
    path_m: Floats
    """Length of the ray, (n,) [m]."""
    rays: Ints
    """Which rays met it, (n,)."""


class SmoothMesh:
    """Figure under a ray tracer, whose normals vary over faces between its creases.

    blocker: the figure.
    """

    def __init__(self, blocker: MeshScene) -> None:
        self.blocker = blocker
        self._corners = blocker.vertices[blocker.faces]
        self._normals = corner_normals(blocker.vertices, blocker.faces)

    def meet(self, starts: Floats, ways: Floats, spread: Floats, turning: Floats) -> Hits:
        """First hits of rays.

        starts: (n, 3) [m].
        ways: unit vectors, (n, 3).
        spread: derivatives of the starts, (n, 2, 3).
        turning: derivatives of the ways, (n, 2, 3).
        """
        path_m, faces = self.blocker.closest_hit(starts, ways)
        rays = np.flatnonzero(faces >= 0)
        path_m, faces, way = path_m[rays], faces[rays], ways[rays]
        points = starts[rays] + path_m[:, None] * way
        corners, own = self._corners[faces], self._normals[faces]
        weights = barycentric(points, corners)
        summed = np.einsum("nk,nki->ni", weights, own)
        length = np.linalg.norm(summed, axis=1)
        normals = summed / length[:, None]
        moved = spread[rays] + path_m[:, None, None] * turning[rays]
        slant = np.einsum("ni,ni->n", way, normals)
        slant = np.where(np.abs(slant) > 1e-6, slant, np.inf)  # along the surface: no footprint
        longer = np.einsum("nci,ni->nc", moved, normals) / slant[:, None]
        across = moved - longer[..., None] * way[:, None]
        turns = np.stack([_slopes(across[:, c], corners, own) for c in range(2)], axis=1)
        turns -= np.einsum("nci,ni->nc", turns, normals)[..., None] * normals[:, None]
        turns /= length[:, None, None]
        return Hits(points, across, normals, turns, path_m, rays)


def corner_normals(vertices: Floats, faces: Ints) -> Floats:
    """Give each face unit normals at its corners, (n_faces, 3, 3).

    Area-weighted means over the faces about the corner's vertex that meet the face without crease.
    """
    corners = vertices[faces]
    vectors, units = face_vectors(corners), unit_normals(corners)
    order = np.argsort(faces.ravel(), kind="stable")
    sizes = np.bincount(faces.ravel(), minlength=len(vertices))
    starts = np.cumsum(sizes) - sizes
    of_corner = sizes[faces.ravel()]
    # Every corner with every face about its vertex.
    own = np.repeat(np.arange(faces.size), of_corner)
    number = np.arange(len(own)) - np.repeat(np.cumsum(of_corner) - of_corner, of_corner)
    other = order[starts[faces.ravel()][own] + number] // 3
    smooth = np.einsum("pi,pi->p", units[own // 3], units[other]) > _CREASE_COSINE
    summed = np.zeros((faces.size, 3))
    np.add.at(summed, own[smooth], vectors[other[smooth]])
    length = np.linalg.norm(summed, axis=1, keepdims=True)
    flat = np.repeat(units, 3, axis=0)
    return np.where(length > 0, summed / np.maximum(length, 1e-300), flat).reshape(-1, 3, 3)


def _slopes(moved: Floats, corners: Floats, values: Floats) -> Floats:
    """Change of what is linear on triangles, (n, 3, 3), with a step along them, (n, 3)."""
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    a, b, c = (np.einsum("ni,ni->n", *pair) for pair in ((one, one), (one, two), (two, two)))
    p, q = np.einsum("ni,ni->n", moved, one), np.einsum("ni,ni->n", moved, two)
    square = np.maximum(a * c - b * b, 1e-300)
    u, v = (c * p - b * q) / square, (a * q - b * p) / square
    return np.asarray(
        u[:, None] * (values[:, 1] - values[:, 0]) + v[:, None] * (values[:, 2] - values[:, 0])
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Tubes:
    """Ways from antenna to antenna that are known but for their first and last leg."""

    tx_points: Floats
    """Where the leg from the transmitter ends, (n, 3) [m]."""
    rx_points: Floats
    """Where the leg to the receiver begins, (n, 3) [m]."""
    path_m: Floats
    """Path between the two, walls included, (n,) [m]."""
    weights: NDArray[np.complex128]
    """All of the echo but the phase, seen from the block's middle, (n,)."""


def tube_echo(tubes: Tubes, tx: Floats, rx: Floats, waveform: Waveform) -> NDArray[np.complex64]:
    """Sum of the tubes at a block's antennas, (n_antennas, n_samples).

    tx: (n_antennas, 3) [m].
    rx: (n_antennas, 3) [m].
    """
    found = np.zeros((len(tx), waveform.n_samples), dtype=np.complex64)
    weights = tubes.weights.astype(np.complex64)
    n_step = max(1, _PAIRS_PER_STEP // max(1, len(weights)))
    for start in range(0, len(tx), n_step):
        part = slice(start, start + n_step)
        paths = np.linalg.norm(tx[part, None] - tubes.tx_points, axis=2)
        paths += np.linalg.norm(rx[part, None] - tubes.rx_points, axis=2)
        paths += tubes.path_m + waveform.path_bias_m
        found[part] = (phasors(paths, waveform.frequencies_hz) @ weights).T
    return found


@dataclass(frozen=True, kw_only=True, eq=False)
class TubeScene:
    """What tubes need of the scene."""

    mesh: SmoothMesh
    """The figure."""
    walls: tuple[Wall, ...]
    """Walls that rays cross."""
    waveform: Waveform
    wall_amplitude: float = 1.0
    """What one crossing of a wall leaves, on top of what its faces reflect."""
    tube_m: float = 0.0008
    """Distance of neighbouring rays at the figure [m]."""


class _Rays(NamedTuple):
    """Rays from one place at a figure."""

    ways: Floats
    """Unit vectors, (n, 3)."""
    turning: Floats
    """Their change from a ray to the next, (n, 2, 3)."""
    solid_angle: Floats
    """Of each, (n,)."""


def _rays_from(eye: Floats, scene: TubeScene) -> _Rays:
    vertices = scene.mesh.blocker.vertices
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    depth_m = float(np.linalg.norm(middle - eye))
    ahead = (middle - eye) / depth_m
    side = np.cross(ahead, np.eye(3)[np.abs(ahead).argmin()])
    side /= np.linalg.norm(side)
    plane = np.stack([side, np.cross(ahead, side)])
    seen = (vertices - eye) @ plane.T / ((vertices - eye) @ ahead)[:, None]
    step = scene.tube_m / depth_m
    lines = [
        np.arange(lo, hi + step, step) for lo, hi in zip(seen.min(0), seen.max(0), strict=True)
    ]
    u, v = (grid.ravel() for grid in np.meshgrid(*lines, indexing="ij"))
    long = ahead + u[:, None] * plane[0] + v[:, None] * plane[1]
    length = np.linalg.norm(long, axis=1)
    ways = long / length[:, None]
    along = np.einsum("ci,ni->nc", plane, ways)
    turning = (plane - along[..., None] * ways[:, None]) * (step / length)[:, None, None]
    return _Rays(ways, turning, step**2 / length**3)


def second_bounce(scene: TubeScene, eye: Floats, antennas: AntennaBlocks) -> Tubes:
    """Tubes that a conducting figure reflects on to itself, and that echo from there.

    scene: figure and walls.
    eye: middle of a block of antennas, (3,) [m].
    antennas: their boresight and pattern.
    """
    rays = _rays_from(eye, scene)
    eyes = np.broadcast_to(eye, rays.ways.shape)
    first = scene.mesh.meet(eyes, rays.ways, np.zeros_like(rays.turning), rays.turning)
    way, turning = rays.ways[first.rays], rays.turning[first.rays]
    slant = np.einsum("ni,ni->n", way, first.normals)
    on = way - 2.0 * slant[:, None] * first.normals
    change = np.einsum("nci,ni->nc", turning, first.normals) + np.einsum(
        "ni,nci->nc", way, first.turns
    )
    turned = turning - 2.0 * (
        slant[:, None, None] * first.turns + change[..., None] * first.normals[:, None]
    )
    starts = first.points + _LIFT_M * first.normals
    second = scene.mesh.meet(starts, on, first.across, turned)
    lit = np.einsum("ni,ni->n", on[second.rays], second.normals) < 0.0
    second = Hits(*(values[lit & (slant[second.rays] < 0.0)] for values in second))
    toward = eye - second.points
    range_m = np.linalg.norm(toward, axis=1)
    toward /= range_m[:, None]
    cosine_in = -np.einsum("ni,ni->n", on[second.rays], second.normals)
    cosine_out = np.einsum("ni,ni->n", toward, second.normals)
    seen = cosine_out > 0.0
    lifted = second.points + _LIFT_M * second.normals
    seen &= ~scene.mesh.blocker.occluded(lifted, np.broadcast_to(eye, lifted.shape))
    area = np.linalg.norm(np.cross(second.across[:, 0], second.across[:, 1]), axis=1)
    solid_angle = rays.solid_angle[first.rays][second.rays]
    field_area = np.sqrt(solid_angle * area / np.maximum(cosine_in, 1e-3))
    # Both reflections of a conductor: (-1)^2.
    weights = 0.5 * (cosine_in + cosine_out) * field_area / range_m
    weights *= _footprint(second.across, on[second.rays] - toward, scene.waveform)
    tubes = Tubes(
        tx_points=first.points[second.rays],
        rx_points=second.points,
        path_m=second.path_m,
        weights=1j / (4.0 * np.pi) * weights,
    )
    return _through_walls(_kept(tubes, seen), scene, eye, antennas)


def back_face(
    scene: TubeScene, eye: Floats, antennas: AntennaBlocks, material: tuple[float, float]
) -> Tubes:
    """Tubes that a dielectric figure refracts to its back face, and the same way back.

    scene: figure and walls.
    eye: middle of a block of antennas, (3,) [m].
    antennas: their boresight and pattern.
    material: relative permittivity and loss tangent of the figure.
    """
    permittivity, loss_tangent = material
    index = float(np.sqrt(permittivity))
    rays = _rays_from(eye, scene)
    eyes = np.broadcast_to(eye, rays.ways.shape)
    first = scene.mesh.meet(eyes, rays.ways, np.zeros_like(rays.turning), rays.turning)
    way, turning = rays.ways[first.rays], rays.turning[first.rays]
    cosine = -np.einsum("ni,ni->n", way, first.normals)
    slower = -(
        np.einsum("nci,ni->nc", turning, first.normals) + np.einsum("ni,nci->nc", way, first.turns)
    )
    # Snell: way / index + (cosine / index - inner) normal.
    inner = np.sqrt(1.0 - (1.0 - cosine**2) / permittivity)
    bend = cosine / index - inner
    bending = (1.0 / index - cosine / (permittivity * inner))[:, None] * slower
    on = way / index + bend[:, None] * first.normals
    turned = (
        turning / index
        + bending[..., None] * first.normals[:, None]
        + bend[:, None, None] * first.turns
    )
    second = scene.mesh.meet(first.points - _LIFT_M * first.normals, on, first.across, turned)
    rows = second.rays
    cosine_back = np.einsum("ni,ni->n", on[rows], second.normals)
    area = np.linalg.norm(np.cross(second.across[:, 0], second.across[:, 1]), axis=1)
    # Power flows in the tube: the field is root of solid angle over its section, both ways.
    weights = rays.solid_angle[first.rays][rows] * np.ones_like(area)
    weights = weights * (1.0 - face_reflection(np.maximum(cosine[rows], 0.0), permittivity) ** 2)
    k = 2.0 * np.pi / scene.waveform.center_wavelength_m
    weights = weights * np.exp(-k * index * loss_tangent * second.path_m)
    out = np.sqrt((1.0 - permittivity * (1.0 - cosine_back**2)).astype(np.complex128))
    reflected = (index * cosine_back - out) / (index * cosine_back + out)
    weights = weights * _footprint(second.across, 2.0 * index * on[rows], scene.waveform)
    tubes = Tubes(
        tx_points=first.points[rows],
        rx_points=first.points[rows],
        path_m=2.0 * index * second.path_m,
        weights=1j / (4.0 * np.pi) * weights * reflected,
    )
    seen = (cosine[rows] > 0.0) & (cosine_back > 0.0) & (area > 0.0)
    return _through_walls(_kept(tubes, seen), scene, eye, antennas)


def _kept(tubes: Tubes, keep: Bools) -> Tubes:
    return Tubes(**{name: getattr(tubes, name)[keep] for name in Tubes.__dataclass_fields__})


def _footprint(across: Floats, slope: Floats, waveform: Waveform) -> Floats:
    """Mean of a phase over a tube's footprint, linear in it: sinc of both its sides, (n,).

    across: sides, (n, 2, 3) [m].
    slope: gradient of the path, (n, 3).
    """
    change_m = np.einsum("nci,ni->nc", across, slope)
    return np.asarray(np.sinc(change_m / waveform.center_wavelength_m).prod(axis=1))


def _through_walls(tubes: Tubes, scene: TubeScene, eye: Floats, antennas: AntennaBlocks) -> Tubes:
    """Let walls and antennas weaken the first and the last leg, and walls delay them."""
    weights, path_m = tubes.weights.copy(), tubes.path_m.copy()
    for points in (tubes.tx_points, tubes.rx_points):
        transmission, excess_m = walls_crossed(points, eye, scene.walls)
        weights *= transmission
        path_m += excess_m
        if scene.wall_amplitude != 1.0:
            weights *= scene.wall_amplitude ** n_crossings(eye[None], points, scene.walls)[0]
        if antennas.pattern_exponent:
            way = points - eye
            cosine = way @ antennas.boresight / np.linalg.norm(way, axis=1)
            weights *= np.maximum(cosine, 0.0) ** antennas.pattern_exponent
    return Tubes(
        tx_points=tubes.tx_points, rx_points=tubes.rx_points, path_m=path_m, weights=weights
    )
