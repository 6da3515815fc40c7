"""Ray tubes at an object: second reflections, refraction to its back face, and paths in a shell.

Each tube is one ray from the middle of a block of antennas with its derivatives across (Igehy,
Tracing ray differentials, 1999), so that its footprint at the last hit needs no second ray.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Bools, Floats, Ints
from geraf2.geometry.triangles import barycentric, face_vectors, unit_normals
from geraf2.ops.physical_optics import AntennaBlocks
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Wall, Waveform
from geraf2.simulation.dielectric import cross_plate, cross_walls, face_reflection, phasors

_CREASE_COSINE = float(np.cos(np.deg2rad(30.0)))
"""Faces that meet at a flatter angle than this are one smooth surface."""
_LIFT_M = 2e-5  # rays leave a surface this far from it
_PAIRS_PER_STEP = 12_000  # antennas times tubes at once: their phasors are 3 MB at 32 samples


class Hits(NamedTuple):
    """Intersections of rays with the object, with derivatives to two directions across the rays."""

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
    """Indices of the rays that hit, (n,)."""
    faces: Ints
    """Faces that they hit, (n,)."""


class SmoothMesh:
    """Object under a ray tracer, whose normals vary over faces between its creases.

    blocker: the object.
    """

    def __init__(self, blocker: MeshScene) -> None:
        self.blocker = blocker
        self._corners = blocker.vertices[blocker.faces]
        self._normals = corner_normals(blocker.vertices, blocker.faces)

    def meet(self, starts: Floats, directions: Floats, spread: Floats, turning: Floats) -> Hits:
        """First hits of rays.

        starts: (n, 3) [m].
        directions: unit vectors, (n, 3).
        spread: derivatives of the starts, (n, 2, 3).
        turning: derivatives of the directions, (n, 2, 3).
        """
        path_m, faces = self.blocker.closest_hit(starts, directions)
        rays = np.flatnonzero(faces >= 0)
        path_m, faces, direction = path_m[rays], faces[rays], directions[rays]
        points = starts[rays] + path_m[:, None] * direction
        corners, own = self._corners[faces], self._normals[faces]
        weights = barycentric(points, corners)
        summed = np.einsum("nk,nki->ni", weights, own)
        length = np.linalg.norm(summed, axis=1)
        normals = summed / length[:, None]
        moved = spread[rays] + path_m[:, None, None] * turning[rays]
        slant = np.einsum("ni,ni->n", direction, normals)
        slant = np.where(np.abs(slant) > 1e-6, slant, np.inf)  # along the surface: no footprint
        longer = np.einsum("nci,ni->nc", moved, normals) / slant[:, None]
        across = moved - longer[..., None] * direction[:, None]
        turns = np.stack([_slopes(across[:, c], corners, own) for c in range(2)], axis=1)
        turns -= np.einsum("nci,ni->nc", turns, normals)[..., None] * normals[:, None]
        turns /= length[:, None, None]
        return Hits(points, across, normals, turns, path_m, rays, faces)


def corner_normals(vertices: Floats, faces: Ints) -> Floats:
    """Compute unit normals of each face at its corners, (n_faces, 3, 3).

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
    """Change of a linear function on triangles, (n, 3, 3), with a step along them, (n, 3)."""
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
    """Paths from antenna to antenna without their first and last leg."""

    tx_points: Floats
    """Where the leg from the transmitter ends, (n, 3) [m]."""
    rx_points: Floats
    """Where the leg to the receiver begins, (n, 3) [m]."""
    path_m: Floats
    """Path between the two, walls included, (n,) [m]."""
    weights: NDArray[np.complex128]
    """Complex amplitude without the phase of the path, for the block's middle, (n,)."""


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
    """Object and walls of a scene, as tubes need them."""

    mesh: SmoothMesh
    """The object; a shell with what it holds."""
    walls: tuple[Wall, ...]
    """Walls that rays cross."""
    waveform: Waveform
    wall_amplitude: float = 1.0
    """What one crossing of a wall leaves, on top of what its faces reflect."""
    tube_m: float = 0.001
    """Distance of neighbouring rays at the object [m]."""


class _Beam(NamedTuple):
    """Travelling rays, each with the change of start and direction to its neighbours."""

    starts: Floats
    """Starts, lifted off the surface they leave, (n, 3) [m]."""
    lead_m: Floats
    """Distance along the ray of that lift, (n,) [m]."""
    directions: Floats
    """Unit vectors, (n, 3)."""
    across: Floats
    """Change of the start, (n, 2, 3) [m]."""
    turning: Floats
    """Change of the direction, (n, 2, 3)."""
    first: Floats
    """First intersection with the object, (n, 3) [m]."""
    path_m: Floats
    """Optical path from there, (n,) [m]."""
    amplitude: NDArray[np.complex128]
    """Root of the ray's solid angle times all reflection and transmission factors, (n,)."""


