"""Echo of a scatterer between dipoles, from its scattering matrices.

With T of the scatterer and the Green's function of `waves`, the field of a dipole p at r_t that
reaches a dipole q at r_r by the scatterer is i k sum over m of w_m(r_r, q)^T T_m w_-m(r_t, p).
Here w holds the dipole's products with the outgoing waves M and N. It is exact outside the sphere
that circumscribes the scatterer. A unit dipole's direct field is exp(i k r) / r here, so that a mirror
echoes as -exp(2 i k r) / (2 r).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from body import Scatterer
from waves import harmonics, outgoing_radial

_BLOCK = 1024  # antennas at a time; keeps the waves of a block in the cache


@dataclass(frozen=True, eq=False)
class Dipoles:
    """Dipoles at positions in the scatterer's frame [m], with their directions, (n, 3) each."""

    positions: np.ndarray
    directions: np.ndarray

    def __getitem__(self, rows: slice) -> "Dipoles":
        return Dipoles(self.positions[rows], self.directions[rows])

    @property
    def ranges(self) -> np.ndarray:
        return np.linalg.norm(self.positions, axis=1)


class _Angular:
    """What of a dipole's waves of mode m is the same at all frequencies."""

    def __init__(self, at: Dipoles) -> None:
        x, y, z = at.positions.T
        self.theta, self.phi = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
        st, ct, sp, cp = (f(v) for v in (self.theta, self.phi) for f in (np.sin, np.cos))
        self.frame = np.stack(
            [
                np.stack([st * cp, st * sp, ct], axis=1),
                np.stack([ct * cp, ct * sp, -st], axis=1),
                np.stack([-sp, cp, 0 * sp], axis=1),
            ]
        )
        self.p_r, self.p_theta, self.p_phi = (self.frame * at.directions).sum(-1)[..., None]

    def mode(self, m: int, n_max: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        f = harmonics(m, n_max, self.theta)
        turn = np.exp(1j * m * self.phi)[:, None]
        azimuthal = 1j * np.sign(m) * f.azimuthal
        return (
            turn * (self.p_theta * azimuthal - self.p_phi * f.polar),
            turn * (self.p_r * f.radial),
            turn * (self.p_theta * f.polar + self.p_phi * azimuthal),
        )


def echoes(scatterers: Sequence[Scatterer], tx: Dipoles, rx: Dipoles) -> np.ndarray:
    """Echo at each scatterer's frequency, (n_antennas, n_frequencies)."""
    rows = range(0, len(tx.positions), _BLOCK)
    return np.concatenate(
        [_echoes(scatterers, tx[i : i + _BLOCK], rx[i : i + _BLOCK]) for i in rows]
    )


def _echoes(scatterers: Sequence[Scatterer], tx: Dipoles, rx: Dipoles) -> np.ndarray:
    n_max = max(s.n_max for s in scatterers)
    ends = [(_Angular(end), end.ranges) for end in (rx, tx)]
    radial = [[outgoing_radial(s.n_max, s.k * r) for s in scatterers] for _, r in ends]
    out = np.zeros((len(tx.positions), len(scatterers)), dtype=complex)
    for m in range(n_max + 1):
        for signed in (m, -m) if m else (0,):
            modes = [
                end.mode(signed * side, n_max) for (end, _), side in zip(ends, (1, -1), strict=True)
            ]
            for i, s in enumerate(scatterers):
                if m > s.n_max:
                    continue
                n = s.n_max - max(1, m) + 1
                received, sent = (
                    _waves([part[:, :n] for part in mode], values[i], s.k * r, max(1, m))
                    for mode, values, (_, r) in zip(modes, radial, ends, strict=True)
                )
                out[:, i] += np.einsum("an,an->a", received @ s.block(signed), sent)
    return out * 4j * np.pi * np.array([s.k for s in scatterers])


def _waves(mode: list, radial: tuple, x: np.ndarray, first: int) -> np.ndarray:
    h, slope = radial[0][:, first:], radial[1][:, first:]
    magnetic, along, across = mode
    return np.concatenate([h * magnetic, h / x[:, None] * along + slope * across], axis=1)


def nodes(low: float, high: float, n: int) -> np.ndarray:
    """Chebyshev points of an interval."""
    return 0.5 * (low + high) - 0.5 * (high - low) * np.cos(np.pi * (np.arange(n) + 0.5) / n)


def interpolated(
    values: np.ndarray, at: np.ndarray, wanted: np.ndarray, delay: np.ndarray
) -> np.ndarray:
    """Echoes at other wavenumbers: without their mean phase they are smooth.

    values: (n_antennas, n_nodes) at the wavenumbers `at`, Chebyshev points.
    delay: path of the echo of the scatterer's middle, (n_antennas,).
    """
    smooth = values * np.exp(-1j * at * delay[:, None])
    n = len(at)
    weight = (-1.0) ** np.arange(n) * np.sin(np.pi * (np.arange(n) + 0.5) / n)
    apart = wanted[:, None] - at
    apart = np.where(apart == 0, 1e-300, apart)
    share = weight / apart
    share /= share.sum(axis=1, keepdims=True)
    return (smooth @ share.T) * np.exp(1j * wanted * delay[:, None])


def wideband(
    scatterer_at: Callable[[float], Scatterer], wavenumbers: np.ndarray, n_nodes: int
) -> tuple[np.ndarray, list[Scatterer]]:
    """Scatterers at the Chebyshev points of a band."""
    at = nodes(wavenumbers.min(), wavenumbers.max(), n_nodes)
    return at, [scatterer_at(k) for k in at]
