"""How much each specular return reflects, against metal (docs/math/echoes.md#reflectivity).

Amplitudes have no unit of their own, so the flashes of the box's walls are the reference: their
permittivity and thickness give their reflection.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from geraf2._types import Array, Bools, Floats, Ints
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.echoes.flashes import WallMiddles, find_flashes
from geraf2.echoes.wall_delay import MIN_WALL_ECHOES
from geraf2.echoes.wall_faces import WallFaces
from geraf2.imaging.peaks import PeakSet
from geraf2.scene import LosPrior, Wall, Waveform
from geraf2.scene.aperture import Aperture

LARGEST_TILT_RAD = 0.35
"""Returns farther off a plane's boresight are left out: antennas radiate less there [rad]."""
_WALL_ROOM_M = 0.025
"""Wall around the foot of a flash, for all of its first Fresnel zone [m]."""
_FAINTEST = 0.01
"""Least reflection of a wall that is a reference: fainter ones depend on tenths of a millimetre."""
_THICKNESS_SHARE = 0.02
"""Standard uncertainty of a stated wall thickness, as a share of it."""
_NEAREST_FOCUS_M = 0.01
"""Least range of a focus [m]: a nearer plane faces across the content, or lies in it."""
_N_STEPS = 17
"""Points along each side of a sub-aperture in the sum over its window, and ranges at which the echo
of both faces of a wall is evaluated."""


def db(ratio: Floats) -> Floats:
    """Ratio of amplitudes in decibels."""
    return np.asarray(20.0 * np.log10(np.maximum(ratio, 1e-30)))


def spreading(range_m: Floats, curvature: Floats) -> Floats:
    """Amplitude of the specular return of metal at a monostatic antenna, (n,) [1/m].

        1 / (2 R sqrt((1 + R / r1) (1 + R / r2)))

    r1, r2 the principal radii, positive where convex: 1 / (2 R) of a plane, r / (2 R^2) of a small
    sphere. NaN at and beyond a caustic.

    range_m: distance R, (n,) [m]. curvature: shape operator in the frame, (n, 3, 3) [1/m].
    """
    bent = np.linalg.det(np.eye(3) + range_m[:, None, None] * curvature)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(bent > 0.0, 0.5 / (range_m * np.sqrt(bent)), np.nan))


class Windows(NamedTuple):
    """Sub-apertures from which returns were seen."""

    axes: Floats
    """Rows boresight, horizontal and vertical of each one's plane, (n, 3, 3)."""
    sides_m: Floats
    """Width and height, (n, 2) [m]."""
    focus_m: Floats
    """Range at which it is focused, (n,) [m]."""

    @classmethod
    def of(
        cls,
        apertures: Sequence[Aperture],
        planes: Ints,
        centers: Floats,
        prior: LosPrior,
        size_m: float,
    ) -> "Windows":
        """Sub-apertures of a size [m] of planes (n,), with middles (n, 3) [m]."""
        axes = np.stack([aperture.axes for aperture in apertures])[planes]
        sides = np.stack([2.0 * aperture.half_m for aperture in apertures])[planes]
        ahead = np.einsum("ij,ij->i", prior.bounds.mean(axis=0) - centers, axes[:, 0])
        return cls(axes, np.minimum(sides, size_m), np.maximum(np.abs(ahead), _NEAREST_FOCUS_M))


def window_gain(windows: Windows, range_m: Floats, curvature: Floats, wave_number: float) -> Floats:
    """Share of the amplitude that the focus of a sub-aperture keeps, (n,), 0 to 1.

        |sum_x w(x) exp(j k (|x|^2 / F - x^T S (1 + R S)^-1 x))| / sum_x w(x)

    w is the Hann window, F the focus, S the shape operator: the distance to the surface has the
    second derivatives S (1 + R S)^-1.

    range_m: distance R of each return, (n,) [m]. curvature: S in the frame, (n, 3, 3) [1/m].
    wave_number: k at mid-band [rad/m].
    """
    steps = (np.arange(_N_STEPS) + 0.5) / _N_STEPS - 0.5
    hann = np.cos(np.pi * steps) ** 2
    weight = np.outer(hann, hann).ravel()
    at = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    hessian = curvature @ np.linalg.inv(np.eye(3) + range_m[:, None, None] * curvature)
    across = windows.axes[:, 1:]
    bend = across @ hessian @ across.transpose(0, 2, 1)
    bend = np.eye(2) / windows.focus_m[:, None, None] - bend
    bend = bend * windows.sides_m[:, :, None] * windows.sides_m[:, None, :]
    phase = wave_number * np.einsum("pi,nij,pj->np", at, bend, at)
    return np.asarray(np.abs(np.exp(1j * phase) @ weight) / weight.sum())


def face_reflection(permittivity: float) -> float:
    """Fresnel's reflection of one face at normal incidence, (1 - n) / (1 + n)."""
    index = float(np.sqrt(permittivity))
    return (1.0 - index) / (1.0 + index)


def slab_reflection(wall: Wall, frequencies_hz: Floats) -> Array:
    """Reflection of a plate at normal incidence, r (1 - E) / (1 - r^2 E), (n_frequencies,).

    E = exp(-2 j k n t). Refers to its outer face.
    """
    r = face_reflection(wall.permittivity)
    k = 2.0 * np.pi * frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    turn = np.exp(-2j * k * np.sqrt(wall.permittivity) * wall.thickness_m)
    return np.asarray(r * (1.0 - turn) / (1.0 - r**2 * turn))


