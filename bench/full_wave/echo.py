"""Echo of a scatterer between dipoles, from its scattering matrices.

With T of the scatterer and the Green's function of `waves`, the field of a dipole p at r_t that
reaches a dipole q at r_r by the scatterer is i k sum over m of w_m(r_r, q)^T T_m w_-m(r_t, p).
Here w holds the dipole's products with the outgoing waves M and N. It is exact outside the sphere
that circumscribes the scatterer. A unit dipole's direct field is exp(i k r) / r here, so that a
mirror echoes as -exp(2 i k r) / (2 r).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from body import Scatterer
from waves import Harmonics, harmonics, outgoing_radial

BLOCK = 256  # antennas at a time; keeps the waves of a block in the cache


@dataclass(frozen=True, eq=False)
class Dipoles:
    """Dipoles in the scatterer's frame."""

    positions: np.ndarray
    """(n, 3) [m]."""
    directions: np.ndarray
    """Moments, (n, 3), or by wavenumber, (n_k, n, 3)."""

    def __getitem__(self, rows: slice) -> "Dipoles":
        return Dipoles(self.positions[rows], self.directions[..., rows, :])

    @property
    def ranges(self) -> np.ndarray:
        return np.linalg.norm(self.positions, axis=1)


class Waves:
    """Products of dipoles with the outgoing waves of each frequency, mode by mode."""

    def __init__(self, at: Dipoles, scatterers: Sequence[Scatterer]) -> None:
        self._n_max = [s.n_max for s in scatterers]
        x, y, z = at.positions.T
        self._theta, self._phi = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
        st, ct, sp, cp = (f(v) for v in (self._theta, self._phi) for f in (np.sin, np.cos))
        frame = ((st * cp, st * sp, ct), (ct * cp, ct * sp, -st), (-sp, cp, 0 * sp))
        moments = np.broadcast_to(at.directions, (len(scatterers), *at.positions.shape))
        self._parts = [(moments * np.stack(axis, axis=1)).sum(-1)[..., None] for axis in frame]
        self._radial = [outgoing_radial(s.n_max, s.k * at.ranges) for s in scatterers]
        self._over_x = [
            h / (s.k * at.ranges[:, None])
            for s, (h, _) in zip(scatterers, self._radial, strict=True)
        ]
        self._known: tuple[int, Harmonics | None] = (-1, None)

    def mode(self, m: int, i: int) -> np.ndarray:
        """(n_antennas, 2 n_orders) of the mode m at frequency i."""
        first = max(1, abs(m))
        if self._known[0] != abs(m):
            self._known = abs(m), harmonics(m, max(self._n_max), self._theta)
        f, n = self._known[1], self._n_max[i] - first + 1
        h, slope = (part[:, first:] for part in self._radial[i])
        turn = np.exp(1j * m * self._phi)[:, None]
        along, theta, phi = (turn * part[i] for part in self._parts)
        polar, azimuthal, sign = f.polar[:, :n], f.azimuthal[:, :n], 1j * np.sign(m)
        out = np.empty((len(turn), 2 * n), dtype=complex)
        out[:, :n] = h * (sign * theta * azimuthal - phi * polar)
        out[:, n:] = slope * (theta * polar + sign * phi * azimuthal)
        out[:, n:] += self._over_x[i][:, first:] * (along * f.radial[:, :n])
        return out


def echoes(
    scatterers: Sequence[Scatterer], rx: Sequence[Dipoles], tx: Sequence[Dipoles]
) -> np.ndarray:
    """Echo at each scatterer's frequency, (n_rx_paths, n_tx_paths, n_antennas, n_frequencies).

    rx, tx: the antennas; where waves take several paths, images of them for each path.
    """
    n = len(rx[0].positions)
    blocks = [slice(i, i + BLOCK) for i in range(0, n, BLOCK)]
    parts = [
        _echoes(scatterers, [leg[rows] for leg in rx], [leg[rows] for leg in tx]) for rows in blocks
    ]
    return np.concatenate(parts, axis=2)


def _echoes(
    scatterers: Sequence[Scatterer], rx: Sequence[Dipoles], tx: Sequence[Dipoles]
) -> np.ndarray:
    received, sent = ([Waves(leg, scatterers) for leg in end] for end in (rx, tx))
    out = np.zeros((len(rx), len(tx), len(rx[0].positions), len(scatterers)), dtype=complex)
    for m in range(max(len(s.blocks) for s in scatterers)):
        for signed in (m, -m) if m else (0,):
            for i, s in enumerate(scatterers):
                if m < len(s.blocks):
                    of_tx = [leg.mode(-signed, i) for leg in sent]
                    for one, leg in enumerate(received):
                        scattered = leg.mode(signed, i) @ s.block(signed)
                        for two, waves in enumerate(of_tx):
                            out[one, two, :, i] += np.einsum("an,an->a", scattered, waves)
    return out * 4j * np.pi * np.array([s.k for s in scatterers])


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
    n = len(at)
    weight = (-1.0) ** np.arange(n) * np.sin(np.pi * (np.arange(n) + 0.5) / n)
    apart = wanted[:, None] - at
    share = weight / np.where(apart == 0, 1e-300, apart)
    share /= share.sum(axis=1, keepdims=True)
    smooth = values * np.exp(-1j * at * delay[:, None])
    return (smooth @ share.T) * np.exp(1j * wanted * delay[:, None])