_Rows = TypeVar("_Rows", _Beam, Hits)


def _cast_rays(eye: Floats, scene: TubeScene) -> _Beam:
    """Rays that cover the object, a raster on a plane through its middle."""
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
    directions = long / length[:, None]
    along = np.einsum("ci,ni->nc", plane, directions)
    turning = (plane - along[..., None] * directions[:, None]) * (step / length)[:, None, None]
    starts = np.broadcast_to(eye, directions.shape)
    amplitude = (step / length**1.5).astype(np.complex128)
    zero = np.zeros(len(directions))
    return _Beam(starts, zero, directions, np.zeros_like(turning), turning, starts, zero, amplitude)


def _meet(scene: TubeScene, beam: _Beam, index: float, first: bool = False) -> tuple[_Beam, Hits]:
    """Beam of the rays that hit the object from one side, with the hits."""
    # index: of refraction along the path; above 1 inside the object, which is then hit from within.
    beam, hits = _travel(scene, beam, index, first)
    return _facing(beam, hits, np.full(len(hits.rays), 1.0 if index > 1.0 else -1.0))


def _facing(beam: _Beam, hits: Hits, along: Floats) -> tuple[_Beam, Hits]:
    """Beam of the rays along the normals of what they hit, or against it."""
    # along: 1 or -1 of each ray, (n,).
    keep = along * np.einsum("ni,ni->n", beam.directions, hits.normals) > 1e-3
    return _take(beam, keep), _take(hits, keep)


def _travel(scene: TubeScene, beam: _Beam, index: float, first: bool = False) -> tuple[_Beam, Hits]:
    """Beam of the rays that hit the object, with the hits."""
    hits = scene.mesh.meet(beam.starts, beam.directions, beam.across, beam.turning)
    beam = _take(beam, hits.rays)
    if first:
        beam = beam._replace(first=hits.points)
    else:
        folds = _folds(beam, hits.path_m)
        beam = beam._replace(
            path_m=beam.path_m + index * (hits.path_m + beam.lead_m),
            amplitude=beam.amplitude * 1j**folds,
        )
    return beam, hits


def _take(rows: _Rows, keep: Bools | Ints) -> _Rows:
    """Those of a mask or of indices, of all arrays."""
    return type(rows)(**{name: values[keep] for name, values in rows._asdict().items()})


def _folds(beam: _Beam, path_m: Floats) -> Ints:
    """Count the zeros of a tube's cross section along its path; each advances the phase by 90."""
    side = np.cross(beam.directions, np.eye(3)[np.abs(beam.directions).argmin(axis=1)])
    plane = np.stack([side, np.cross(beam.directions, side)], axis=1)
    at, change = (np.einsum("nci,nki->nck", d, plane) for d in (beam.across, beam.turning))
    none, both = np.linalg.det(at), np.linalg.det(change)
    once = np.linalg.det(at + change) - none - both
    # Roots of none + once t + both t^2 between 0 and the path: real, for a wave's curvature is a
    # symmetric matrix, though rounding may part a double one.
    root = np.sqrt(np.maximum(once**2 - 4.0 * none * both, 0.0))
    half = -0.5 * (once + np.where(once < 0.0, -root, root))
    with np.errstate(divide="ignore", invalid="ignore"):
        positions = np.stack([half / both, none / half])
    return np.asarray(((positions > 0.0) & (positions < path_m)).sum(axis=0))


def _reflect(beam: _Beam, hits: Hits) -> _Beam:
    """Beam reflected at the surface."""
    slant = np.einsum("ni,ni->n", beam.directions, hits.normals)
    change = np.einsum("nci,ni->nc", beam.turning, hits.normals)
    change += np.einsum("ni,nci->nc", beam.directions, hits.turns)
    turning = beam.turning - 2.0 * (
        slant[:, None, None] * hits.turns + change[..., None] * hits.normals[:, None]
    )
    directions = beam.directions - 2.0 * slant[:, None] * hits.normals
    return _leave(beam, hits, directions, turning)


def _leave(beam: _Beam, hits: Hits, directions: Floats, turning: Floats) -> _Beam:
    """Beam that leaves a surface on the side of its new directions."""
    rise = np.einsum("ni,ni->n", directions, hits.normals)
    return beam._replace(
        starts=hits.points + _LIFT_M * np.sign(rise)[:, None] * hits.normals,
        lead_m=_LIFT_M * np.abs(rise),
        directions=directions,
        across=hits.across,
        turning=turning,
    )


