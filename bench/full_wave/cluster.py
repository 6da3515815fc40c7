"""Clusters of spheres anywhere: exact multiple scattering.

Each sphere has its Mie coefficients about its own middle, and what leaves the others is expanded
there in regular waves (Foldy and Lax's equations; Waterman, Symmetry, unitarity, and geometry in
electromagnetic scattering, Phys. Rev. D 3, 1971). The expansion is a projection on the sphere's
surface: of the field and of its curl, so that no radius is a zero of the regular waves.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from body import Scatterer
from echo import BLOCK, Dipoles, Waves
from meridian import Meridian
from waves import C0, cylindrical_waves, harmonics, outgoing_radial, regular_radial, sphere

from geraf2.io.mesh import TriangleMesh
from geraf2.scene import Wall

_SHORTEST_M = C0 / 81e9
_TRUTH_EDGE_M = 0.0008


class Ball(NamedTuple):
    radius_m: float
    middle_m: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Cluster:
    """Spheres that do not touch."""

    balls: tuple[Ball, ...]
    permittivity: complex | None = None
    """Relative; metal when None."""
    symmetry: int = 1
    """So many turns about the vertical change nothing."""
    n_nodes: int = 8
    """Frequencies that are computed; the others are interpolated."""
    box: Wall | None = field(default=None, init=False)
    turn: np.ndarray = field(default_factory=lambda: np.eye(3), init=False)

    @property
    def alike_deg(self) -> float:
        """Turns about the vertical by multiples of it change nothing."""
        return 360.0 / self.symmetry

    def mesh(self) -> TriangleMesh:
        parts = [(Meridian.circle(ball.radius_m).mesh(_TRUTH_EDGE_M), ball) for ball in self.balls]
        return TriangleMesh.joined(
            [
                TriangleMesh(vertices=mesh.vertices + ball.middle_m, faces=mesh.faces)
                for mesh, ball in parts
            ]
        )

    def scatterer(self, k: float) -> "ClusterScatterer":
        index = None if self.permittivity is None else np.sqrt(self.permittivity)
        sizes = [2 * np.pi / _SHORTEST_M * ball.radius_m for ball in self.balls]
        # Coupling at gaps of half a radius is then right to 1e-5 (tests/full_wave/test_cluster.py).
        orders = [int(np.ceil(size + 2.5 * size ** (1 / 3) + 1)) for size in sizes]
        return cluster(self.balls, orders, k, index)


@dataclass(frozen=True, eq=False)
class ClusterScatterer:
    """Outgoing waves of all spheres by the regular waves at all of them, at one frequency."""

    k: float
    balls: tuple[Ball, ...]
    orders: list[int]
    matrix: np.ndarray

    @property
    def residual(self) -> float:
        """Deviation from reciprocity over the largest entry; truncation shows in it."""
        flip = np.concatenate([_flipped(n) for n in self.orders])
        starts = np.cumsum([0, *(2 * n * (n + 2) for n in self.orders)])[:-1]
        flip += np.repeat(starts, [2 * n * (n + 2) for n in self.orders])
        turned = self.matrix[:, flip]
        return float(np.abs(turned - turned.T).max() / np.abs(turned).max())


def _modes(n_max: int) -> list[tuple[int, slice]]:
    """Azimuthal orders and where their waves are: M before N."""
    found, first = [], 0
    for m in range(-n_max, n_max + 1):
        n = 2 * (n_max - max(1, abs(m)) + 1)
        found.append((m, slice(first, first + n)))
        first += n
    return found


def _flipped(n_max: int) -> np.ndarray:
    """Where the wave of the opposite azimuthal order is."""
    modes = _modes(n_max)
    return np.concatenate([np.arange(rows.start, rows.stop) for _, rows in modes[::-1]])


def _kinds(n_max: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Indices of the waves M and of the waves N, and the order n of each of them."""
    magnetic, orders = [], []
    for m, rows in _modes(n_max):
        half = (rows.stop - rows.start) // 2
        magnetic.append(np.arange(rows.start, rows.start + half))
        orders.append(np.arange(max(1, abs(m)), n_max + 1))
    ends = [m + len(m) for m in magnetic]
    return np.concatenate(magnetic), np.concatenate(ends), np.concatenate(orders)


def _fields(points: np.ndarray, n_max: int, k: float) -> tuple[np.ndarray, np.ndarray]:
    """Outgoing M and N at points about the sphere's middle, (n_points, n_waves / 2, 3) each."""
    rho, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
    phi = np.arctan2(points[:, 1], points[:, 0])
    radial = outgoing_radial(n_max, k * np.hypot(rho, z))
    c, s = np.cos(phi)[:, None], np.sin(phi)[:, None]
    found: tuple[list, list] = ([], [])
    for m in range(-n_max, n_max + 1):
        turn = np.exp(1j * m * phi)[:, None]
        for waves, to in zip(cylindrical_waves(m, rho, z, k, radial), found, strict=True):
            r, p, up = (turn * waves[..., i] for i in range(3))
            to.append(np.stack([c * r - s * p, s * r + c * p, up], axis=-1))
    return np.concatenate(found[0], axis=1), np.concatenate(found[1], axis=1)


