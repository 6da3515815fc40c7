"""Orthographic pictures of triangle meshes by ray casting."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Floats, Floats32, Ints
from geraf2._validation import require_between, require_least, require_positive, require_shape
from geraf2.geometry.triangles import barycentric, unit_normals, vertex_normals
from geraf2.io.mesh import TriangleMesh
from geraf2.io.mesh_colours import to_linear, to_srgb
from geraf2.ops.visibility import MeshScene

# Directions of the two lights in the camera's frame (right, up, towards the viewer), and their
# shares; with the ambient share they add up to about 1 where a surface faces the key light.
_KEY_LIGHT = np.array([-0.45, 0.65, 0.75]) / np.linalg.norm([-0.45, 0.65, 0.75])
_FILL_LIGHT = np.array([0.8, -0.1, 0.5]) / np.linalg.norm([0.8, -0.1, 0.5])
_KEY_SHARE, _FILL_SHARE, _AMBIENT_SHARE = 0.55, 0.18, 0.32

# Directions of the ambient light at each vertex; the noise of 48 is 3 %, not visible.
_N_AMBIENT = 48

# A corner whose smooth normal is this far from the facet's own lies on a sharp edge: cos(30
# degrees). At the corner of a cube it is 35 to 55 degrees, on a marching-cubes surface below 20.
_SHARP_COSINE = 0.866


@dataclass(frozen=True, kw_only=True)
class View:
    """An orthographic camera aimed at a point; +z is up in the picture."""

    azimuth_deg: float
    """Direction of the camera, from +x towards +y [degrees]."""
    elevation_deg: float = 15.0
    """Height of the camera above the horizon, below 90 [degrees]."""
    center_m: tuple[float, float, float]
    """Point in the picture's middle [m]."""
    half_width_m: float
    """Half the picture's side [m]."""
    n_pixels: int = 320
    """Pixels along each side."""

    def __post_init__(self) -> None:
        require_positive("half_width_m", self.half_width_m)
        require_between("elevation_deg", self.elevation_deg, -90.0, 90.0)
        require_least(self, n_pixels=1)

    @property
    def axes(self) -> Floats:
        """Rows: right, up and towards the viewer as unit vectors in the frame, (3, 3)."""
        azimuth, elevation = np.deg2rad(self.azimuth_deg), np.deg2rad(self.elevation_deg)
        ahead = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        toward = np.cos(elevation) * ahead + np.sin(elevation) * np.array([0.0, 0.0, 1.0])
        right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        return np.stack([right, np.cross(toward, right), toward])


