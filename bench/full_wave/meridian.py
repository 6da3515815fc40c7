"""Smooth closed meridians of bodies of revolution, and their meshes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from body import Ring

from geraf2.io.mesh import TriangleMesh

_N_FOURIER = 4096
_FINE = np.linspace(0, 0.5, 4001)


@dataclass(frozen=True, eq=False)
class Meridian:
    """Closed curve rho + i z as a Fourier series of u; u = 0 ... 1/2 leads from pole to pole.

    The body is on the left of that half, which is turned about the z axis.
    """

    orders: np.ndarray
    coefficients: np.ndarray

    @classmethod
    def smoothed(cls, corners_m: Sequence[tuple[float, float]], sigma_m: float) -> "Meridian":
        """From corners (rho, z), rounded by a Gaussian along the curve: it has no edge."""
        corners = np.asarray(corners_m, dtype=float)
        closed = np.concatenate([corners, (corners[::-1] * (-1, 1))[1:]])
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
        at = np.arange(_N_FOURIER) * along[-1] / _N_FOURIER
        curve = np.interp(at, along, closed[:, 0]) + 1j * np.interp(at, along, closed[:, 1])
        orders = np.fft.fftfreq(_N_FOURIER) * _N_FOURIER
        fall = np.exp(-0.5 * (2 * np.pi * orders / along[-1] * sigma_m) ** 2)
        coefficients = np.fft.fft(curve) / _N_FOURIER * fall
        used = np.abs(coefficients) > 1e-16 * np.abs(coefficients).max()
        return cls(orders[used], coefficients[used])

    @classmethod
    def circle(cls, radius_m: float, center_m: float = 0.0) -> "Meridian":
        return cls(np.array([0.0, 1.0]), np.array([1j * center_m, -1j * radius_m]))

    def at(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points rho + i z, and their unit tangents."""
        phases = np.exp(2j * np.pi * np.outer(u, self.orders))
        slope = phases @ (1j * self.orders * self.coefficients)
        return phases @ self.coefficients, slope / np.abs(slope)

    def _lengths(self) -> np.ndarray:
        return np.concatenate([[0.0], np.cumsum(np.abs(np.diff(self.at(_FINE)[0])))])

    @property
    def length_m(self) -> float:
        return float(self._lengths()[-1])

    @property
    def reach_m(self) -> float:
        """Radius of the circumscribed sphere about the origin."""
        return float(np.abs(self.at(_FINE)[0]).max())

    def ring(self, n: int, depth_m: float = 0.0) -> Ring:
        """Points equally spaced along the curve, moved inwards by a depth."""
        lengths = self._lengths()
        share = (np.arange(n) + 0.5) / n
        point, t = self.at(np.interp(share * lengths[-1], lengths, _FINE))
        normal = -1j * t
        point = point - depth_m * normal
        parts = (part for v in (point, t, normal) for part in (v.real, v.imag))
        return Ring(*parts, np.full(n, lengths[-1] / n))

    def mesh(self, edge_m: float) -> TriangleMesh:
        """Triangles with edges of about `edge_m`; their corners lie on the surface."""
        lengths = self._lengths()
        n = int(np.ceil(lengths[-1] / edge_m))
        points, _ = self.at(np.interp(np.linspace(0, lengths[-1], n + 1), lengths, _FINE))
        n_turn = int(np.ceil(2 * np.pi * points.real.max() / edge_m))
        phi = 2 * np.pi * np.arange(n_turn) / n_turn
        rings = np.stack(
            [
                np.outer(points.real[1:-1], np.cos(phi)),
                np.outer(points.real[1:-1], np.sin(phi)),
                np.repeat(points.imag[1:-1, None], n_turn, axis=1),
            ],
            axis=-1,
        ).reshape(-1, 3)
        poles = [[0.0, 0.0, points[0].imag], [0.0, 0.0, points[-1].imag]]
        here = np.arange(n_turn)
        after = (here + 1) % n_turn
        first, last = len(rings), len(rings) + 1
        low = np.arange(n - 2)[:, None] * n_turn
        a, b, c, d = (low + here, low + after, low + n_turn + here, low + n_turn + after)
        end = (n - 2) * n_turn
        faces = np.concatenate(
            [
                np.stack([a, b, d], axis=-1).reshape(-1, 3),
                np.stack([a, d, c], axis=-1).reshape(-1, 3),
                np.stack([np.full(n_turn, first), after, here], axis=1),
                np.stack([np.full(n_turn, last), end + here, end + after], axis=1),
            ]
        )
        return TriangleMesh(vertices=np.concatenate([rings, poles]), faces=faces)


def joined(rings: Sequence[Ring]) -> Ring:
    """Points of several bodies on one axis."""
    return Ring(*(np.concatenate(parts) for parts in zip(*rings, strict=True)))