class _Surface:
    """Quadrature on a sphere, and its vector spherical harmonics C and B there."""

    def __init__(self, n_max: int) -> None:
        cosine, weight = np.polynomial.legendre.leggauss(n_max + 6)
        turns = 2 * np.pi * np.arange(2 * n_max + 12) / (2 * n_max + 12)
        theta, phi = (v.ravel() for v in np.meshgrid(np.arccos(cosine), turns, indexing="ij"))
        area = np.repeat(weight * turns[1], len(turns))[:, None, None]
        st, ct, sp, cp = np.sin(theta), np.cos(theta), np.sin(phi), np.cos(phi)
        self.unit = np.stack([st * cp, st * sp, ct], axis=-1)
        along = np.stack([ct * cp, ct * sp, -st], axis=-1)[:, None]
        across = np.stack([-sp, cp, 0 * sp], axis=-1)[:, None]
        self.c, self.b = [], []
        for m in range(-n_max, n_max + 1):
            f, turn = harmonics(m, n_max, theta), np.exp(1j * m * phi)[:, None]
            azimuthal, polar = (turn * v for v in (1j * np.sign(m) * f.azimuthal, f.polar))
            self.c.append(azimuthal[..., None] * along - polar[..., None] * across)
            self.b.append(polar[..., None] * along + azimuthal[..., None] * across)
        self.c, self.b = (
            (np.concatenate(v, axis=1) * area).conj().swapaxes(0, 1) for v in (self.c, self.b)
        )


def _coupling(surface: _Surface, here: Ball, n: int, there: Ball, n_there: int, k: float):
    """Regular waves at a sphere by outgoing waves of another one, (n_waves, n_waves_there)."""
    shift = np.subtract(here.middle_m, there.middle_m)
    fields = _fields(here.radius_m * surface.unit + shift, n_there, k)
    magnetic, electric, orders = _kinds(n)
    (j, slope) = (v[0, orders, None] for v in regular_radial(n, np.array([k * here.radius_m])))
    size = j**2 + slope**2
    # Of M and N, along C and along B; the curl of M is k N, and of N is k M.
    by_c, by_b = (
        [np.tensordot(on, f, ((1, 2), (0, 2))) for f in fields] for on in (surface.c, surface.b)
    )
    out = np.empty((2 * len(orders), 2 * n_there * (n_there + 2)), dtype=complex)
    from_m, from_n, _ = _kinds(n_there)
    for columns, own, curl in ((from_m, 0, 1), (from_n, 1, 0)):
        out[np.ix_(magnetic, columns)] = (j * by_c[own] + slope * by_b[curl]) / size
        out[np.ix_(electric, columns)] = (slope * by_b[own] + j * by_c[curl]) / size
    return out


def cluster(
    balls: Sequence[Ball], orders: Sequence[int], k: float, index: complex | None = None
) -> ClusterScatterer:
    """Scatterer of spheres, each with waves up to an order of its own."""
    own = []
    for ball, n_max in zip(balls, orders, strict=True):
        magnetic, electric, n = _kinds(n_max)
        values, mie = np.empty(2 * len(n), dtype=complex), sphere(ball.radius_m, k, n_max, index)
        values[magnetic], values[electric] = mie[0, n - 1], mie[1, n - 1]
        own.append(values)
    surfaces = {n: _Surface(n) for n in set(orders)}
    rows = []
    for i, (ball, n) in enumerate(zip(balls, orders, strict=True)):
        row = [
            np.eye(len(own[i]))
            if i == j
            else -own[i][:, None] * _coupling(surfaces[n], ball, n, other, orders[j], k)
            for j, other in enumerate(balls)
        ]
        rows.append(np.concatenate(row, axis=1))
    matrix = np.linalg.solve(np.concatenate(rows), np.diag(np.concatenate(own)))
    return ClusterScatterer(k, tuple(balls), list(orders), matrix)


def cluster_echoes(
    scatterers: Sequence[ClusterScatterer], rx: Sequence[Dipoles], tx: Sequence[Dipoles]
) -> np.ndarray:
    """As `echo.echoes`, of one path: (1, 1, n_antennas, n_frequencies)."""
    ((received,), (sent,)), balls = (rx, tx), scatterers[0].balls
    n, orders = len(received.positions), scatterers[0].orders
    starts = np.cumsum([0, *(2 * order * (order + 2) for order in orders)])
    out = np.empty((n, len(scatterers)), dtype=complex)
    # Noise of the captures is 1e-1, rounding of floats 1e-6.
    matrices = [s.matrix.astype(np.complex64) for s in scatterers]
    for rows in (slice(i, i + BLOCK) for i in range(0, n, BLOCK)):
        size = (len(scatterers), len(received.positions[rows]), starts[-1])
        waves = np.empty((2, *size), dtype=np.complex64)
        for ball, order, start in zip(balls, orders, starts[:-1], strict=True):
            alike = [Scatterer(s.k, order, []) for s in scatterers]
            for side, (end, sign) in enumerate(((received, 1), (sent, -1))):
                moments = np.broadcast_to(end.directions, (len(alike), *end.positions.shape))
                at = Dipoles(end.positions[rows] - ball.middle_m, moments[:, rows])
                found = Waves(at, alike)
                for m, columns in sorted(_modes(order), key=lambda mode: abs(mode[0])):
                    to = slice(start + columns.start, start + columns.stop)
                    for i in range(len(alike)):
                        waves[side, i, :, to] = found.mode(sign * m, i)
        for i, matrix in enumerate(matrices):
            out[rows, i] = np.einsum("an,an->a", waves[0, i] @ matrix, waves[1, i])
    return (out * 4j * np.pi * np.array([s.k for s in scatterers]))[None, None]