def _refract(beam: _Beam, hits: Hits, ratio: float) -> tuple[_Beam, Hits]:
    """Beam refracted at the surface, by Snell's law; totally reflected rays are dropped."""
    # ratio: of the refractive indices, here over there.
    side = -np.sign(np.einsum("ni,ni->n", beam.directions, hits.normals))
    normals, turns = side[:, None] * hits.normals, side[:, None, None] * hits.turns
    cosine = -np.einsum("ni,ni->n", beam.directions, normals)
    square = 1.0 - ratio**2 * (1.0 - cosine**2)
    keep = square > 1e-6
    inner = np.sqrt(np.where(keep, square, 1.0))
    change = -np.einsum("nci,ni->nc", beam.turning, normals)
    change -= np.einsum("ni,nci->nc", beam.directions, turns)
    bend = ratio * cosine - inner
    bending = (ratio - ratio**2 * cosine / inner)[:, None] * change
    # Of either side: r = (n1 c1 - n2 c2) / (n1 c1 + n2 c2), TE; power 1 - r^2 is transmitted.
    r = (ratio * cosine - inner) / (ratio * cosine + inner)
    turning = ratio * beam.turning + bending[..., None] * normals[:, None]
    turning += bend[:, None, None] * turns
    beam = _leave(beam, hits, ratio * beam.directions + bend[:, None] * normals, turning)
    beam = beam._replace(amplitude=beam.amplitude * np.sqrt(1.0 - r**2))
    return _take(beam, keep), _take(hits, keep)


def second_bounce(scene: TubeScene, eye: Floats, antennas: AntennaBlocks) -> Tubes:
    """Tubes that are reflected twice by a conducting object.

    scene: object and walls.
    eye: middle of a block of antennas, (3,) [m].
    antennas: their boresight and pattern.
    """
    beam, hits = _meet(scene, _cast_rays(eye, scene), 1.0, first=True)
    beam, hits = _meet(scene, _reflect(beam, hits), 1.0)
    return _receive(scene, _reflect(beam, hits), hits, eye, antennas)  # (-1)^2 of a conductor


def back_face(
    scene: TubeScene, eye: Floats, antennas: AntennaBlocks, material: tuple[float, float]
) -> Tubes:
    """Tubes that enter a dielectric object, are reflected on its back face and leave it.

    scene: object and walls.
    eye: middle of a block of antennas, (3,) [m].
    antennas: their boresight and pattern.
    material: relative permittivity and loss tangent of the object.
    """
    permittivity, loss_tangent = material
    index = float(np.sqrt(permittivity))
    beam, hits = _meet(scene, _cast_rays(eye, scene), 1.0, first=True)
    beam, hits = _refract(beam, hits, 1.0 / index)
    beam, hits = _meet(scene, beam, index)
    cosine = np.einsum("ni,ni->n", beam.directions, hits.normals)
    out = np.sqrt((1.0 - permittivity * (1.0 - cosine**2)).astype(np.complex128))
    reflection = (index * cosine - out) / (index * cosine + out)
    beam = _reflect(beam._replace(amplitude=beam.amplitude * reflection), hits)
    beam, hits = _meet(scene, beam, index)
    beam, hits = _refract(beam, hits, index)
    k = 2.0 * np.pi / scene.waveform.center_wavelength_m
    lost = np.exp(-0.5 * k * loss_tangent * beam.path_m)
    return _receive(scene, beam._replace(amplitude=beam.amplitude * lost), hits, eye, antennas)


