"""Ray queries against a triangle mesh: hits, occlusion, entry and exit, signed distance."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from geraf2 import _core  # noqa: TID251 - ops is the package that wraps the native module
from geraf2._types import Bools, Floats, Ints
from geraf2._validation import require_shape
from geraf2.ops._geometry import require_positions
from geraf2.ops._threads import resolve_num_threads

DEFAULT_OCCLUSION_MARGIN_M = 1e-5
"""Both ends of a segment are shortened by this: ten float32 roundings of a metre-sized scene."""

_POINTS_PER_CALL = 1 << 18
"""Rays of a native call, about a second: Ctrl-C takes effect between calls."""


class RayIntervals(NamedTuple):
    """Stretches of each ray inside the mesh, nearest first, padded with inf."""

    t_entry: Floats
    """Distance at which each stretch begins, 0 where the origin is inside, (n_rays, k) [m]."""
    t_exit: Floats
    """Distance at which each stretch ends, inf where the mesh is open, (n_rays, k) [m]."""


class MeshScene:
    """Triangle mesh under a ray tracer (Embree); rays in float32, distances refined in float64.

    vertices: (n_vertices, 3) [m].
    faces: vertex indices, of one winding, (n_faces, 3). Inside and outside want a closed
        mesh, or a scan whose holes are few.
    num_threads: threads of each query; torch's number when torch is loaded, else all cores, when
        None.
    """

    def __init__(
        self, vertices: ArrayLike, faces: ArrayLike, *, num_threads: int | None = None
    ) -> None:
        self.vertices = _rows("vertices", vertices)
        face_array = np.ascontiguousarray(faces, dtype=np.int64)
        require_shape("faces", face_array, (None, 3))
        if face_array.shape[0] == 0:
            msg = "faces must hold at least one triangle, got none"
            raise ValueError(msg)
        low, high = int(face_array.min()), int(face_array.max())
        if low < 0 or high >= self.vertices.shape[0]:
            msg = (
                f"faces must index {self.vertices.shape[0]} vertices, "
                f"got indices from {low} to {high}"
            )
            raise ValueError(msg)
        self.faces = face_array
        a, b, c = (self.vertices[face_array[:, k]] - self.vertices.mean(axis=0) for k in range(3))
        volume_6 = float(np.einsum("fi,fi->", a, np.cross(b, c)))
        self._wound_outward = volume_6 >= 0.0
        self._num_threads = resolve_num_threads(num_threads)
        self._scene = _core.MeshScene(self.vertices, self.faces)

    def closest_hit(self, origins: ArrayLike, directions: ArrayLike) -> tuple[Floats, Ints]:
        """First face along each ray.

        origins: (n_rays, 3) [m].
        directions: (n_rays, 3), any length but zero.

        Returns distance, inf where the ray misses, (n_rays,) [m]; face, -1 where it misses,
        (n_rays,).
        """
        start = _rows("origins", origins)
        distances, faces = self._scene.closest_hit(
            start, _directions(directions, start.shape[0]), self._num_threads
        )
        return distances, faces

    def first_meetings(self, origins: ArrayLike, targets: ArrayLike) -> Floats:
        """Where the segments from origins to targets first meet the mesh, (n, 3) [m].

        origins, targets: (n, 3) [m]. The target itself where nothing lies in between.
        """
        start, end = _rows("origins", origins), _rows("targets", targets)
        require_shape("targets", end, (start.shape[0], 3))
        return self._scene.first_meetings(start, end, self._num_threads)

    def spans(self, origins: ArrayLike, directions: ArrayLike) -> tuple[Floats, Floats]:
        """Where each ray first enters the mesh and where it last leaves it.

        origins, directions: as for :meth:`entry_exit`, of which these are the ends.

        Returns distances (n_rays,) [m] each: inf where it never enters, -inf where it never leaves.
        """
        start = _rows("origins", origins)
        rows = _directions(directions, start.shape[0])
        return self._scene.spans(start, rows, self._wound_outward, self._num_threads)

    def occluded(
        self,
        origins: ArrayLike,
        targets: ArrayLike,
        *,
        margin_m: float = DEFAULT_OCCLUSION_MARGIN_M,
    ) -> Bools:
        """Whether the segment from origin to target meets the mesh -> (n_segments,).

        origins: (n_segments, 3) [m].
        targets: (n_segments, 3) [m].
        margin_m: length left out at both ends, so that a face does not hide its own points [m].
        """
        start = _rows("origins", origins)
        end = _rows("targets", targets)
        require_shape("targets", end, (start.shape[0], 3))
        if not 0.0 <= margin_m < np.inf:
            msg = f"margin_m must be finite and not negative, got {margin_m}"
            raise ValueError(msg)
        blocked = self._scene.occluded(start, end, float(margin_m), self._num_threads)
        return blocked.astype(np.bool_)

    def entry_exit(self, origins: ArrayLike, directions: ArrayLike) -> RayIntervals:
        """Stretches of each ray inside the mesh.

        origins: (n_rays, 3) [m].
        directions: (n_rays, 3), any length but zero.

        Returns entry and exit distances, (n_rays, k) with k the largest number of stretches of any
        ray; inf where a ray has fewer.
        """
        start = _rows("origins", origins)
        offsets, distances, entering = self._scene.crossings(
            start, _directions(directions, start.shape[0]), self._num_threads
        )
        return _intervals(offsets, distances, (entering != 0) == self._wound_outward)

    def distance(self, points: ArrayLike) -> Floats:
        """Distance to the nearest face, (n_points, 3) [m] -> (n_points,) [m].

        Quickest where points near each other follow each other, as those of a grid do. Not
        differentiable.
        """
        return self._scene.distance(_rows("points", points), self._num_threads)

    def signed_distance(self, points: ArrayLike) -> Floats:
        """Distance to the nearest face, negative inside, (n_points, 3) [m] -> (n_points,) [m].

        The sign is the majority of five rays. Not differentiable.
        """
        rows = _rows("points", points)
        distances = np.empty(rows.shape[0])
        for start in range(0, rows.shape[0], _POINTS_PER_CALL):
            part = slice(start, start + _POINTS_PER_CALL)
            distances[part] = self._scene.signed_distance(rows[part], self._num_threads)
        return distances

    def contains(self, points: ArrayLike) -> Bools:
        """Whether points lie inside, by the majority of five rays, (n_points, 3) [m]."""
        inside = self._scene.contains(_rows("points", points), self._num_threads)
        return inside.astype(np.bool_)

    def winding_number(self, points: ArrayLike) -> Floats:
        """Generalised winding number w = sum of solid angles / 4 pi at (n_points, 3) [m].

        1 inside and 0 outside a closed mesh, in between near holes. Costs n_points n_faces.
        Equation 5 of Jacobson, Kavan and Sorkine-Hornung, Robust inside-outside segmentation
        using generalized winding numbers, 2013.
        """
        return self._scene.winding_number(_rows("points", points), self._num_threads)


def _rows(name: str, values: ArrayLike) -> Floats:
    return require_positions(name, np.asarray(values, dtype=np.float64))


def _directions(values: ArrayLike, n_rays: int) -> Floats:
    rows = np.ascontiguousarray(values, dtype=np.float64)
    require_shape("directions", rows, (n_rays, 3))
    if not np.isfinite(rows).all():
        msg = f"directions must be finite, got {rows[~np.isfinite(rows).all(axis=1)][0]}"
        raise ValueError(msg)
    if not (rows != 0.0).any(axis=1).all():
        msg = "directions must not be zero, got (0, 0, 0)"
        raise ValueError(msg)
    return rows


def _intervals(offsets: Ints, distances: Floats, entering: Bools) -> RayIntervals:
    """Pair crossings: a stretch begins where the depth leaves zero and ends where it returns."""
    n_rays = offsets.shape[0] - 1
    ray = np.repeat(np.arange(n_rays), np.diff(offsets))
    step = np.where(entering, 1, -1)
    total = np.concatenate([[0], np.cumsum(step)])
    running = total[1:] - total[offsets[ray]]
    # A ray that starts inside meets more exits than entries: its depth starts above zero.
    depth_at_start = np.zeros(n_rays, dtype=np.int64)
    np.minimum.at(depth_at_start, ray, running)
    depth_at_start = -depth_at_start
    depth = running + depth_at_start[ray]
    begins = entering & (depth == 1)
    ends = ~entering & (depth == 0)

    n_begins = np.bincount(ray[begins], minlength=n_rays)
    width = int((n_begins + (depth_at_start > 0)).max(initial=0))
    t_entry = np.full((n_rays, width), np.inf)
    t_exit = np.full((n_rays, width), np.inf)
    inside = depth_at_start > 0
    if width:
        t_entry[inside, 0] = 0.0
    for times, mask, first in ((t_entry, begins, inside), (t_exit, ends, np.zeros_like(inside))):
        ray_of = ray[mask]
        starts = np.concatenate([[0], np.cumsum(np.bincount(ray_of, minlength=n_rays))])[:-1]
        rank = np.arange(ray_of.shape[0]) - starts[ray_of] + first[ray_of]
        times[ray_of, rank] = distances[mask]
    return RayIntervals(t_entry=t_entry, t_exit=t_exit)