def wall_flash(wall: Wall, waveform: Waveform, thickness_share: float = 1.0) -> float:
    """Largest amplitude over range of a wall's echo against that of metal: both faces are one peak.

    thickness_share: of the stated thickness.
    """
    f = waveform.start_frequency_hz + np.linspace(0.0, waveform.bandwidth_hz, 64)
    weight = np.hanning(len(f) + 2)[1:-1]
    reach = np.sqrt(wall.permittivity) * wall.thickness_m
    ranges = np.linspace(-reach, 2.0 * reach, _N_STEPS)
    turns = np.exp(4j * np.pi * np.outer(ranges, f) / SPEED_OF_LIGHT_M_PER_S)
    real = Wall(
        size_m=wall.size_m,
        thickness_m=thickness_share * wall.thickness_m,
        permittivity=wall.permittivity,
    )
    echo = turns @ (weight * slab_reflection(real, f))
    return float(np.abs(echo).max() / weight.sum())


@dataclass(frozen=True, kw_only=True)
class MetalLevel:
    """Strength of metal on the scale of a capture's magnitudes."""

    strength_m: float
    """Magnitude of a return of metal over its `spreading` and `window_gain` [m]."""
    sigma_db: float
    """Standard uncertainty [dB]."""
    n_flashes: int
    """Flashes of walls that it rests on."""

    def numbers(self) -> dict[str, float]:
        """For run.json."""
        return {
            "metal_strength_m": self.strength_m,
            "metal_strength_sigma_db": round(self.sigma_db, 2),
            "n_wall_flashes": self.n_flashes,
        }


def metal_level(
    peaks: PeakSet,
    windows: Windows,
    faces: WallFaces,
    walls: Sequence[Wall],
    waveform: Waveform,
) -> MetalLevel | None:
    """Strength of metal by the flashes of the near walls; None where too few or too faint.

    peaks: all peaks. windows: their sub-apertures. faces: outside of the box.
    """
    if not walls or not len(peaks):
        return None
    middles = WallMiddles.of(tuple(walls), waveform)
    seen = squarely_seen_walls(peaks, windows, faces, middles)
    if int(seen.sum()) < MIN_WALL_ECHOES:
        return None
    flat, wave_number = np.zeros((int(seen.sum()), 3, 3)), mid_wave_number(waveform)
    few = Windows(*(column[seen] for column in windows))
    found = peaks.select(seen)
    metal = spreading(found.ranges_m, flat) * window_gain(few, found.ranges_m, flat, wave_number)
    shares = [1.0 - _THICKNESS_SHARE, 1.0, 1.0 + _THICKNESS_SHARE]
    flash = np.array([wall_flash(walls[0], waveform, share) for share in shares])
    if not flash.min() > _FAINTEST:
        return None
    levels = db(found.magnitudes / metal)
    level, spread = (
        float(np.median(levels)),
        1.4826 * float(np.median(np.abs(levels - np.median(levels)))),
    )
    by_thickness = 0.5 * float(np.ptp(db(flash)))
    return MetalLevel(
        strength_m=10.0 ** (level / 20.0) / float(flash[1]),
        sigma_db=float(np.hypot(spread / len(levels) ** 0.25, by_thickness)),
        n_flashes=len(levels),
    )


def squarely_seen_walls(
    peaks: PeakSet, windows: Windows, faces: WallFaces, middles: WallMiddles
) -> Bools:
    """Whether each peak is the flash of a near wall with enough of the wall around it, (n,)."""
    found = find_flashes(peaks, faces, middles)
    feet = (
        peaks.centers[found.index]
        + peaks.ranges_m[found.index, None] * peaks.directions[found.index]
    )
    inner = 1.0 - np.abs(faces.coordinates(found.walls, feet))
    room = inner / np.linalg.norm(faces.across[found.walls], axis=2) > _WALL_ROOM_M
    seen = np.zeros(len(peaks), dtype=bool)
    seen[found.index[(found.far == 0) & room.all(axis=1)]] = True
    return np.asarray(seen & squarely(windows, peaks.directions))


def squarely(windows: Windows, directions: Floats) -> Bools:
    """Whether directions, (n, 3), are near the boresights of planes with a focus, (n,)."""
    cosine = np.abs(np.einsum("ij,ij->i", windows.axes[:, 0], directions))
    has_focus = windows.focus_m > _NEAREST_FOCUS_M
    return np.asarray(has_focus & (cosine > np.cos(LARGEST_TILT_RAD)))


def mid_wave_number(waveform: Waveform) -> float:
    """Wave number at mid-band [rad/m]."""
    return 2.0 * float(np.pi) / waveform.center_wavelength_m


def crossing_loss(walls: Sequence[Wall]) -> float:
    """Amplitude that two crossings of all walls keep at normal incidence, 0 to 1.

    Both faces of a wall transmit 1 - r^2.
    """
    shares = [1.0 - face_reflection(wall.permittivity) ** 2 for wall in walls]
    return float(np.prod(shares)) ** 2
