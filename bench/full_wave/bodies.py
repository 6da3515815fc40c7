"""Bodies of the full-wave captures, in millimetres; of metal but the pill and the beads."""

from dataclasses import dataclass, replace

import numpy as np
from body import Scatterer, dielectric_body, metal_body
from cluster import Ball, Cluster
from meridian import Meridian, joined
from waves import C0, highest_order

from geraf2.io.mesh import TriangleMesh
from geraf2.scene import Wall

_SHORTEST_M = C0 / 81e9
_TRUTH_EDGE_M = 0.0008


@dataclass(frozen=True, kw_only=True)
class Body:
    """One or several meridians on one axis, and how they stand."""

    curves: tuple[Meridian, ...]
    permittivity: complex | None = None
    """Relative; metal when None."""
    box: Wall | None = None
    """Box around it."""
    tilt_deg: float = 0.0
    """Turn about the y axis, which lays the axis of revolution down."""
    n_nodes: int = 10
    """Frequencies that are computed; the others are interpolated."""
    per_wavelength: float = 10.0
    """Rings of sources on a wavelength of the meridian."""
    depth: float = 1.5
    """Depth of the sources in spacings."""

    @property
    def alike_deg(self) -> float:
        """Turns about the vertical by multiples of it change nothing; any turn where it is 0."""
        if self.tilt_deg:
            return 360.0
        return 0.0 if self.box is None else 90.0

    @property
    def turn(self) -> np.ndarray:
        """Rotation from the body's frame into the capture's."""
        c, s = np.cos(np.deg2rad(self.tilt_deg)), np.sin(np.deg2rad(self.tilt_deg))
        return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])

    def mesh(self) -> TriangleMesh:
        whole = TriangleMesh.joined([curve.mesh(_TRUTH_EDGE_M) for curve in self.curves])
        return TriangleMesh(vertices=whole.vertices @ self.turn.T, faces=whole.faces)

    def scatterer(self, k: float) -> Scatterer:
        """Scattering matrices at a wavenumber, of the same orders up to 81 GHz."""
        index = np.sqrt(self.permittivity or 1.0)
        spacing = _SHORTEST_M / self.per_wavelength / index.real
        counts = [int(np.ceil(curve.length_m / spacing)) for curve in self.curves]
        pairs = list(zip(self.curves, counts, strict=True))
        at = joined([curve.ring(int(1.5 * n) + 1) for curve, n in pairs])
        inside = joined([curve.ring(n, self.depth * spacing) for curve, n in pairs])
        reach = max(curve.reach_m for curve in self.curves)
        n_max = highest_order(2 * np.pi / _SHORTEST_M * reach)
        if self.permittivity is None:
            return metal_body(at, inside, k, n_max)
        outside = joined([curve.ring(n, -self.depth * spacing) for curve, n in pairs])
        outside = outside._replace(n_rho=-outside.n_rho, n_z=-outside.n_z)
        return dielectric_body(at, inside, outside, k, n_max, index)


def _turned(*corners_mm: tuple[float, float], sigma_mm: float = 1.0) -> tuple[Meridian, ...]:
    corners = [(1e-3 * rho, 1e-3 * z) for rho, z in corners_mm]
    return (Meridian.smoothed(corners, 1e-3 * sigma_mm),)


def _spheres(*radius_height_mm: tuple[float, float]) -> tuple[Meridian, ...]:
    return tuple(Meridian.circle(1e-3 * r, 1e-3 * z) for r, z in radius_height_mm)


def _around(radius_mm: float, n: int, at_mm: float, height_mm: float) -> tuple[Ball, ...]:
    """Spheres on a horizontal circle."""
    turns = 2 * np.pi * np.arange(n) / n
    positions = 1e-3 * np.stack(
        [at_mm * np.cos(turns), at_mm * np.sin(turns), 0 * turns + height_mm]
    )
    return tuple(Ball(1e-3 * radius_mm, tuple(position)) for position in positions.T.tolist())


_VASE = (0, -25), (10, -25), (17, -12), (17, -2), (8, 10), (8, 16), (12, 20), (12, 25), (0, 25)
_HEAD = (0, -25), (11, -25), (11, -12), (7, -8), (7, 8), (11, 12), (11, 25), (0, 25)
_TOP = (0, -25), (5, -25), (20, 0), (20, 6), (5, 11), (5, 24), (0, 24)
_EGG = (0, -25), (13, -25), (18, -8), (17, 5), (9, 22), (4, 25), (0, 25)
_CUP = (0, -21), (17, -21), (17, 21), (13, 21), (13, -17), (0, -17)

BODIES: dict[str, Body | Cluster] = {
    "ball": Body(curves=_spheres((20, 0))),
    "egg": Body(curves=_turned(*_EGG, sigma_mm=4.0)),
    "drum": Body(curves=_turned((0, -18), (17, -18), (17, 18), (0, 18), sigma_mm=1.5)),
    "vase": Body(curves=_turned(*_VASE)),
    "bottle": Body(curves=_turned((0, -25), (13, -25), (13, 5), (5, 13), (5, 25), (0, 25))),
    "top": Body(curves=_turned(*_TOP, sigma_mm=1.5)),
    "cup": Body(curves=_turned(*_CUP), n_nodes=14, per_wavelength=12.0),
    "hammer": Body(curves=_turned(*_HEAD), tilt_deg=90.0),
    "pill": Body(
        curves=_turned((0, -14), (8, -14), (8, 14), (0, 14), sigma_mm=2.5),
        permittivity=2.56 + 0.0256j,
        n_nodes=16,
        per_wavelength=8.0,
    ),
    "snowman": Body(curves=_spheres((14, -10), (9, 15))),
    "chain": Body(curves=_spheres((6, -20), (4, -8), (6, 4), (5, 17)), n_nodes=12),
    "ring": Cluster(balls=_around(4, 6, 14, 0), symmetry=6),
    "molecule": Cluster(
        balls=(*_around(6, 1, 0, 0), *_around(4, 1, 0, 15), *_around(4, 3, 14, -6)), symmetry=3
    ),
    "beads": Cluster(
        balls=tuple(_around(5, 1, 0, height)[0] for height in (-14, 0, 14)),
        permittivity=2.56 + 0.0256j,
        symmetry=360,
    ),
}
_CARTON = Wall(size_m=(0.16, 0.16, 0.16), thickness_m=0.004, permittivity=1.6)
BODIES |= {f"{name}-box": replace(BODIES[name], box=_CARTON) for name in ("drum", "bottle")}
