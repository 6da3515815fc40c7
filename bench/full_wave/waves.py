"""Vector spherical waves about an origin, and the scattering matrices of spheres.

Fields are E / (i omega mu I l) with time factor exp(-i omega t). With the orthonormal harmonics
Y_mn = P_n^|m|(cos theta) exp(i m phi), C_mn = curl(r Y_mn) and B_mn = r grad Y_mn, both over
sqrt(n (n + 1)), the waves are M = z_n(kr) C and N = curl M / k (Tai, Dyadic Green Functions, 1994).
z_n is h_n^(1) for outgoing and j_n for regular waves. The dyadic Green's function is
G(r, r') = i k sum over m, n of M_mn(r) M_-mn(r') + N_mn(r) N_-mn(r'), the second of each regular.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import spherical_jn, spherical_yn

C0 = 299792458.0


class Harmonics(NamedTuple):
    """Angular functions of one |m|, n = max(1, |m|) ... n_max; each (n_points, n_orders)."""

    n: np.ndarray
    radial: np.ndarray  # sqrt(n (n + 1)) P
    polar: np.ndarray  # dP / dtheta / sqrt(n (n + 1))
    azimuthal: np.ndarray  # |m| P / sin(theta) / sqrt(n (n + 1))


def highest_order(size: float) -> int:
    """Order above which a body of circumscribed radius `size` / k scatters less than 1e-7."""
    return int(np.ceil(size + 6.0 * max(size, 1.0) ** (1 / 3) + 2))


def harmonics(m: int, n_max: int, theta: np.ndarray) -> Harmonics:
    m = abs(m)
    x, s = np.cos(theta), np.sin(theta)
    first, n = max(1, m), np.arange(max(1, m), n_max + 1)
    # over_s[n] = P_n^m / sin(theta) for m > 0, P_n for m = 0
    over_s = np.zeros((n_max + 2, theta.size))
    k = np.arange(1, m + 1)
    start = np.sqrt((2 * m + 1) / (4 * np.pi) * np.prod((2 * k - 1) / (2 * k)))
    over_s[m] = start * s ** (m - 1) if m else start
    for order in range(m + 1, n_max + 1):
        a = np.sqrt((4.0 * order**2 - 1) / (order**2 - m**2))
        over_s[order] = a * x * over_s[order - 1]
        if order > m + 1:
            b = np.sqrt(((order - 1.0) ** 2 - m**2) / (4.0 * (order - 1) ** 2 - 1))
            over_s[order] -= a * b * over_s[order - 2]
    unit = np.sqrt(n * (n + 1.0))[:, None]
    if m:
        before = np.sqrt((2.0 * n + 1) * (n**2 - m**2) / (2.0 * n - 1))[:, None]
        polar = n[:, None] * x * over_s[first : n_max + 1] - before * over_s[first - 1 : n_max]
        legendre, azimuthal = s * over_s[first : n_max + 1], m * over_s[first : n_max + 1] / unit
    else:
        one = harmonics(1, n_max, theta)  # dP_n^0 / dtheta = -sqrt(n (n + 1)) P_n^1
        polar = -(one.azimuthal.T * unit) * s * unit
        legendre, azimuthal = over_s[1 : n_max + 1], np.zeros((n.size, theta.size))
    return Harmonics(n, (unit * legendre).T, (polar / unit).T, azimuthal.T)


def outgoing_radial(n_max: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """h_n(x) and (x h_n(x))' / x, each (x.size, n_max + 1); upward recurrence is stable."""
    x = np.asarray(x)
    h = np.empty((n_max + 1, x.size), dtype=complex)
    h[0] = -1j * np.exp(1j * x) / x
    h[1] = h[0] * (1 / x - 1j)
    for n in range(1, n_max):
        h[n + 1] = (2 * n + 1) / x * h[n] - h[n - 1]
    d = np.empty_like(h)
    d[0] = 1j * h[0]
    d[1:] = h[:-1] - np.arange(1, n_max + 1)[:, None] * h[1:] / x
    return h.T, d.T


def regular_radial(n_max: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """j_n(x) and (x j_n(x))' / x, each (x.size, n_max + 1)."""
    n, x = np.arange(n_max + 1)[:, None], np.asarray(x)[None]
    j = spherical_jn(n, x)
    return j.T, (j / x + spherical_jn(n, x, derivative=True)).T


def cylindrical_waves(
    m: int, rho: np.ndarray, z: np.ndarray, k: complex, radial: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """M and N at azimuth 0 in components (rho, phi, z), each (n_points, n_orders, 3)."""
    r, theta = np.hypot(rho, z), np.arctan2(rho, z)
    f, first = harmonics(m, radial[0].shape[1] - 1, theta), max(1, abs(m))
    value, slope = radial[0][:, first:], radial[1][:, first:]
    sign = 1j * np.sign(m)
    m_theta, m_phi = sign * f.azimuthal * value, -f.polar * value
    n_r = f.radial * value / (k * r[:, None])
    n_theta, n_phi = f.polar * slope, sign * f.azimuthal * slope
    s, c = np.sin(theta)[:, None], np.cos(theta)[:, None]
    magnetic = np.stack([c * m_theta, m_phi, -s * m_theta], axis=-1)
    electric = np.stack([s * n_r + c * n_theta, n_phi, c * n_r - s * n_theta], axis=-1)
    return magnetic, electric


def sphere(radius: float, k: float, n_max: int, index: complex | None = None) -> np.ndarray:
    """Mie coefficients of the outgoing waves M and N, (2, n_max); metal without an index.

    Scattering matrix of a sphere in free space: Mie (1908), as in Bohren and Huffman (1983).
    """
    n, x = np.arange(1, n_max + 1), k * radius
    j, dj = spherical_jn(n, x), spherical_jn(n, x, derivative=True)
    y, dy = spherical_yn(n, x), spherical_yn(n, x, derivative=True)
    h, dh = j + 1j * y, dj + 1j * dy
    psi, xi, dpsi, dxi = x * j, x * h, j + x * dj, h + x * dh
    if index is None:
        return np.stack([-psi / xi, -dpsi / dxi])
    inside = index * x
    ji, dji = spherical_jn(n, inside), spherical_jn(n, inside, derivative=True)
    psi_i, dpsi_i = inside * ji, ji + inside * dji
    a = (index * psi_i * dpsi - psi * dpsi_i) / (index * psi_i * dxi - xi * dpsi_i)
    b = (psi_i * dpsi - index * psi * dpsi_i) / (psi_i * dxi - index * xi * dpsi_i)
    return np.stack([-b, -a])
