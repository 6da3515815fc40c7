"""A surface that was trained from photos: signed distance, mesh, pictures."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from torch import Generator, Tensor

from geraf2._types import Array, Floats32
from geraf2.apps.photos.config import PhotoConfig
from geraf2.apps.photos.grid_smoothing import close_body, quick_redistance
from geraf2.apps.photos.neus.coloured_grid import ColouredGrid
from geraf2.apps.photos.neus.ray_samples import intersect_box
from geraf2.apps.photos.neus.rendering import Rendering, render_rays, sample_edges
from geraf2.apps.photos.visual_hull import Region
from geraf2.fields.sdf_field import CubeDomain
from geraf2.fields.sdf_grid import SdfGrid
from geraf2.io.mesh import TriangleMesh
from geraf2.io.toml import from_table
from geraf2.scene import Grid
from geraf2.scene.photos import Camera
from geraf2.surfaces.isosurface import extract_surface

KIND = "photos"
VERSION = 2
_MISSED_SPAN = 1e-3
"""Rendered length of a ray that misses the region, in radii of it."""
_CHUNK_SAMPLES = 1 << 18
"""Samples rendered at once: some 100 MB with the largest networks."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RenderedView:
    """Picture of a surface as a camera sees it."""

    colour: Floats32
    """sRGB from 0 to 1, (height, width, 3); black off the surface."""
    opacity: Floats32
    """0 to 1, (height, width)."""
    normal: Floats32
    """Outward normal in the capture frame, weighted by opacity, (height, width, 3)."""
    depth: Floats32
    """Mean distance along the ray where opacity is above 1/2, else NaN, (height, width) [m]."""


class NeuralSurface:
    """Result of `train_neural_surface`, in metres in the frame of the cameras.

    config, region: settings of its training, and box in which it lies.
    field: signed distance and colour.
    inv_s: sharpness of the logistic density [1/m].
    """

    def __init__(
        self,
        config: PhotoConfig,
        region: Region,
        field: ColouredGrid,
        *,
        inv_s: float,
        frame: str = "capture",
    ) -> None:
        self.config, self.region, self.frame = config, region, frame
        self.field, self.inv_s = field, inv_s

    def span(self, origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
        """Entry and exit of rays (n, 3) in the region, (n,) each [m]; entry >= exit: missed."""
        low, high = torch.tensor(self.region.low_m), torch.tensor(self.region.high_m)
        return intersect_box(origins, directions, low, high)

    def render_rays(
        self, rays: tuple[Tensor, Tensor], generator: Generator | None = None
    ) -> Rendering:
        """Render rays by :func:`geraf2.apps.photos.neus.rendering.render_rays`."""
        sampling, radius_m = self.config.sampling, self.region.radius_m
        near, far = self.span(*rays)
        # A ray that misses is rendered close to the camera, in empty space: entry and exit are
        # unbounded for a ray parallel to a face.
        missed = far <= near
        near = torch.where(missed, 0.0, near)
        far = torch.where(missed, _MISSED_SPAN * radius_m, far)
        # No sharper than the coarse intervals are long, or one of them gets all samples.
        first_inv_s = min(self.inv_s, 0.5 * sampling.n_coarse / radius_m)
        inv_s_range = (first_inv_s, self.inv_s)
        edges = sample_edges(self.field, rays, (near, far), sampling, inv_s_range, generator)
        return render_rays(self.field, rays, edges, self.inv_s)

    @torch.no_grad()
    def render(self, camera: Camera) -> RenderedView:
        """Picture of the surface as a camera sees it; deterministic."""
        sampling = self.config.sampling
        origins, directions = camera.rays(camera.pixel_centers())
        first = torch.from_numpy(origins).to(torch.float32)
        towards = torch.from_numpy(directions).to(torch.float32)
        near, far = self.span(first, towards)
        out = torch.zeros((first.shape[0], 8))
        chunk = max(1, _CHUNK_SAMPLES // (sampling.n_coarse + sampling.n_fine))
        for part in torch.split(torch.nonzero(far > near)[:, 0], chunk):
            seen = self.render_rays((first[part], towards[part]))
            rest = torch.stack([seen.opacity, seen.depth], dim=1)
            out[part] = torch.cat([seen.colour, seen.normal, rest], dim=1)
        image = out.reshape(camera.height, camera.width, 8).numpy()
        opacity, depth = image[..., 6], image[..., 7]
        return RenderedView(
            colour=image[..., :3],
            opacity=opacity,
            normal=image[..., 3:6],
            depth=np.where(opacity > 0.5, depth / np.maximum(opacity, 0.5), np.nan),
        )

    def sdf(self) -> SdfGrid:
        """Signed distance f_v over the region, closed, main parts only [m].

        Near the zero level the distance is exact to first order, farther out to half a voxel.
        """
        closed = self._close()
        values = quick_redistance(closed.values, closed.grid.spacing_m)
        return SdfGrid(grid=closed.grid, values=values)

    def mesh(self) -> TriangleMesh:
        """Zero level of the closed main parts, outward winding [m]."""
        return extract_surface(self._close())

    def _close(self) -> SdfGrid:
        grid, values = self.field.grid, self.field.distance.values.detach()
        return SdfGrid(grid=grid, values=close_body(values.numpy(), grid.spacing_m))

    def state(self) -> tuple[dict[str, Array], dict[str, Any]]:
        """Arrays by name and plain values, the input of `from_state`."""
        arrays = {f"field.{k}": v.detach().numpy() for k, v in self.field.state_dict().items()}
        header: dict[str, Any] = {
            "config": asdict(self.config),
            "region": asdict(self.region),
            "grid": asdict(self.field.grid),
            "inv_s": self.inv_s,
            "frame": self.frame,
        }
        return arrays, header

    @classmethod
    def from_state(cls, arrays: dict[str, Array], header: dict[str, Any]) -> "NeuralSurface":
        """Surface of a `state`."""
        config = from_table(header["config"], PhotoConfig, "stored config")
        region = from_table(header["region"], Region, "stored region")
        tensors = {name: torch.from_numpy(np.array(array)) for name, array in arrays.items()}
        grid = from_table(header["grid"], Grid, "stored grid")
        field = ColouredGrid(
            enclosing_cube(region), grid, tensors["field.distance.values"], config.model
        )
        field.features.restore(tensors["field.features.rows"])
        field.load_state_dict({name: tensors[f"field.{name}"] for name in field.state_dict()})
        return cls(config, region, field, inv_s=header["inv_s"], frame=header["frame"])


def enclosing_cube(region: Region) -> CubeDomain:
    """Cube about the ball around a region, in which a network is normalised."""
    return CubeDomain(center_m=region.center_m, half_side_m=region.radius_m)
