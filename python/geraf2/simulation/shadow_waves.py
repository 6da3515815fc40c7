"""Shadow of the figure on a wall as a wave casts it: the field behind a Kirchhoff sheet."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import fft2, ifft2, next_fast_len
from scipy.ndimage import binary_dilation, binary_erosion

from geraf2._types import Bools, Floats, Ints
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.geometry.triangles import unit_normals
from geraf2.ops.visibility import MeshScene
from geraf2.simulation.dielectric import phasors

_SUBCELLS = 4
"""Rays along each side of a cell that the shadow's edge crosses: the edge is placed to a quarter."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FaceFrame:
    """Plane of a wall: where it is, and the directions along it and into the box."""

    origin: Floats
    """Its middle, (3,) [m]."""
    rows: Floats
    """Unit vectors: two along the wall and the normal that points into the box, (3, 3)."""

    def local(self, places: Floats) -> Floats:
        """Coordinates along the wall and the height over it, (n, 3) [m] -> (n, 3) [m]."""
        return np.asarray((places - self.origin) @ self.rows.T)

    def world(self, local: Floats) -> Floats:
        """Places of such coordinates, (n, 3) [m] -> (n, 3) [m]."""
        return np.asarray(local @ self.rows + self.origin)


class Lattice(NamedTuple):
    """Square cells in a plane parallel to a wall."""

    first: Floats
    """First cell, (2,) [m]."""
    shape: tuple[int, int]
    """Cells along both directions."""
    cell_m: float
    """Side of a cell [m]."""

    def places(self, height_m: float) -> Floats:
        """Centres of the cells at a height over the wall, (n_cells, 3) [m]."""
        lines = [
            f + self.cell_m * np.arange(n) for f, n in zip(self.first, self.shape, strict=True)
        ]
        u, v = (grid.ravel() for grid in np.meshgrid(*lines, indexing="ij"))
        return np.stack([u, v, np.full(u.size, height_m)], axis=1)


def lattice_over(low: Floats, high: Floats, cell_m: float) -> Lattice:
    """Cells that cover a rectangle, one more on each side; corners (2,) [m]."""
    n = np.ceil((high - low) / cell_m).astype(int) + 3
    return Lattice(0.5 * (low + high - (n - 1) * cell_m), (int(n[0]), int(n[1])), cell_m)


def rim_edges(vertices: Floats, faces: Ints, eye: Floats) -> Floats:
    """Middles of the edges between what faces a place and what does not, (n_edges, 3) [m].

    vertices: (n_vertices, 3) [m].
    faces: of a closed mesh, counter-clockwise from outside, (n_faces, 3).
    eye: the place, (3,) [m].
    """
    corners = vertices[faces]
    lit = np.einsum("fi,fi->f", eye - corners[:, 0], unit_normals(corners)) > 0
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    lit_side, dark_side = edges[np.tile(lit, 3)], edges[np.tile(~lit, 3)]
    size = len(vertices)
    # A neighbour runs along the same edge the other way.
    rim = np.isin(lit_side @ [size, 1], dark_side @ [1, size])
    return np.asarray(vertices[lit_side[rim]].mean(axis=1))


def shadow_mask(
    blocker: MeshScene, frame: FaceFrame, eye: Floats, sheet: Lattice, height_m: float
) -> Floats:
    """Share of each cell that the figure hides, seen from a place -> `sheet.shape`.

    blocker: the figure.
    eye: (3,) [m].
    height_m: of the sheet over the wall [m].
    """
    places = sheet.places(height_m)
    hidden = _hits(blocker, eye, frame.world(places)).reshape(sheet.shape)
    mask = hidden.astype(np.float64)
    edge = np.flatnonzero((binary_dilation(hidden, iterations=1) & ~binary_erosion(hidden)).ravel())
    steps = ((np.arange(_SUBCELLS) + 0.5) / _SUBCELLS - 0.5) * sheet.cell_m
    du, dv = (grid.ravel() for grid in np.meshgrid(steps, steps))
    fine = places[edge, None] + np.stack([du, dv, np.zeros_like(du)], axis=1)
    seen = _hits(blocker, eye, frame.world(fine.reshape(-1, 3))).reshape(len(edge), len(du))
    mask.ravel()[edge] = seen.mean(axis=1)
    return mask


def _hits(blocker: MeshScene, eye: Floats, targets: Floats) -> Bools:
    distances, _ = blocker.closest_hit(np.broadcast_to(eye, targets.shape), targets - eye)
    return np.isfinite(distances)


class Propagator:
    """Field on a wall from a field on a sheet parallel to it: Rayleigh and Sommerfeld's first integral.

    U(x) = (1 / 2 pi) sum_y U(y) (j k + 1 / r) (h / r) exp(-j k r) / r cell^2,    r = |x - y|,
    as a product of Fourier transforms.

    sheet: cells of the sheet.
    wall: cells of the wall, of the same size.
    height_m: of the sheet over the wall, h [m].
    frequencies_hz: equidistant, (n_frequencies,).
    """

    def __init__(
        self, sheet: Lattice, wall: Lattice, height_m: float, frequencies_hz: Floats
    ) -> None:
        self._sheet, self._wall = sheet.shape, wall.shape
        lines = []
        for axis in range(2):
            steps = np.arange(1 - sheet.shape[axis], wall.shape[axis])
            lines.append(wall.first[axis] - sheet.first[axis] + sheet.cell_m * steps)
        u, v = np.meshgrid(*lines, indexing="ij")
        r = np.sqrt(u**2 + v**2 + height_m**2)
        k = 2.0 * np.pi * frequencies_hz / SPEED_OF_LIGHT_M_PER_S
        scale = sheet.cell_m**2 * height_m / (2.0 * np.pi * r**2)
        kernel = phasors(r, frequencies_hz)
        kernel *= (scale * (1j * k[:, None, None] + 1.0 / r)).astype(np.complex64)
        self._size = [next_fast_len(n) for n in r.shape]
        self._kernel = fft2(kernel, self._size)

    def __call__(self, field: NDArray[np.complex64]) -> NDArray[np.complex64]:
        """Field on the sheet (n_frequencies, *sheet) to the field on the wall (n_frequencies, *wall)."""
        full = ifft2(fft2(field, self._size) * self._kernel, overwrite_x=True)
        u, v = (slice(n - 1, n - 1 + m) for n, m in zip(self._sheet, self._wall, strict=True))
        return np.asarray(full[:, u, v])
