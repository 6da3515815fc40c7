"""A scan before it is made: spacing, standoff, planes, elevations, time, and what it will see."""

from dataclasses import asdict, dataclass

import numpy as np

from geraf2._types import Floats
from geraf2._validation import require_each, require_positive
from geraf2.records import Waveform
from geraf2.scene.aperture import Aperture

# Free air between the corner of the turning box and the radar: room for a gripper and a cable.
_CLEARANCE_M = 0.2
# At 2.5 times the box's radius its echoes come from within 24 degrees: antennas may then stand
# 2.5 times as far apart as for a scene that fills the half space.
_RADII_AWAY = 2.5
# Every normal is seen from two neighbouring planes: they confirm each other.
_OVERLAP = 2.0


@dataclass(frozen=True, kw_only=True)
class Raster:
    """A plane that a radar scans row by row."""

    waveform: Waveform
    aperture_m: tuple[float, float]
    """Width and height of a plane [m]."""
    spacing_m: float
    """Antennas along rows and columns [m]."""
    frame_period_s: float = 3e-3
    """From one recording to the next [s]."""
    speed_m_per_s: float = 0.2
    """Of the radar along a row [m/s]."""

    def __post_init__(self) -> None:
        require_each(require_positive, self, "spacing_m", "frame_period_s", "speed_m_per_s")
        for value in self.aperture_m:
            require_positive("aperture_m", value)

    @property
    def rows_columns(self) -> tuple[int, int]:
        """Rows and columns of a plane."""
        return rows_columns(self.aperture_m, self.spacing_m)

    @property
    def n_antennas(self) -> int:
        """Of the whole scan."""
        rows, columns = self.rows_columns
        return rows * columns

    @property
    def n_bytes(self) -> int:
        """Samples of the whole scan, complex64."""
        return 8 * self.waveform.n_samples * self.n_antennas

    def numbers(self) -> dict[str, object]:
        """List settings and what follows from them, by name in SI units, for `--json`."""
        found = {"n_antennas": self.n_antennas, "n_bytes": self.n_bytes, "seconds": self.seconds}
        return {**asdict(self), **found}

    @property
    def seconds(self) -> float:
        """Time of a plane: rows at the speed or the frame rate that is slower [s]."""
        rows, columns = self.rows_columns
        return rows * max(self.aperture_m[0] / self.speed_m_per_s, columns * self.frame_period_s)


@dataclass(frozen=True, kw_only=True)
class ScanPlan(Raster):
    """Planes of antennas around a turntable, in rings of equal elevation."""

    box_m: tuple[float, float, float]
    """Outer sides of the box; z is the axis of the turntable [m]."""
    standoff_m: float
    """Plane to the middle of the box [m]."""
    n_planes: int
    """Of each ring."""
    elevations_deg: tuple[float, ...]
    """Of the planes' middles above the horizontal, one a ring [degrees]."""
    turn_s: float = 3.0
    """From one plane to the next [s]."""
    height_m: float = 0.0
    """What the planes look at, above the middle of the box [m]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_each(require_positive, self, "standoff_m", "n_planes", "turn_s")
        for value in self.box_m:
            require_positive("box_m", value)
        if not self.elevations_deg or not (np.abs(self.elevations_deg) < 90.0).all():
            msg = f"elevations_deg must lie between -90 and 90, got {self.elevations_deg}"
            raise ValueError(msg)

    @property
    def n_antennas(self) -> int:
        """Of the whole scan."""
        return super().n_antennas * self.n_planes * len(self.elevations_deg)

    @property
    def seconds(self) -> float:
        """Time of the scan with its turns [s]."""
        return self.n_planes * len(self.elevations_deg) * (super().seconds + self.turn_s)

    @property
    def farthest_m(self) -> float:
        """Largest one-way range of the box's echoes, half of the instrument delay included [m]."""
        corner = 0.5 * float(np.linalg.norm(self.box_m))
        edge = 0.5 * float(np.linalg.norm(self.aperture_m))
        across = float(np.hypot(self.standoff_m + corner, edge))
        return across + 0.5 * self.waveform.path_bias_m

    @property
    def apertures(self) -> list[Aperture]:
        """Rectangles that the antennas of every plane cover."""
        half = 0.5 * np.asarray(self.aperture_m)
        return [
            plane_at(azimuth, elevation, self.standoff_m, half, self.height_m)
            for elevation in np.deg2rad(self.elevations_deg)
            for azimuth in 2.0 * np.pi * np.arange(self.n_planes) / self.n_planes
        ]


