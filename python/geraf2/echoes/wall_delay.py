"""Delay of the box's walls: excess path of an echo from inside, and the shifts of their peaks."""

from functools import lru_cache

import numpy as np

from geraf2._types import Floats
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.geometry.boxes import beyond_sides
from geraf2.geometry.triangles import unit_normals
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Wall, Waveform

DELAY_SIGMA_M = 0.001
"""Expected error of a recorded delay, one-way [m]."""
DEGREES_OF_FREEDOM = 4.0
"""Of the Student-t of such an error, and of a wall's echo: some delays are recorded wrongly, and
content and clutter are far outliers."""
UNKNOWN_MIDDLES_M = (0.0025, 0.0015), (-0.0004, 0.0005)
"""Optical middle of a near and of a far wall behind its outer face, each with its standard
deviation [m]. For unknown walls: board of 2 to 7 mm with index 1.2 to 1.4."""
LOSSES_DB = (0.0, 0.45, 0.9)
"""Losses of one pass through cardboard, in addition to the reflection of its faces [dB]."""
_BOARDS_M, _BOARD_INDEX = np.linspace(0.002, 0.007, 201), 1.3
# Step of the search for a wall's peak, two-way [m].
_PATH_STEP_M = 1e-4
PAIR_SHARES = (0.7, 0.8, 0.9, 1.0)
"""Distances of the two echoes of a wall whose faces cancel, over those without loss where the null
is at the middle of the band; it may lie off the middle."""
MIN_WALL_ECHOES = 12
"""Least number of wall echoes of an estimate."""


def box_delay_m(
    scene: MeshScene, walls: tuple[Wall, ...], centers: Floats, directions: Floats, ranges_m: Floats
) -> Floats:
    """Excess one-way path of plane walls between each antenna and its echo, (n,) [m].

    A slab of thickness t and permittivity eps, with incidence angle theta, adds
    t (sqrt(eps - sin^2 theta) - cos theta). All walls have the incidence angle of the prior's
    surface. Inner walls count only if the echo is inside them.

    scene: the prior's outer surface.
    walls: outermost first.
    centers: antenna positions, (n, 3) [m].
    directions: unit vectors to the echoes, (n, 3).
    ranges_m: distances of the echoes, (n,) [m].
    """
    if len(ranges_m) == 0:
        return np.zeros(0)
    entry, face = scene.closest_hit(centers, directions)
    normals = unit_normals(scene.vertices[scene.faces])
    cosine = np.abs(np.einsum("ij,ij->i", directions, normals[np.maximum(face, 0)]))
    entered = (face >= 0) & (entry < ranges_m)
    positions = centers + directions * ranges_m[:, None]
    total = np.zeros(len(ranges_m))
    for number, wall in enumerate(walls):
        excess = wall.thickness_m * (np.sqrt(wall.permittivity - 1.0 + cosine**2) - cosine)
        if number == 0:
            crossed = entered
        else:
            beyond = beyond_sides(positions, wall.center_m, wall.size_m)
            crossed = entered & (beyond <= 0.0).all(axis=1)
        total += np.where(crossed, excess, 0.0)
    return total


def pair_distance_m(waveform: Waveform) -> float:
    """Distance from a wall of its two echoes, if its faces cancel at the middle of the band [m].

    The echo is then proportional to the frequency's distance from the middle.
    """
    frequencies = waveform.frequencies_hz - waveform.frequencies_hz.mean()
    echo = np.hanning(waveform.n_samples + 2)[1:-1] * frequencies
    ranges = np.linspace(0.0, 3.0 * waveform.range_cell_m, 301)
    turns = 2.0 / SPEED_OF_LIGHT_M_PER_S * np.outer(ranges, frequencies)
    return float(ranges[np.abs(np.exp(2j * np.pi * turns) @ echo).argmax()])


def loss_shifts(thickness_m: Floats, index: float, loss_db: float, waveform: Waveform) -> Floats:
    """Distance of the peak of each wall behind the middle of its faces, (n,) [m].

    The faces return 1 - a exp(-j 4 pi f n t / c). a is the amplitude after two passes, (1 - r^2)
    times the loss, and r the reflection of a face.

    thickness_m: (n,) [m]. index: refractive index n of all.
    loss_db: of one pass, in addition to the reflection [dB].
    """
    kept = 1.0 - ((index - 1.0) / (index + 1.0)) ** 2
    amplitude = kept * 10.0 ** (-2.0 * loss_db / 20.0)
    phase_per_m = 2j * np.pi / SPEED_OF_LIGHT_M_PER_S * waveform.frequencies_hz
    half = np.exp(np.outer(phase_per_m, index * np.asarray(thickness_m)))
    echoes = np.hanning(waveform.n_samples + 2)[1:-1, None] * (half - amplitude / half)
    # Faces that cancel leave two lobes, each within two range cells of the middle.
    reach_m = 2.0 * SPEED_OF_LIGHT_M_PER_S / waveform.bandwidth_hz
    beyond = np.arange(-reach_m, reach_m, _PATH_STEP_M)
    best = np.abs(np.exp(np.outer(beyond, phase_per_m)) @ echoes).argmax(axis=0)
    return np.asarray(0.5 * beyond[best])


@lru_cache(maxsize=8)
def _board_shifts(waveform: Waveform) -> Floats:
    """Ascending shifts of the peaks of board of all thicknesses and losses, (n,) [m]."""
    parts = [loss_shifts(_BOARDS_M, _BOARD_INDEX, loss_db, waveform) for loss_db in LOSSES_DB]
    return np.sort(np.concatenate(parts))


def max_shift_m(waveform: Waveform) -> float:
    """Largest distance of the peak of any board before the middle of its faces [m]."""
    return -float(_board_shifts(waveform)[0])


def unknown_shift(offset_m: float, sigma_m: float, waveform: Waveform) -> tuple[float, float]:
    """Median, and half the central 68 %, of the distance of unknown walls' peaks behind the middle.

    All boards are equally likely. The offset is the sum of this distance and of the error of the
    delay, a Student-t of four degrees of freedom.

    offset_m: of the peaks from the typical middle [m]. sigma_m: of the delay, one-way [m].
    """
    shifts = _board_shifts(waveform)
    weights = (1.0 + 0.25 * ((offset_m - shifts) / sigma_m) ** 2) ** -2.5
    shares = (np.cumsum(weights) - 0.5 * weights) / weights.sum()
    low, middle, high = np.interp((0.16, 0.5, 0.84), shares, shifts)
    return float(middle), 0.5 * float(high - low)
