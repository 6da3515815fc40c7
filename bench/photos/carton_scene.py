"""Light and surfaces of simulated photos: a closed carton on a board on a table, in a room.

Every surface is a flat rectangle. Light that does not depend on the view (a soft lamp with shadow,
the room, one bounce between surfaces) is computed once for a raster of positions on each rectangle;
a picture then costs one ray a sample and two look-ups. Radiance is linear, 1 is white paper under
the lamp.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from geraf2._types import Bools, Floats
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Wall
from geraf2.scene.photos import Camera
from photo_writing import upright_axes
from textures import Texture, board, carton_face, table

_Array = NDArray[np.float32]
Trace = Callable[[Floats, Floats], tuple[_Array, Bools]]

N_BOX_FACES = 6
"""The first rectangles of a scene are the carton."""

# Soft box to the front right, as from the middle of the carton, in its sizes.
_LAMP_DIRECTION = np.array([0.62, -0.48, 0.95])
_LAMP_DISTANCE = 7.0
_LAMP_RADIUS = 0.6
LAMP_COLOUR = np.array([1.0, 0.95, 0.87]) * 0.85
_ROOM_STRENGTH = 0.55
_N_LAMP_SAMPLES = 16
_N_SKY_SAMPLES = 64
_LIGHT_RASTER = 24
_BOARD_RASTER = 80
_GLOSS_EXPONENT = 40.0
_PIXEL_SAMPLES = 2  # along each side of a pixel
_OFFSET = 1e-5  # in sizes of the carton: a ray starts this far before its surface

# The board reaches beyond the carton's corners, and lies above the table, in sizes of the carton.
_BOARD_SIDE = 2.6
_BOARD_THICKNESS = 0.09
_TABLE_SIDE = 16.0


@dataclass(frozen=True, kw_only=True, eq=False)
class _Rectangle:
    """Flat surface, seen from the side its normal points to."""

    center: Floats
    right: Floats
    up: Floats
    half: tuple[float, float]
    texture: Texture
    raster: int = _LIGHT_RASTER
    light: _Array = field(default_factory=lambda: np.zeros((1, 1, 3), np.float32))

    @property
    def normal(self) -> Floats:
        return np.cross(self.right, self.up)

    def corners(self) -> Floats:
        a, b = self.half[0] * self.right, self.half[1] * self.up
        c = self.center
        return np.stack([c - a - b, c + a - b, c + a + b, c - a + b])

    def positions(self) -> Floats:
        """Raster of points, row by row from the upper left, (raster^2, 3)."""
        steps = (np.arange(self.raster) + 0.5) / self.raster * 2.0 - 1.0
        across, down = np.meshgrid(steps, -steps)
        return np.asarray(
            self.center
            + across.reshape(-1, 1) * self.half[0] * self.right
            + down.reshape(-1, 1) * self.half[1] * self.up
        )

    def coordinates_of(self, points: Floats) -> tuple[_Array, _Array]:
        """Coordinates of points, 0 to 1 to the right and downwards."""
        local = points - self.center
        u = 0.5 + 0.5 * (local @ self.right) / self.half[0]
        v = 0.5 - 0.5 * (local @ self.up) / self.half[1]
        return u.astype(np.float32), v.astype(np.float32)


class Picture(NamedTuple):
    """Radiance and silhouette before the sensor."""

    radiance: _Array
    """(height, width, 3), linear."""
    coverage: _Array
    """Share of each pixel that shows the carton, (height, width)."""


def photograph(trace: Trace, camera: Camera) -> Picture:
    """Radiance that each pixel of a camera receives.

    trace: radiance along rays from origins (n, 3) [m] in directions (n, 3), (n, 3), and whether
        each ends on the carton, (n,).
    camera: the camera, with its distortion.
    """
    radiance = np.empty((camera.height, camera.width, 3), dtype=np.float32)
    coverage = np.empty((camera.height, camera.width), dtype=np.float32)
    # Bands of rows keep the memory small.
    rows = max(1, 200_000 // (camera.width * _PIXEL_SAMPLES**2))
    steps = (np.arange(_PIXEL_SAMPLES) + 0.5) / _PIXEL_SAMPLES
    for first in range(0, camera.height, rows):
        last = min(first + rows, camera.height)
        v, u, dv, du = np.meshgrid(
            np.arange(first, last), np.arange(camera.width), steps, steps, indexing="ij"
        )
        origins, directions = camera.rays(np.stack([(u + du).ravel(), (v + dv).ravel()], 1))
        colour, on_object = trace(origins, directions)
        shape = (last - first, camera.width, _PIXEL_SAMPLES**2)
        radiance[first:last] = colour.reshape(*shape, 3).mean(axis=2)
        coverage[first:last] = on_object.reshape(shape).mean(axis=2)
    return Picture(radiance, coverage)


class CartonScene:
    """The closed outermost box on its board, ready to be photographed.

    seed: of the textures.
    """

    def __init__(self, wall: Wall, seed: int, num_threads: int | None = None) -> None:
        self.wall = wall
        self.size_m = float(max(wall.size_m))
        self.center = np.asarray(wall.center_m, dtype=np.float64)
        rectangles = [*_box_rectangles(wall, seed), *_ground_rectangles(wall, seed)]
        corners = np.concatenate([rectangle.corners() for rectangle in rectangles])
        first = 4 * np.arange(len(rectangles))[:, None]
        faces = (first + np.array([0, 1, 2, 0, 2, 3])).reshape(-1, 3)
        self._scene = MeshScene(corners, faces, num_threads=num_threads)
        self._rectangles = _light(rectangles, self._scene, self.center, self.size_m)

    def trace(self, origins: Floats, directions: Floats) -> tuple[_Array, Bools]:
        """Radiance along rays, and whether each ends on the carton, see :func:`photograph`."""
        distance, face = self._scene.closest_hit(origins, directions)
        which = np.where(face >= 0, face // 2, -1)
        colour = room_light(directions)
        for index, rectangle in enumerate(self._rectangles):
            hit = np.flatnonzero(which == index)
            if hit.size == 0:
                continue
            points = origins[hit] + distance[hit, None] * directions[hit]
            u, v = rectangle.coordinates_of(points)
            light = _look_up(rectangle.light, u, v)
            albedo = _look_up(rectangle.texture.albedo, u, v)
            shine = self._highlight(rectangle, points, directions[hit], light)
            colour[hit] = albedo * light + _look_up(rectangle.texture.gloss, u, v)[:, None] * shine
        return colour, (which >= 0) & (which < N_BOX_FACES)

    def _highlight(
        self, rectangle: _Rectangle, points: Floats, directions: Floats, light: _Array
    ) -> _Array:
        """Light of lamp and room mirrored by a glossy film, before its strength."""
        normal = rectangle.normal
        mirrored = directions - 2.0 * (directions @ normal)[:, None] * normal
        to_lamp = lamp_position(self.center, self.size_m) - points
        to_lamp /= np.linalg.norm(to_lamp, axis=1, keepdims=True)
        cosine = np.maximum(np.einsum("nk,nk->n", mirrored, to_lamp), 0.0)
        lamp = 3.0 * np.power(cosine, _GLOSS_EXPONENT)[:, None] * LAMP_COLOUR
        # In shadow there is no lamp to mirror; the light on the surface gives its visible share.
        seen = np.clip(light.mean(axis=1) / 0.8, 0.0, 1.0)[:, None]
        return np.asarray(lamp * seen + 0.4 * room_light(mirrored), dtype=np.float32)


def room_light(directions: Floats) -> _Array:
    """Radiance of the room far away along unit vectors, (n, 3): walls, shelves, a ceiling lamp."""
    x, y, z = directions[:, 0], directions[:, 1], directions[:, 2]
    azimuth = np.arctan2(y, x)
    wall = 0.42 + 0.12 * np.cos(azimuth - 0.7) + 0.25 * np.clip(z, -0.3, 1.0)
    colour = wall[:, None] * np.array([0.95, 0.97, 1.0])
    # Shelves and posters: steps of azimuth and elevation, each with a fixed tone.
    column = np.floor((azimuth + np.pi) / (2.0 * np.pi) * 19.0).astype(int) % 19
    row = np.floor((z + 1.0) * 9.0).astype(int)
    tone = np.sin(12.9898 * (column + 1.0) + 78.233 * row) * 43758.5453
    tone -= np.floor(tone)
    furnished = (z < 0.45) & (z > -0.35) & (tone > 0.55)
    hue = np.stack([0.5 + 0.5 * tone, 0.75 - 0.35 * tone, 1.1 - 0.9 * tone], axis=1)
    colour = np.where(furnished[:, None], 0.45 * colour * (0.5 + hue), colour)
    lamp = np.exp(-((1.0 - z) / 0.08))[:, None] * np.array([1.1, 1.05, 0.95])
    return np.asarray(_ROOM_STRENGTH * (colour + lamp), dtype=np.float32)


def _box_rectangles(wall: Wall, seed: int) -> list[_Rectangle]:
    x, y, z = np.eye(3)
    half = 0.5 * np.asarray(wall.size_m)
    center = np.asarray(wall.center_m, dtype=np.float64)
    # Right and up as seen from outside; sides in the order +x, +y, -x, -y, then top and bottom.
    frames = [(y, z), (-x, z), (-y, z), (x, z), (x, y), (-x, y)]
    rectangles = []
    for side, (right, up) in enumerate(frames):
        normal = np.cross(right, up)
        size = (float(half @ np.abs(right)), float(half @ np.abs(up)))
        rectangles.append(
            _Rectangle(
                center=center + (half @ np.abs(normal)) * normal,
                right=right,
                up=up,
                half=size,
                texture=carton_face((2.0 * size[0], 2.0 * size[1]), seed, side=side),
            )
        )
    return rectangles


def _ground_rectangles(wall: Wall, seed: int) -> list[_Rectangle]:
    size = max(wall.size_m)
    x, y, z = np.eye(3)
    foot = np.array([wall.center_m[0], wall.center_m[1], wall.center_m[2] - 0.5 * wall.size_m[2]])
    # The board is a hair below the carton, so that both do not compete for the same rays.
    grounds = ((board, _BOARD_SIDE, _OFFSET), (table, _TABLE_SIDE, _BOARD_THICKNESS))
    return [
        _Rectangle(
            center=foot - drop * size * z,
            right=x,
            up=y,
            half=(0.5 * side * size, 0.5 * side * size),
            texture=texture(side * size, seed),
            raster=_BOARD_RASTER,
        )
        for texture, side, drop in grounds
    ]


def sunflower(n: int) -> tuple[Floats, Floats]:
    """Seeds of a sunflower: shares of its area from 0 to 1, and angles [rad], (n,) each."""
    number = np.arange(n) + 0.5
    return number / n, np.pi * (1.0 + 5.0**0.5) * number


def lamp_position(center: Floats, size_m: float) -> Floats:
    """Middle of the soft box for a subject of this position and size (3,) [m]."""
    direction = _LAMP_DIRECTION / np.linalg.norm(_LAMP_DIRECTION)
    return np.asarray(center + _LAMP_DISTANCE * size_m * direction)


def _light(
    rectangles: Sequence[_Rectangle], scene: MeshScene, center: Floats, size_m: float
) -> list[_Rectangle]:
    """Rectangles with the light that falls on them: lamp, room and one bounce."""
    lamp = lamp_position(center, size_m)
    direct = [_lamp_light(r, scene, lamp, size_m) for r in rectangles]
    # A surface reflects its mean colour, which is enough for one bounce.
    bounced = [
        light * rectangle.texture.albedo.mean(axis=(0, 1))
        for rectangle, light in zip(rectangles, direct, strict=True)
    ]
    lit = []
    for index, rectangle in enumerate(rectangles):
        sky = _sky_light(rectangle, scene, rectangles, bounced, size_m)
        lit.append(replace(rectangle, light=direct[index] + sky))
    return lit


def _lamp_light(rectangle: _Rectangle, scene: MeshScene, lamp: Floats, size_m: float) -> _Array:
    """Light of the lamp on the raster, (raster, raster, 3); cosine times the part not hidden."""
    positions = rectangle.positions()
    start = positions + _OFFSET * size_m * rectangle.normal
    toward = lamp - rectangle.center
    toward /= np.linalg.norm(toward)
    # Sunflower points on the disc that faces the rectangle.
    share, angle = sunflower(_N_LAMP_SAMPLES)
    radius = _LAMP_RADIUS * size_m * np.sqrt(share)
    side, third = upright_axes(toward)
    disc = (radius * np.cos(angle))[:, None] * side
    disc += (radius * np.sin(angle))[:, None] * third
    # One query for all pairs of a position and a point of the lamp.
    to_lamp = (lamp + disc)[None, :, :] - positions[:, None, :]
    distance = np.linalg.norm(to_lamp, axis=2)
    cosine = np.maximum(to_lamp @ rectangle.normal / distance, 0.0)
    ends = np.broadcast_to(lamp + disc, to_lamp.shape).reshape(-1, 3)
    starts = np.repeat(start, _N_LAMP_SAMPLES, axis=0)
    hidden = scene.occluded(starts, ends, margin_m=_OFFSET * size_m).reshape(distance.shape)
    fall_off = (_LAMP_DISTANCE * size_m / distance) ** 2
    light = (cosine * fall_off * ~hidden).mean(axis=1)[:, None] * LAMP_COLOUR
    raster = (rectangle.raster, rectangle.raster, 3)
    return np.asarray(light.reshape(raster), dtype=np.float32)


def _sky_light(
    rectangle: _Rectangle,
    scene: MeshScene,
    rectangles: Sequence[_Rectangle],
    bounced: Sequence[_Array],
    size_m: float,
) -> _Array:
    """Light of room and lit surfaces on the raster, over cosine-weighted directions."""
    positions = rectangle.positions() + _OFFSET * size_m * rectangle.normal
    share, angle = sunflower(_N_SKY_SAMPLES)
    sine = np.sqrt(share)
    local = np.stack([sine * np.cos(angle), sine * np.sin(angle), np.sqrt(1.0 - sine**2)], axis=1)
    sky = local @ np.stack([rectangle.right, rectangle.up, rectangle.normal])
    origins = np.repeat(positions, _N_SKY_SAMPLES, axis=0)
    rays = np.tile(sky, (positions.shape[0], 1))
    distance, face = scene.closest_hit(origins, rays)
    seen = np.tile(room_light(sky), (positions.shape[0], 1))
    for index in np.unique(face[face >= 0] // 2):
        hit = np.flatnonzero(face // 2 == index)
        u, v = rectangles[index].coordinates_of(origins[hit] + distance[hit, None] * rays[hit])
        seen[hit] = _look_up(bounced[index], u, v)
    light = seen.reshape(rectangle.raster, rectangle.raster, _N_SKY_SAMPLES, 3).mean(axis=2)
    # A few directions make steps; neighbours share them out.
    return np.asarray(ndimage.gaussian_filter(light, (1.0, 1.0, 0.0), mode="nearest"))


def _look_up(image: _Array, u: _Array, v: _Array) -> _Array:
    """Bilinear values at coordinates 0 to 1 to the right and downwards."""
    rows, columns = image.shape[:2]
    x = np.clip(u * columns - 0.5, 0.0, columns - 1.0)
    y = np.clip(v * rows - 0.5, 0.0, rows - 1.0)
    x0 = np.minimum(x.astype(np.int32), max(columns - 2, 0))
    y0 = np.minimum(y.astype(np.int32), max(rows - 2, 0))
    fx, fy = x - x0, y - y0
    if image.ndim == 3:
        fx, fy = fx[:, None], fy[:, None]
    top = image[y0, x0] * (1.0 - fx) + image[y0, x0 + 1] * fx
    low = image[y0 + 1, x0] * (1.0 - fx) + image[y0 + 1, x0 + 1] * fx
    return np.asarray(top * (1.0 - fy) + low * fy, dtype=np.float32)
