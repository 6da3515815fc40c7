"""Waves that a far wall returns to the body: scattered, reflected, scattered again.

What leaves the body towards the wall is a spectrum of plane waves (Devaney and Wolf, J. Math. Phys.
15, 1974), each of which the wall reflects as a plate. Without them a body would cast its shadow
twice, on the waves to the wall and on those back.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from body import Scatterer
from box import plate, split
from echo import BLOCK, Dipoles, Waves
from waves import harmonics

from geraf2.scene import Wall

_REACH, _FULL = np.deg2rad(36.0), np.deg2rad(24.0)
"""Angles to the normal up to which waves are followed, and followed without a taper."""
_STEP = np.deg2rad(1.4)  # phases of the body's field and of its distance turn by 5 rad at most


class Mirror(NamedTuple):
    """A wall's inner face: its normal, along an axis of the body's frame, and its distance."""

    normal: np.ndarray
    distance_m: float
    wall: Wall


class _Spectrum:
    """Directions towards a mirror on a raster of theta and phi, and those that it sends back."""

    def __init__(self, mirror: Mirror) -> None:
        normal = mirror.normal
        flat = abs(normal[2]) < 0.5
        middle = np.arctan2(normal[1], normal[0]) if flat else 0.0
        pole = 0.5 * np.pi if flat else np.arccos(normal[2])
        low, high = max(0.0, pole - _REACH), min(np.pi, pole + _REACH)
        node, weight = np.polynomial.legendre.leggauss(int((high - low) / _STEP) + 24)
        self.theta = 0.5 * (low + high) + 0.5 * (high - low) * node
        reach = _REACH if flat else np.pi
        n_phi = 2 * int(reach / _STEP) // (1 if flat else 2)
        turns = reach * (2 * np.arange(n_phi) + 1 - n_phi) / n_phi
        self.phi = middle + turns
        self.back_theta = self.theta if flat else np.pi - self.theta
        self.back_phi = middle + np.pi - turns if flat else self.phi
        self.sent = _frame(self.theta, self.phi)
        self.returned = _frame(self.back_theta, self.back_phi)
        angle = np.arccos(np.clip(self.sent[0] @ normal, -1, 1))
        taper = np.clip((angle - _FULL) / (_REACH - _FULL), 0, 1)
        area = 0.5 * (high - low) * weight * np.sin(self.theta) * 2 * reach / n_phi
        self.area = area[:, None] * np.cos(0.5 * np.pi * taper) ** 2

    def kernel(self, mirror: Mirror, k: float) -> np.ndarray:
        """Weights of products of both patterns, (theta or phi, theta or phi, n_theta, n_phi)."""
        normal, flat = mirror.normal, (-1, 3)
        cosine = (self.sent[0] @ normal).ravel()
        reflected = plate(np.abs(cosine), mirror.wall, np.array([k]))[0]
        wave = np.exp(2j * k * mirror.distance_m * cosine) * self.area.ravel()
        back = self.returned[0].reshape(flat)
        out = []
        for axis in self.sent[1:]:
            turned = axis.reshape(flat) - 2 * (axis.reshape(flat) @ normal)[:, None] * normal
            field = split(turned[None].astype(complex), back, normal, reflected)[0]
            out.append([(field * to.reshape(flat)).sum(-1) * wave for to in self.returned[1:]])
        return np.array(out).reshape(2, 2, *self.area.shape)


def _frame(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """Unit vectors along r, theta and phi, (3, n_theta, n_phi, 3)."""
    t, p = np.meshgrid(theta, phi, indexing="ij")
    st, ct, sp, cp = np.sin(t), np.cos(t), np.sin(p), np.cos(p)
    parts = [(st * cp, st * sp, ct), (ct * cp, ct * sp, -st), (-sp, cp, 0 * sp)]
    return np.stack([np.stack(part, axis=-1) for part in parts])


def returned(
    scatterers: Sequence[Scatterer], rx: Dipoles, tx: Dipoles, mirrors: Sequence[Mirror]
) -> np.ndarray:
    """Echo by the body, a mirror and the body, (n_mirrors, n_antennas, n_frequencies)."""
    n, n_max = len(rx.positions), scatterers[0].n_max
    out = np.zeros((len(mirrors), n, len(scatterers)), dtype=complex)
    n_modes = max(len(s.blocks) for s in scatterers)
    for number, mirror in enumerate(mirrors):
        spectrum = _Spectrum(mirror)
        to_wall = _Pattern(spectrum.theta, spectrum.phi, n_modes, n_max, 1)
        from_wall = _Pattern(spectrum.back_theta, spectrum.back_phi, n_modes, n_max, -1)
        kernels = [spectrum.kernel(mirror, s.k) for s in scatterers]
        for rows in (slice(i, i + BLOCK) for i in range(0, n, BLOCK)):
            ends = Waves(rx[rows], scatterers), Waves(tx[rows], scatterers)
            for i, s in enumerate(scatterers):
                modes = _signed(len(s.blocks))
                received = from_wall.of([ends[0].mode(m, i) @ s.block(m) for m in modes])
                sent = to_wall.of([ends[1].mode(-m, i) @ s.block(m).T for m in modes])
                for one, two in ((0, 0), (0, 1), (1, 0), (1, 1)):
                    out[number, rows, i] += np.einsum(
                        "cxy,xy,cxy->c", sent[one], kernels[i][one, two], received[two]
                    )
    return out * 8j * np.pi * np.array([s.k for s in scatterers])


def _signed(n_modes: int) -> list[int]:
    return [m * side for m in range(n_modes) for side in ((1, -1) if m else (1,))]


class _Pattern:
    """Far fields of outgoing waves (sign 1), or responses to plane waves (sign -1)."""

    def __init__(
        self, theta: np.ndarray, phi: np.ndarray, n_modes: int, n_max: int, sign: int
    ) -> None:
        self._phi, self._sign, self._waves = phi, sign, []
        for m in range(n_modes):
            f = harmonics(m, n_max, theta)
            power = (-1j * sign) ** f.n
            self._waves.append((1j * sign * f.azimuthal * power, f.polar * power))

    def of(self, coefficients: list[np.ndarray]) -> np.ndarray:
        """Along theta and phi, (2, n, n_theta, n_phi); coefficients of 0, 1, -1, 2, ..."""
        signed, parts = _signed(len(coefficients) // 2 + 1), []
        for m, own in zip(signed, coefficients, strict=True):
            azimuthal, polar = self._waves[abs(m)]
            azimuthal, twist = np.sign(m) * azimuthal, 1j * self._sign
            along = np.concatenate([azimuthal, twist * polar], axis=1)
            across = np.concatenate([-polar, twist * azimuthal], axis=1)
            parts.append([own @ along.T, own @ across.T])
        turns = np.exp(1j * self._sign * np.outer(signed, self._phi))
        return np.tensordot(np.array(parts), turns, axes=(0, 0))
