"""What a capture looks like from outside: numbers for `info` and for the plausibility checks."""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.scene.capture import Capture, Pose, Wall
from geraf2.scene.waveform import Waveform

# Antennas nearer to each other than this share one place: a fortieth of a wavelength at 77 GHz.
_SAME_PLACE_M = 1e-4
# Looking directions that differ by less than about 6 degrees do not fix a common point.
_MIN_SPREAD = 0.01


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseSummary:
    """One scan plane in numbers."""

    name: str
    n_antennas: int
    center: NDArray[np.float64]
    """Mean phase centre (3,) [m]; NaN without antennas."""
    axes: NDArray[np.float64]
    """Rows looking, horizontal, vertical, (3, 3)."""
    extent_m: NDArray[np.float64]
    """Extent of the phase centres along the three axes, (3,) [m]."""
    spacing_m: float
    """Median distance of an antenna's phase centre to the nearest other one [m]."""
    n_repeated_places: int
    """Antennas whose transmitter and receiver stand where another antenna's do."""
    n_bad_positions: int
    """Position coordinates that are not finite."""
    n_bad_samples: int
    """Samples that are not finite."""
    rms: float
    """Root mean square of the samples' magnitude."""
    n_constant: int
    """Antennas whose samples are all the same."""
    saturated_fraction: float
    """Fraction of real and imaginary parts that sit exactly on the pose's largest value."""
    profile: NDArray[np.float64]
    """Mean power of the range profile, (n_samples,)."""
    digest: str
    """Hash of the samples."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CaptureSummary:
    """A capture in numbers."""

    waveform: Waveform
    walls: tuple[Wall, ...]
    poses: tuple[PoseSummary, ...]

    @property
    def n_antennas(self) -> int:
        """Antennas over all poses."""
        return sum(pose.n_antennas for pose in self.poses)

    @property
    def usable(self) -> tuple[PoseSummary, ...]:
        """Poses with antennas at finite positions."""
        return tuple(p for p in self.poses if p.n_antennas and not p.n_bad_positions)

    @property
    def aperture_m(self) -> tuple[float, float]:
        """Median horizontal and vertical extent of a pose [m]."""
        extents = [pose.extent_m for pose in self.usable]
        if not extents:
            return float("nan"), float("nan")
        _, horizontal, vertical = np.median(extents, axis=0)
        return float(horizontal), float(vertical)

    @property
    def spacing_m(self) -> float:
        """Median antenna spacing [m]; NaN where no pose has two antennas."""
        spacings = [pose.spacing_m for pose in self.usable if np.isfinite(pose.spacing_m)]
        return float(np.median(spacings)) if spacings else float("nan")

    @property
    def focus(self) -> NDArray[np.float64] | None:
        """Point that the poses look at, (3,) [m].

        The point nearest to all looking axes; where these are almost parallel, the mean of the
        points at the strongest echo in front of each pose. None without usable poses.
        """
        poses = self.usable
        if not poses:
            return None
        centers = np.stack([pose.center for pose in poses])
        looking = np.stack([pose.axes[0] for pose in poses])
        across = np.eye(3) - looking[:, :, None] * looking[:, None, :]
        normal_matrix = across.mean(axis=0)
        if np.linalg.eigvalsh(normal_matrix)[0] > _MIN_SPREAD:
            offset = np.einsum("pij,pj->i", across, centers) / len(poses)
            return np.asarray(np.linalg.solve(normal_matrix, offset))
        ranges = np.array([self.echo_range_m(pose) for pose in poses])
        return np.asarray((centers + ranges[:, None] * looking).mean(axis=0))

    @property
    def standoff_m(self) -> float:
        """Median distance from a pose to the point that the poses look at [m]."""
        focus = self.focus
        if focus is None:
            return float("nan")
        return float(np.median([np.linalg.norm(pose.center - focus) for pose in self.usable]))

    @property
    def scene_width_m(self) -> float | None:
        """Largest side of the outermost known wall [m]; None without walls."""
        return max(self.walls[0].size_m) if self.walls else None

    @property
    def nyquist_spacing_m(self) -> float:
        """Largest antenna spacing at which the scene's aliases stay off the scene [m].

        An antenna at distance R sees a scene of width W under the angle W / R; the two-way
        phase then needs a step of at most lambda R / (2 W), and lambda / 4 for any scene.
        """
        wavelength = self.waveform.center_wavelength_m
        width = self.scene_width_m
        if width is None or not np.isfinite(self.standoff_m):
            return wavelength / 4
        return max(wavelength / 4, wavelength * self.standoff_m / (2 * width))

    def echo_range_m(self, pose: PoseSummary) -> float:
        """One-way range of the strongest mean echo of a pose, instrument delay taken off [m]."""
        n_samples = self.waveform.n_samples
        strongest = int(np.argmax(pose.profile))
        path = strongest * SPEED_OF_LIGHT_M_PER_S / self.waveform.bandwidth_hz
        path -= self.waveform.path_bias_m
        period = n_samples * SPEED_OF_LIGHT_M_PER_S / self.waveform.bandwidth_hz
        return 0.5 * (path % period)


def summarize_capture(capture: Capture) -> CaptureSummary:
    """Numbers of a capture in memory."""
    return summarize_poses(capture.poses, capture.waveform, capture.walls)


def summarize_poses(
    poses: Iterable[Pose], waveform: Waveform, walls: tuple[Wall, ...] = ()
) -> CaptureSummary:
    """Numbers of a capture whose poses come one at a time."""
    return CaptureSummary(
        waveform=waveform, walls=walls, poses=tuple(summarize_pose(pose) for pose in poses)
    )


def summarize_pose(pose: Pose) -> PoseSummary:
    """Numbers of one pose; values that are not finite are counted and left out."""
    positions = np.hstack([pose.tx_positions, pose.rx_positions])
    good = np.isfinite(positions).all(axis=1)
    centers = pose.phase_centers[good]
    along = centers @ pose.axes.T
    finite = np.isfinite(pose.signal)
    signal = np.where(finite, pose.signal, 0)
    parts = np.abs(signal.view(np.float32)) if signal.size else np.zeros(1, dtype=np.float32)
    largest = float(parts.max())
    constant = (signal == signal[:, :1]).all(axis=1)
    return PoseSummary(
        name=pose.name,
        n_antennas=pose.n_antennas,
        center=centers.mean(axis=0) if len(centers) else np.full(3, np.nan),
        axes=pose.axes,
        extent_m=np.ptp(along, axis=0) if len(along) else np.full(3, np.nan),
        spacing_m=_median_spacing(centers),
        n_repeated_places=_n_repeated(positions[good]),
        n_bad_positions=int((~np.isfinite(positions)).sum()),
        n_bad_samples=int((~finite).sum()),
        rms=float(np.sqrt(np.mean(np.abs(signal) ** 2))) if signal.size else 0.0,
        n_constant=int(constant.sum()),
        saturated_fraction=float((parts == largest).mean()) if largest > 0 else 0.0,
        profile=_mean_profile(signal),
        digest=hashlib.blake2b(signal.tobytes(), digest_size=16).hexdigest(),
    )


def _mean_profile(signal: NDArray[np.complex64]) -> NDArray[np.float64]:
    if not signal.size:
        return np.zeros(signal.shape[1])
    # The signal is exp(-j 2 pi k t d / c): the inverse transform turns delay into range.
    profile = np.fft.ifft(signal, axis=1)
    return np.asarray((np.abs(profile) ** 2).mean(axis=0), dtype=np.float64)


def _median_spacing(centers: NDArray[np.float64]) -> float:
    _, first = np.unique(np.round(centers / _SAME_PLACE_M), axis=0, return_index=True)
    if len(first) < 2:
        return float("nan")
    distances, _ = cKDTree(centers[first]).query(centers[first], k=2)
    return float(np.median(distances[:, 1]))


def _n_repeated(positions: NDArray[np.float64]) -> int:
    places = np.unique(np.round(positions / _SAME_PLACE_M), axis=0)
    return len(positions) - len(places)
