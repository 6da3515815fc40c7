"""Scattering matrices of bodies of revolution by the method of moments.

Combined sources (Mautz and Harrington, A combined-source solution for radiation and scattering from
a perfectly conducting body, IEEE Trans. Antennas Propag. 27, 1979): an electric current p and a
magnetic one n x p, which radiate outwards and exclude inner resonances. They lie on a surface
inside the body and match the tangential field on it point by point in the least-squares sense
(Leviatan and Boag, IEEE Trans. Antennas Propag. 35, 1987): no integral is singular, the error falls
exponentially, and the residual on the surface measures it for every body. Each azimuthal mode
exp(i m phi) is a system of its own (Mautz and Harrington, Appl. Sci. Res. 20, 1969).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from waves import cylindrical_waves, highest_order, regular_radial

TURN = np.array([-1.0, 1.0])[:, None]
"""n x t = -phi, n x phi = t."""


class Ring(NamedTuple):
    """Points of a meridian with unit tangents and outward normals, each (n,)."""

    rho: np.ndarray
    z: np.ndarray
    t_rho: np.ndarray
    t_z: np.ndarray
    n_rho: np.ndarray
    n_z: np.ndarray
    ds: np.ndarray


@dataclass(frozen=True, eq=False)
class Scatterer:
    """Scattering matrices about the origin at one frequency."""

    k: float
    n_max: int
    blocks: list[np.ndarray]
    """For m = 0, 1, ...: (2 n, 2 n), orders of M before those of N; those not held are zero."""
    residual: float = 0.0
    """Root mean square of the tangential field on the surface over the incident one."""

    def block(self, m: int) -> np.ndarray:
        """Matrix of the mode m; a mirror image changes the sign of what couples M and N."""
        found = self.blocks[abs(m)]
        if m >= 0:
            return found
        sign = np.repeat([1.0, -1.0], len(found) // 2)
        return sign[:, None] * found * sign

    def energy_error(self) -> float:
        """Largest deviation of S = 1 + 2 T from a unitary matrix, over all modes."""
        errors = []
        for block in self.blocks:
            s = np.eye(len(block)) + 2 * block
            errors.append(np.abs(s.conj().T @ s - np.eye(len(s))).max())
        return float(max(errors))


def sphere_scatterer(coefficients: np.ndarray, k: float) -> Scatterer:
    n_max = coefficients.shape[1]
    blocks = [np.diag(coefficients[:, max(1, m) - 1 :].ravel()) for m in range(n_max + 1)]
    return Scatterer(k, n_max, blocks)


def _kernels(at: Ring, source: Ring, k: complex, n_modes: int, n_phi: int) -> np.ndarray:
    """Tangential E of combined sources by mode, (n_modes, 2, n_at, 2, n_source); axes t and phi."""
    phi = np.pi * np.arange(n_phi + 1) / n_phi
    weight = np.full(n_phi + 1, 2 * np.pi / n_phi)
    weight[[0, -1]] /= 2
    turns = np.outer(phi, np.arange(n_modes))
    even, odd = weight[:, None] * np.cos(turns), weight[:, None] * np.sin(turns)
    c, s = np.cos(phi), np.sin(phi)
    out = np.empty((n_modes, 2, at.rho.size, 2, source.rho.size), dtype=complex)
    q = [getattr(source, name)[:, None] for name in Ring._fields]
    rho_s, z_s, tr, tz, nr, nz = q[:6]
    for i in range(at.rho.size):
        rho, dz = at.rho[i], at.z[i] - z_s
        ar, az = at.t_rho[i], at.t_z[i]
        square = (rho - rho_s * c) ** 2 + (rho_s * s) ** 2 + dz**2
        r = np.sqrt(square)
        u = 1 / (k * r)
        g = np.exp(1j * k * r) / (4 * np.pi * r)
        d = g * (1 + 1j * u)
        a = d - g * u**2
        b = (3 * g * u**2 - g - 3j * g * u) / square
        d = d / r
        at_t, at_phi = ar * (rho - rho_s * c) + az * dz, -rho_s * s  # R . t, R . phi
        to_t = tr * (rho * c - rho_s) + tz * dz  # R . t'
        to_phi, to_n = -rho * s, nr * (rho * c - rho_s) + nz * dz
        normal_t, normal_phi = ar * nr * c + az * nz, nr * s  # t . n', phi . n'
        dot_tt, dot_tp, dot_pt = ar * tr * c + az * tz, -ar * s, tr * s
        ad = a + d * to_n
        by_t, by_phi = b * at_t - d * normal_t, b * at_phi - d * normal_phi
        out[:, 0, i, 0] = _transform(ad * dot_tt + by_t * to_t, even)
        out[:, 0, i, 1] = 1j * _transform(ad * dot_tp + by_t * to_phi, odd)
        out[:, 1, i, 0] = 1j * _transform(ad * dot_pt + by_phi * to_t, odd)
        out[:, 1, i, 1] = _transform(ad * c + by_phi * to_phi, even)
    return out


def _transform(values: np.ndarray, waves: np.ndarray) -> np.ndarray:
    return (values.real @ waves + 1j * (values.imag @ waves)).T


def _incident(m: int, at: Ring, k: float, radial: tuple) -> np.ndarray:
    """Tangential field of the regular waves M, N, (2 n_at, 2 n_orders); its curl / k is of N, M."""
    waves = cylindrical_waves(m, at.rho, at.z, k, radial)
    along = [w[..., 0] * at.t_rho[:, None] + w[..., 2] * at.t_z[:, None] for w in waves]
    return np.block([along, [w[..., 1] for w in waves]])


def _radiated(m: int, source: Ring, k: float, radial: tuple) -> np.ndarray:
    """Outgoing waves of the combined sources, (2 n_orders, 2 n_source)."""
    magnetic, electric = cylindrical_waves(-m, source.rho, source.z, k, radial)
    t = np.stack([source.t_rho, 0 * source.rho, source.t_z], axis=-1)[:, None]
    normal = np.stack([source.n_rho, 0 * source.rho, source.n_z], axis=-1)[:, None]
    phi = np.array([0.0, 1.0, 0.0])
    rows = []
    for wave, curl in ((magnetic, electric), (electric, magnetic)):
        parts = [
            (wave * p).sum(-1) + 1j * (curl * np.cross(normal, p)).sum(-1)
            for p in (t, np.broadcast_to(phi, t.shape))
        ]
        rows.append(np.concatenate(parts).T)
    return 2j * np.pi * k * np.concatenate(rows)


def _min_squares(matrix: np.ndarray, incident: np.ndarray) -> tuple[np.ndarray, float]:
    """Amplitudes whose field cancels the incident one, and the energy of the residual."""
    scale = np.linalg.norm(matrix, axis=0)
    scale = np.where(scale > 1e-12 * scale.max(), scale, np.inf)
    q, r = np.linalg.qr(matrix / scale)
    project = q.conj().T @ incident
    is_free = np.abs(np.diag(r)) < 1e-13
    r[is_free, is_free] = 1.0
    project[is_free] = 0.0
    amplitudes = -solve_triangular(r, project) / scale[:, None]
    return amplitudes, float(np.linalg.norm(incident + matrix @ amplitudes) ** 2)


def metal_body(at: Ring, source: Ring, k: float, n_max: int, n_phi: int = 256) -> Scatterer:
    """Scattering matrices of a perfect conductor.

    at: matching points on the surface, more than sources.
    source: points of the sources inside the body.
    n_phi: points of the azimuthal integrals over half a turn.
    """
    at_radial = regular_radial(n_max, k * np.hypot(at.rho, at.z))
    source_radial = regular_radial(n_max, k * np.hypot(source.rho, source.z))
    n_modes = min(n_max, highest_order(k * at.rho.max())) + 1
    fields = _kernels(at, source, k, n_modes, n_phi)
    weight = np.tile(np.sqrt(at.ds * at.rho), 2)[:, None]
    blocks, left, total = [], 0.0, 0.0
    for m in range(n_modes):
        matrix = weight * fields[m].reshape(2 * at.rho.size, -1)
        incident = weight * _incident(m, at, k, at_radial)
        amplitudes, missed = _min_squares(matrix, incident)
        left += missed
        total += float(np.linalg.norm(incident) ** 2)
        blocks.append(_radiated(m, source, k, source_radial) @ amplitudes)
    return Scatterer(k, n_max, blocks, np.sqrt(left / total))


def dielectric_body(
    at: Ring, inside: Ring, outside: Ring, k: float, n_max: int, index: complex, n_phi: int = 256
) -> Scatterer:
    """Scattering matrices of a dielectric, whose inner field has sources of its own outside.

    inside, outside: sources of the outer field, and of the inner one, with normals into the body.
    """
    radial = [regular_radial(n_max, k * np.hypot(ring.rho, ring.z)) for ring in (at, inside)]
    n_modes = min(n_max, highest_order(k * at.rho.max())) + 1
    outer = _kernels(at, inside, k, n_modes, n_phi)
    inner = _kernels(at, outside, index * k, n_modes, n_phi)
    weight, n_at = np.tile(np.sqrt(at.ds * at.rho), 4)[:, None], at.rho.size
    blocks, left, total = [], 0.0, 0.0
    for m in range(n_modes):
        # The curl of a combined source's field is i k times the field of n x p.
        parts = [
            np.concatenate([field, 1j * ratio * side * field[:, :, ::-1] * TURN], axis=0)
            for field, ratio, side in ((outer[m], 1.0, 1.0), (inner[m], index, -1.0))
        ]
        sources = [part.reshape(4 * n_at, -1) for part in parts]
        matrix = weight * np.concatenate([sources[0], -sources[1]], axis=1)
        field = _incident(m, at, k, radial[0])
        n = field.shape[1] // 2
        curl = np.concatenate([field[:, n:], field[:, :n]], axis=1)
        incident = weight * np.concatenate([field, curl])
        amplitudes, missed = _min_squares(matrix, incident)
        left, total = left + missed, total + float(np.linalg.norm(incident) ** 2)
        own = amplitudes[: 2 * inside.rho.size]
        blocks.append(_radiated(m, inside, k, radial[1]) @ own)
    return Scatterer(k, n_max, blocks, np.sqrt(left / total))