def plane_at(
    azimuth: float, elevation: float, standoff_m: float, half_m: Floats, height_m: float = 0.0
) -> Aperture:
    """Plane that looks at a height on the z axis from a direction [rad].

    half_m: half its width and height, (2,) [m].
    """
    flat, up = np.array([np.cos(azimuth), np.sin(azimuth), 0.0]), np.array([0.0, 0.0, 1.0])
    outward = np.cos(elevation) * flat + np.sin(elevation) * up
    vertical = np.cos(elevation) * up - np.sin(elevation) * flat
    horizontal = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])  # right-handed: a rotation
    axes = np.stack([-outward, horizontal, vertical])
    return Aperture.from_rectangle(standoff_m * outward + height_m * up, axes, half_m)


@dataclass(frozen=True, kw_only=True)
class PlanePlan(Raster):
    """A single plane of antennas without a box, and what it resolves at one depth."""

    depth_m: float
    """From the antennas to what is looked at [m]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive("depth_m", self.depth_m)

    @property
    def across_m(self) -> tuple[float, float]:
        """Resolution horizontally and vertically, lambda z / (2 D), >= lambda / 4 [m]."""
        wavelength = self.waveform.center_wavelength_m
        width, height = (
            max(wavelength / 4.0, wavelength * self.depth_m / (2.0 * side))
            for side in self.aperture_m
        )
        return width, height

    @property
    def depth_of_focus_m(self) -> float:
        """Depth over which the plane is in focus, 2 lambda z^2 / D^2, D its wider side [m]."""
        return depth_of_focus_m(
            self.depth_m, max(self.aperture_m), self.waveform.center_wavelength_m
        )

    @property
    def nyquist_spacing_m(self) -> float:
        """Largest spacing for a scene of its width D, lambda / (4 sin a), tan a = D / z [m]."""
        wide = max(self.aperture_m)
        sine = wide / float(np.hypot(wide, self.depth_m))
        return self.waveform.center_wavelength_m / (4.0 * sine)


def rows_columns(aperture_m: tuple[float, float], spacing_m: float) -> tuple[int, int]:
    """Rows and columns of a plane of this width and height [m]."""
    width, height = aperture_m
    # 1e-9: an aperture that is a whole number of spacings keeps its last antenna.
    return int(height / spacing_m + 1e-9) + 1, int(width / spacing_m + 1e-9) + 1


def depth_of_focus_m(depth_m: float, width_m: float, wavelength_m: float) -> float:
    """Depth at z over which an aperture is in focus, 2 lambda z^2 / D^2, not below 2 lambda [m].

    The two-way phase between its middle and its edge then changes by pi.
    """
    return 2.0 * wavelength_m * max(1.0, (depth_m / width_m) ** 2)


def suggested_standoff_m(box_m: tuple[float, float, float]) -> float:
    """Distance of the planes from the axis, to a centimetre [m]."""
    radius = 0.5 * float(np.hypot(box_m[0], box_m[1]))
    return float(np.ceil(100.0 * max(_RADII_AWAY * radius, radius + _CLEARANCE_M)) / 100.0)


def suggested_aperture_m(box_m: tuple[float, float, float]) -> tuple[float, float]:
    """Width and height of a plane [m].

    Not below 0.14 m across, as a sub-aperture takes 0.08 m; as high as the box and a bit.
    """
    return 0.14, float(max(0.14, np.ceil(100.0 * (box_m[2] + 0.03)) / 100.0))


def nyquist_spacing_m(
    box_m: tuple[float, float, float], standoff_m: float, wavelength_m: float
) -> float:
    """Largest spacing that separates the two edges of the box (docs/conventions.md) [m]."""
    width = max(box_m)
    return max(wavelength_m / 4.0, wavelength_m * standoff_m / (2.0 * width))


def suggested_planes(aperture_m: tuple[float, float], standoff_m: float) -> int:
    """Planes of a ring at which every horizontal normal is seen from two of them."""
    half = float(np.arctan(0.5 * aperture_m[0] / standoff_m))
    return int(np.ceil(_OVERLAP * np.pi / half))
