"""Flash of the far wall with a screen before it, by wave optics in one dimension.

Paraxial field from the antenna to the screen, on to the wall, back through the screen, to the
antenna: each leg is an integral over all points of the plane before. The screen blocks twice.
"""

import numpy as np

N_POSITIONS = 1500
HALF_M = 0.27
"""Planes reach this far to both sides; what lies near their ends is faded out."""


def flash(antennas, blocked, screen_m, wall_m, wall_half_m, wavelength_m, depth=np.zeros_like):
    """Field over that of an endless wall without screen, (n_antennas,); distances from antennas.

    depth: how far the wall is towards the antennas at positions along it [m].
    """
    positions = np.linspace(-HALF_M, HALF_M, N_POSITIONS)
    fade = np.exp(-((positions / (0.8 * HALF_M)) ** 8))
    wall = fade * (np.abs(positions) < wall_half_m)
    screen = fade * ~blocked(positions)
    k = 2 * np.pi / wavelength_m
    wall = wall * np.exp(2j * k * depth(positions))
    out = np.exp(-0.5j * k * (antennas[:, None] - positions) ** 2 / screen_m)
    on = np.exp(-0.5j * k * (positions[:, None] - positions) ** 2 / (wall_m - screen_m))

    def through(screen, wall):
        field = (out * screen) @ on * wall
        return ((field @ on) * out * screen).sum(axis=1)

    # An endless wall without screen: the same field at all antennas, as at the middle one.
    middle = np.argmin(np.abs(antennas))
    return through(screen, wall) / through(fade, fade)[middle]


def geometric_flash(
    antennas, blocked, screen_m, wall_m, wall_half_m, wavelength_m, depth=np.zeros_like
):
    """The same where the screen's shadow on the wall is sharp, as simulators draw it."""
    positions = np.linspace(-HALF_M, HALF_M, N_POSITIONS)
    fade = np.exp(-((positions / (0.8 * HALF_M)) ** 8))
    k = 2 * np.pi / wavelength_m
    found = np.empty(len(antennas), dtype=complex)
    for number, antenna in enumerate(antennas):
        wave = (
            np.exp(-1j * k * ((antenna - positions) ** 2 / wall_m - 2.0 * depth(positions))) * fade
        )
        lit = ~blocked(antenna + (positions - antenna) * screen_m / wall_m)
        found[number] = (wave * lit * (np.abs(positions) < wall_half_m)).sum()
    middle = np.argmin(np.abs(antennas))
    endless = (np.exp(-1j * k * (antennas[middle] - positions) ** 2 / wall_m) * fade).sum()
    return found / endless
