"""Light and surface of simulated photos of the bare object, without its box.

The object is painted matt with a pattern and floats
in the room of the carton's photos (:mod:`geraf2.simulation.photo_scene`). Light that does not
depend on the view is computed once for each vertex and interpolated over triangles.
"""

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Bools, Floats
from geraf2.geometry.triangles import barycentric, vertex_normals
from geraf2.io.mesh import TriangleMesh
from geraf2.ops.visibility import MeshScene
from geraf2.simulation.photo_scene import LAMP_COLOUR, lamp_position, room_light, sunflower

_Array = NDArray[np.float32]

_N_SKY = 64
_OFFSET = 1e-4  # in sizes of the object: a ray starts this far before its surface
_BOUNCE = 0.25  # of the room's mean light comes from the object itself where it hides the room

# The paint: waves in space whose sum decides between two colours, in three channels. Lengths from
# some pixels of a photo to a third of the object: the pattern distinguishes patches of photos.
_N_WAVES = 12
_LOG_WAVELENGTHS = (float(np.log(0.06)), float(np.log(0.35)))
_DARK, _LIGHT = 0.12, 0.75
_CONTRAST = 2.0


class ObjectScene:
    """The bare object in the room, ready to be photographed.

    mesh: the object, closed, wound outward [m].
    seed: of its paint.
    """

    def __init__(self, mesh: TriangleMesh, seed: int, num_threads: int | None = None) -> None:
        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        self.center = 0.5 * (low + high)
        self.size_m = float((high - low).max())
        self._scene = MeshScene(mesh.vertices, mesh.faces, num_threads=num_threads)
        self._mesh = mesh
        self._waves = _paint_waves(seed)
        self._light = self._vertex_light()

    def albedo(self, points: Floats) -> _Array:
        """Albedo of the paint at points (n, 3) [m], (n, 3) colours."""
        vectors, phases = self._waves
        positions = (points - self.center) / self.size_m
        height = np.cos(np.einsum("nk,cwk->ncw", positions, vectors) + phases).sum(axis=2)
        share = 0.5 + 0.5 * np.tanh(_CONTRAST * height / np.sqrt(0.5 * _N_WAVES))
        return np.asarray(_DARK + (_LIGHT - _DARK) * share, dtype=np.float32)

    def trace(self, origins: Floats, directions: Floats) -> tuple[_Array, Bools]:
        """Radiance along rays, and whether each ends on the object."""
        distance, face = self._scene.closest_hit(origins, directions)
        colour = room_light(directions)
        hit = np.flatnonzero(face >= 0)
        points = origins[hit] + distance[hit, None] * directions[hit]
        corners = self._mesh.faces[face[hit]]
        weights = barycentric(points, self._mesh.vertices[corners])
        light = np.einsum("nk,nkc->nc", weights, self._light[corners])
        colour[hit] = self.albedo(points) * light
        return colour, face >= 0

    def _vertex_light(self) -> _Array:
        """Light of lamp and room on each vertex, (n_vertices, 3)."""
        normals = vertex_normals(self._mesh.vertices, self._mesh.faces)
        starts = self._mesh.vertices + _OFFSET * self.size_m * normals
        lamp = lamp_position(self.center, self.size_m)
        to_lamp = lamp - starts
        cosine = np.einsum("nk,nk->n", normals, to_lamp) / np.linalg.norm(to_lamp, axis=1)
        ends = np.broadcast_to(lamp, starts.shape)
        hidden = self._scene.occluded(starts, ends, margin_m=_OFFSET * self.size_m)
        total = (np.maximum(cosine, 0.0) * ~hidden)[:, None] * LAMP_COLOUR
        # The same directions for all vertices, weighed by the cosine: neighbours agree.
        share, angle = sunflower(_N_SKY)
        z = 1.0 - 2.0 * share
        across = np.sqrt(1.0 - z**2)
        sky = np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)
        room = room_light(sky)
        bounce = _BOUNCE * room.mean(axis=0)
        for direction, radiance in zip(sky, room, strict=True):
            facing = np.maximum(normals @ direction, 0.0) * 4.0 / _N_SKY
            seen = np.flatnonzero(facing > 0.0)
            _, face = self._scene.closest_hit(
                starts[seen], np.broadcast_to(direction, (len(seen), 3))
            )
            total[seen] += facing[seen, None] * np.where(face[:, None] < 0, radiance, bounce)
        return np.asarray(total, dtype=np.float32)


def _paint_waves(seed: int) -> tuple[Floats, Floats]:
    """Wave vectors (3, n_waves, 3) in radians per size of the object, and phases (3, n_waves)."""
    rng = np.random.default_rng([seed, 8])
    directions = rng.normal(size=(3, _N_WAVES, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    lengths = np.exp(rng.uniform(*_LOG_WAVELENGTHS, (3, _N_WAVES, 1)))
    return 2.0 * np.pi * directions / lengths, rng.uniform(0.0, 2.0 * np.pi, (3, _N_WAVES))
