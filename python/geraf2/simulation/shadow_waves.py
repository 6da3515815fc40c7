"""Diffracted shadow of the object on a wall: the field behind a Kirchhoff sheet."""

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import fft2, ifft2, next_fast_len
from scipy.ndimage import binary_dilation, binary_erosion

from geraf2._types import Bools, Floats, Ints
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.geometry.triangles import directed_edges, unit_normals
from geraf2.ops.visibility import MeshScene
from geraf2.simulation.dielectric import phasors

REFINE = 2
"""Cells of the sheet along each side of one of the wall: from the wall's middle to the rim of a
shadow the phase along the sheet turns by up to 0.6 rad a millimetre."""
_SUBCELLS = 3
"""Rays along each side of a cell that the shadow's edge crosses."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FaceFrame:
    """Plane of a wall: where it is, and the directions along it and into the box."""

    origin: Floats
    """Its middle, (3,) [m]."""
    rows: Floats
    """Unit vectors: two along the wall and the normal that points into the box, (3, 3)."""

    def to_local(self, positions: Floats) -> Floats:
        """Coordinates along the wall and the height over it, (n, 3) [m] -> (n, 3) [m]."""
        return np.asarray((positions - self.origin) @ self.rows.T)

    def to_world(self, local: Floats) -> Floats:
        """World coordinates of local ones, (n, 3) [m] -> (n, 3) [m]."""
        return np.asarray(local @ self.rows + self.origin)


class Lattice(NamedTuple):
    """Square cells in a plane parallel to a wall."""

    first: Floats
    """First cell, (2,) [m]."""
    shape: tuple[int, int]
    """Cells along both directions."""
    cell_m: float
    """Side of a cell [m]."""

    def positions(self, height_m: float) -> Floats:
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
    """Middles of the edges between faces towards a position and others, (n_edges, 3) [m].

    vertices: (n_vertices, 3) [m].
    faces: of a closed mesh, counter-clockwise from outside, (n_faces, 3).
    eye: the position, (3,) [m].
    """
    corners = vertices[faces]
    lit = np.einsum("fi,fi->f", eye - corners[:, 0], unit_normals(corners)) > 0
    edges = directed_edges(faces)
    lit_side, dark_side = edges[np.tile(lit, 3)], edges[np.tile(~lit, 3)]
    size = len(vertices)
    # A neighbour runs along the same edge in the opposite direction.
    rim = np.isin(lit_side @ [size, 1], dark_side @ [1, size])
    return np.asarray(vertices[lit_side[rim]].mean(axis=1))


def shadow_mask(
    blocker: MeshScene, frame: FaceFrame, eye: Floats, sheet: Lattice, height_m: float
) -> Floats:
    """Share of each cell that the object hides, seen from a position -> `sheet.shape`.

    blocker: the object.
    eye: (3,) [m].
    height_m: of the sheet over the wall [m].
    """
    positions = sheet.positions(height_m)
    hidden = _hits(blocker, eye, frame.to_world(positions)).reshape(sheet.shape)
    mask = hidden.astype(np.float64)
    edge = np.flatnonzero((binary_dilation(hidden, iterations=1) & ~binary_erosion(hidden)).ravel())
    steps = ((np.arange(_SUBCELLS) + 0.5) / _SUBCELLS - 0.5) * sheet.cell_m
    du, dv = (grid.ravel() for grid in np.meshgrid(steps, steps))
    fine = positions[edge, None] + np.stack([du, dv, np.zeros_like(du)], axis=1)
    seen = _hits(blocker, eye, frame.to_world(fine.reshape(-1, 3))).reshape(len(edge), len(du))
    mask.ravel()[edge] = seen.mean(axis=1)
    return mask


def _hits(blocker: MeshScene, eye: Floats, targets: Floats) -> Bools:
    distances, _ = blocker.closest_hit(np.broadcast_to(eye, targets.shape), targets - eye)
    return np.isfinite(distances)


class Propagator:
    """Field on a wall from that on a parallel sheet, by Rayleigh and Sommerfeld's first integral.

    U(x) = (1 / 2 pi) sum_y U(y) (j k + 1 / r) (h / r) exp(-j k r) / r cell^2,    r = |x - y|,
    as a product of Fourier transforms, one for each of the finer lattices that make up the sheet.

    sheet: cells of the sheet, REFINE times finer than those of the wall.
    wall: cells of the wall.
    height_m: of the sheet over the wall, h [m].
    frequencies_hz: equidistant, (n_frequencies,).
    """

    def __init__(
        self, sheet: Lattice, wall: Lattice, height_m: float, frequencies_hz: Floats
    ) -> None:
        n_sheet = [-(-n // REFINE) for n in sheet.shape]
        self._first, self._shape = [n - 1 for n in n_sheet], wall.shape
        self._size = [next_fast_len(n + m - 1) for n, m in zip(n_sheet, wall.shape, strict=True)]
        steps = [
            wall.cell_m * np.arange(1 - n, m) for n, m in zip(n_sheet, wall.shape, strict=True)
        ]
        k = 2.0 * np.pi * frequencies_hz[:, None, None] / SPEED_OF_LIGHT_M_PER_S
        self._kernels = {}
        for part in itertools.product(range(REFINE), repeat=2):
            start = wall.first - sheet.first - sheet.cell_m * np.array(part)
            u, v = np.meshgrid(start[0] + steps[0], start[1] + steps[1], indexing="ij")
            r = np.sqrt(u**2 + v**2 + height_m**2)
            scale = sheet.cell_m**2 * height_m / (2.0 * np.pi * r**2)
            kernel = phasors(r, frequencies_hz)
            kernel *= (scale * (1j * k + 1.0 / r)).astype(np.complex64)
            self._kernels[part] = fft2(kernel, self._size)

    def __call__(self, field: NDArray[np.complex64]) -> NDArray[np.complex64]:
        """Field on the sheet (n_frequencies, *sheet) to that on the wall (n_frequencies, *wall)."""
        total = np.zeros((len(field), *self._size), dtype=np.complex64)
        for (u, v), kernel in self._kernels.items():
            total += fft2(field[:, u::REFINE, v::REFINE], self._size) * kernel
        full = ifft2(total, overwrite_x=True)
        rows, columns = (slice(n, n + m) for n, m in zip(self._first, self._shape, strict=True))
        return np.asarray(full[:, rows, columns])


class Shadow:
    """V^2 - 1 on cells of a wall, V = (U0 + Us) / U0, for an eye that may move.

    blocker: the object.
    frame: of the wall.
    sheet: cells that hold the object's shadow on the sheet.
    wall: cells of the wall.
    height_m: of the sheet over the wall [m].
    frequencies_hz: equidistant, (n_nodes,).
    """

    def __init__(
        self,
        blocker: MeshScene,
        frame: FaceFrame,
        sheet: Lattice,
        wall: Lattice,
        height_m: float,
        frequencies_hz: Floats,
    ) -> None:
        self._blocker, self._frame, self._sheet, self.wall = blocker, frame, sheet, wall
        self.height_m, self.frequencies_hz = height_m, frequencies_hz
        self.center = sheet.positions(height_m).mean(axis=0)
        self._propagator = Propagator(sheet, wall, height_m, frequencies_hz)

    def change(self, eye: Floats) -> NDArray[np.complex64]:
        """V^2 - 1 for a block's middle (3,) [m], (n_cells, n_nodes)."""
        mask = shadow_mask(self._blocker, self._frame, eye, self._sheet, self.height_m)
        there = self._frame.to_local(eye[None])[0]
        out = np.linalg.norm(self._sheet.positions(self.height_m) - there, axis=1)
        sheet = phasors(out.reshape(mask.shape), self.frequencies_hz)
        sheet *= (-mask / out.reshape(mask.shape)).astype(np.float32)
        back = np.linalg.norm(self.wall.positions(0.0) - there, axis=1).reshape(self.wall.shape)
        ratio = self._propagator(sheet)
        ratio *= phasors(-back, self.frequencies_hz) * back.astype(np.float32)
        squared = ratio * (2.0 + ratio)  # (1 + ratio)^2 - 1
        return np.ascontiguousarray(squared.reshape(len(squared), -1).T)

    def displace(self, positions: Floats, eye: Floats) -> Floats:
        """Displacement of the shadow on the wall for other eyes, (n, 3) -> (n, 2) [m].

        All in the wall's frame; for the middle of the sheet. A point of the wall at a moved eye
        corresponds to the oppositely moved point at the original eye.
        """
        share = positions[:, 2:] / (positions[:, 2:] - self.height_m)
        cast = positions[:, :2] + share * (self.center[:2] - positions[:, :2])
        own = eye[:2] + eye[2] / (eye[2] - self.height_m) * (self.center[:2] - eye[:2])
        return np.asarray(cast - own)
