"""Echo of a sphere by the Mie series: metal, plastic, or metal coated with plastic.

Bohren and Huffman, "Absorption and Scattering of Light by Small Particles", eqs. 4.53, 4.74 and
8.2, here with a perfectly conducting core.
"""

import numpy as np
from scipy.special import spherical_jn, spherical_yn


def _riccati(n, x):
    """Values and derivatives of x j_n(x) and -x y_n(x)."""
    j, y = spherical_jn(n, x), spherical_yn(n, x)
    dj, dy = spherical_jn(n, x, derivative=True), spherical_yn(n, x, derivative=True)
    return x * j, j + x * dj, -x * y, -(y + x * dy)


def backscatter_m(k, radius_m, *, permittivity=None, coat_m=None):
    """Complex amplitude S(180 degrees) / k, (n_wave_numbers,) [m]: r / 2 of a large metal sphere.

    k: wave numbers [rad/m]. radius_m: outer. permittivity: of a plastic sphere, or of the coat of a
    metal one with a thickness coat_m; metal where none is given.
    """
    found = []
    for x in np.atleast_1d(k) * radius_m:
        n = np.arange(1, int(x + 4.0 * x ** (1 / 3) + 12))
        psi, dpsi, chi, dchi = _riccati(n, x)
        xi, dxi = psi - 1j * chi, dpsi - 1j * dchi
        if permittivity is None:
            a, b = dpsi / dxi, psi / xi
        else:
            m = np.sqrt(permittivity)
            p, dp, c, dc = _riccati(n, m * x)
            in_a = in_b = np.zeros(len(n))
            if coat_m is not None:
                q, dq, d, dd = _riccati(n, m * x * (1.0 - coat_m / radius_m))
                in_a, in_b = dq / dd, q / d
            u, du = p - in_a * c, dp - in_a * dc
            v, dv = p - in_b * c, dp - in_b * dc
            a = (psi * du - m * dpsi * u) / (xi * du - m * dxi * u)
            b = (m * psi * dv - dpsi * v) / (m * xi * dv - dxi * v)
        found.append(0.5 * np.sum((2 * n + 1) * (-1.0) ** n * (a - b)))
    return np.array(found) / np.atleast_1d(k)


def mie_backscatter_rcs(radius_m, frequency_hz):
    """Monostatic cross-section of a metal sphere [m^2], plane-wave incidence."""
    k = 2.0 * np.pi * frequency_hz / 299792458.0
    return 4.0 * np.pi * abs(backscatter_m(k, radius_m)[0]) ** 2


def front_echo_m(k, amplitudes_m, radius_m, reach_m=0.01):
    """Largest amplitude of the range profile around the front [m], with a Hann window."""
    weight = np.hanning(len(k) + 2)[1:-1]
    ranges = radius_m + np.linspace(-reach_m, reach_m, 201)
    profile = np.exp(2j * np.outer(ranges, k)) @ (weight * amplitudes_m)
    return np.abs(profile).max() / weight.sum()