class MeshPainter:
    """Renderer of a mesh from any side; ray tracer, normals and ambient light are made once."""

    def __init__(self, mesh: TriangleMesh, *, num_threads: int | None = None) -> None:
        self.mesh = mesh
        self._scene = MeshScene(mesh.vertices, mesh.faces, num_threads=num_threads)
        self._face_normals = unit_normals(mesh.corners)
        self._vertex_normals = vertex_normals(mesh.vertices, mesh.faces)
        self.ambient = self._ambient_light()
        """Share of the sky that each vertex sees within half the mesh's size, (n_vertices,)."""
        self._traced: dict[View, tuple[Ints, Floats, Ints]] = {}

    def render(self, view: View, colours: NDArray[np.floating]) -> Floats32:
        """Picture of the mesh, sRGB with coverage as alpha, (n_pixels, n_pixels, 4), 0 to 1.

        view: camera.
        colours: sRGB colour of each vertex, 0 to 1, (n_vertices, 3).
        """
        require_shape("colours", colours, (self.mesh.vertices.shape[0], 3))
        fine = 2 * view.n_pixels  # two by two rays per pixel smooth the outline
        hit, points, face = self._trace(view, fine)
        light = self._shade(points, face, view.axes, np.asarray(colours, dtype=np.float64))
        picture = np.zeros((fine * fine, 4))
        picture[hit, :3] = light
        picture[hit, 3] = 1.0
        pooled = picture.reshape(view.n_pixels, 2, view.n_pixels, 2, 4).mean(axis=(1, 3))
        coverage = pooled[..., 3:]
        colour = np.divide(
            pooled[..., :3], coverage, out=np.zeros_like(pooled[..., :3]), where=coverage > 0
        )
        return np.concatenate([to_srgb(colour), coverage], axis=-1).astype(np.float32)

    def _trace(self, view: View, fine: int) -> tuple[Ints, Floats, Ints]:
        """Rays that hit, and their points and faces, cached for pictures in other colours."""
        if view not in self._traced:
            right, up, toward = view.axes
            steps = ((np.arange(fine) + 0.5) / fine * 2.0 - 1.0) * view.half_width_m
            across, height = (values.ravel() for values in np.meshgrid(steps, -steps))
            from_center = self.mesh.vertices - view.center_m
            reach = float(np.linalg.norm(from_center, axis=1).max())
            (left, low), (right_end, high) = (
                bound(from_center @ view.axes[:2].T, axis=0) for bound in (np.min, np.max)
            )
            inside = (across > left) & (across < right_end) & (height > low) & (height < high)
            rays = np.flatnonzero(inside)  # others pass the mesh
            plane = view.center_m + across[rays, None] * right + height[rays, None] * up
            origins = plane + (reach + 1e-3) * toward
            distance, face = self._scene.closest_hit(origins, np.tile(-toward, (len(rays), 1)))
            hit = face >= 0
            points = origins[hit] - distance[hit, None] * toward
            self._traced[view] = rays[hit], points, face[hit]
        return self._traced[view]

    def _shade(self, points: Floats, face: Ints, axes: Floats, colours: Floats) -> Floats:
        """Lambert shading in linear light, (n_points, 3)."""
        triangle = self.mesh.faces[face]
        weights = barycentric(points, self.mesh.vertices[triangle])
        flat = self._face_normals[face]
        corner_normals = self._vertex_normals[triangle]
        sharp = np.einsum("nkd,nd->nk", corner_normals, flat) < _SHARP_COSINE
        corner_normals = np.where(sharp[:, :, None], flat[:, None, :], corner_normals)
        normal = np.einsum("nk,nkd->nd", weights, corner_normals)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        # Both sides of an open surface are drawn.
        normal[flat @ axes[2] < 0] *= -1.0
        local = normal @ axes.T
        ambient = np.einsum("nk,nk->n", weights, self.ambient[triangle])
        key = np.maximum(local @ _KEY_LIGHT, 0.0)
        fill = np.maximum(local @ _FILL_LIGHT, 0.0)
        brightness = _KEY_SHARE * key + _FILL_SHARE * fill + _AMBIENT_SHARE
        brightness *= 0.35 + 0.65 * ambient
        albedo = np.einsum("nk,nkd->nd", weights, to_linear(colours)[triangle])
        return np.asarray(np.clip(albedo * brightness[:, None] * 1.15, 0.0, 1.0))

    def _ambient_light(self) -> Floats:
        """Share of the sky that each vertex sees within half the mesh's size, (n_vertices,)."""
        vertices, normals = self.mesh.vertices, self._vertex_normals
        extent = float(np.linalg.norm(np.ptp(vertices, axis=0)))
        rng = np.random.default_rng(0)
        sky = rng.standard_normal((_N_AMBIENT, 3))
        sky /= np.linalg.norm(sky, axis=1, keepdims=True)
        start = vertices + 1e-4 * extent * normals
        seen = np.zeros(vertices.shape[0])
        total = np.zeros(vertices.shape[0])
        for direction in sky:
            cosine = normals @ direction
            above = np.flatnonzero(cosine > 0.05)
            if above.size == 0:
                continue
            blocked = self._scene.occluded(
                start[above], start[above] + 0.5 * extent * direction, margin_m=1e-5 * extent
            )
            seen[above] += cosine[above] * ~blocked
            total[above] += cosine[above]
        return np.divide(seen, total, out=np.ones_like(seen), where=total > 0)