@dataclass(frozen=True, kw_only=True)
class Film:
    """Wall of a shell: thin, so that rays pass it without an offset."""

    plate: Wall
    """Its permittivity and thickness."""
    loss_tangent: float
    n_faces: int
    """The first so many faces of the object are the shell; the others are what it holds."""
    held_reflection: float = -1.0
    """Amplitude that the latter reflects; a conductor does -1."""

    def cross(self, beam: _Beam, hits: Hits, k: float) -> _Beam:
        """Beam on the other side; k: wavenumber [1/m]."""
        (cosine, inner), plate = self._cosines(beam, hits), self.plate
        passed, excess_m = cross_plate(cosine, plate)
        lost_m = self.loss_tangent * plate.permittivity * plate.thickness_m / inner
        beam = beam._replace(
            amplitude=beam.amplitude * passed * np.exp(-0.5 * k * lost_m),
            path_m=beam.path_m + excess_m,
        )
        return _leave(beam, hits, beam.directions, beam.turning)

    def reflect(self, beam: _Beam, hits: Hits) -> tuple[_Beam, Hits]:
        """Beam reflected by each face of the film and by what it holds, with the hits."""
        cosine, inner = self._cosines(beam, hits)
        r, is_film = face_reflection(cosine, self.plate.permittivity), hits.faces < self.n_faces
        near = beam._replace(amplitude=beam.amplitude * np.where(is_film, r, self.held_reflection))
        far = beam._replace(
            amplitude=-beam.amplitude * r * (1.0 - r**2),
            path_m=beam.path_m + 2.0 * self.plate.thickness_m * inner,
        )
        twice = np.append(np.arange(len(r)), np.flatnonzero(is_film))
        far = _take(far, is_film)
        both = _Beam(*(np.concatenate(pair) for pair in zip(near, far, strict=True)))
        return _reflect(both, _take(hits, twice)), _take(hits, twice)

    def _cosines(self, beam: _Beam, hits: Hits) -> tuple[Floats, Floats]:
        cosine = np.abs(np.einsum("ni,ni->n", beam.directions, hits.normals))
        return cosine, np.sqrt(self.plate.permittivity - 1.0 + cosine**2)


def behind_film(scene: TubeScene, eye: Floats, antennas: AntennaBlocks, film: Film) -> Tubes:
    """Tubes that enter a shell, are reflected by its far side or by what it holds, and leave it.

    scene: shell with what it holds, and walls.
    eye: middle of a block of antennas, (3,) [m].
    antennas: their boresight and pattern.
    film: wall of the shell.
    """
    k = 2.0 * np.pi / scene.waveform.center_wavelength_m
    beam, hits = _meet(scene, _cast_rays(eye, scene), 1.0, first=True)
    beam, hits = _travel(scene, film.cross(beam, hits, k), 1.0)
    beam, hits = _facing(beam, hits, np.where(hits.faces < film.n_faces, 1.0, -1.0))
    beam, hits = film.reflect(beam, hits)
    beam, hits = _travel(scene, beam, 1.0)
    beam, hits = _facing(beam, hits, np.where(hits.faces < film.n_faces, 1.0, 0.0))
    return _receive(scene, film.cross(beam, hits, k), hits, eye, antennas)


def _receive(
    scene: TubeScene, beam: _Beam, hits: Hits, eye: Floats, antennas: AntennaBlocks
) -> Tubes:
    """Kirchhoff's integral over the field that leaves a surface, one tube a term."""
    # beam: as it leaves the surface. hits: where it does.
    toward = eye - hits.points
    range_m = np.linalg.norm(toward, axis=1)
    toward /= range_m[:, None]
    cosine_beam = np.einsum("ni,ni->n", beam.directions, hits.normals)
    cosine = np.einsum("ni,ni->n", toward, hits.normals)
    seen = (cosine > 0.0) & (cosine_beam > 1e-3)
    lifted = hits.points + _LIFT_M * hits.normals
    seen &= ~scene.mesh.blocker.occluded(lifted, np.broadcast_to(eye, lifted.shape))
    area = np.linalg.norm(np.cross(hits.across[:, 0], hits.across[:, 1]), axis=1)
    # Power flows in the tube: the field is root of solid angle over its cross section.
    field_area = beam.amplitude * np.sqrt(area / np.where(seen, cosine_beam, 1.0))
    change_m = np.einsum("nci,ni->nc", hits.across, beam.directions - toward)
    footprint = np.sinc(change_m / scene.waveform.center_wavelength_m).prod(axis=1)
    weights = cosine * field_area * footprint / range_m
    tubes = Tubes(
        tx_points=beam.first,
        rx_points=hits.points,
        path_m=beam.path_m,
        weights=1j / (4.0 * np.pi) * weights,
    )
    tubes = Tubes(**{name: values[seen] for name, values in vars(tubes).items()})
    return _cross_walls(tubes, scene, eye, antennas)


def _cross_walls(tubes: Tubes, scene: TubeScene, eye: Floats, antennas: AntennaBlocks) -> Tubes:
    """Let walls and antennas weaken the first and the last leg, and walls delay them."""
    weights, path_m = tubes.weights.copy(), tubes.path_m.copy()
    for points in (tubes.tx_points, tubes.rx_points):
        transmission, excess_m = cross_walls(points, eye, scene.walls, scene.wall_amplitude)
        weights *= transmission
        path_m += excess_m
        if antennas.pattern_exponent:
            direction = points - eye
            cosine = direction @ antennas.boresight / np.linalg.norm(direction, axis=1)
            weights *= np.maximum(cosine, 0.0) ** antennas.pattern_exponent
    return replace(tubes, path_m=path_m, weights=weights)
