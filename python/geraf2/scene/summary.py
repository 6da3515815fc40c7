"""Numbers that describe a capture, for `info` and for the plausibility checks."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats, Ints
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.io.digests import bytes_digest
from geraf2.io.manifest import DELAY_KEY, DELAY_NOT_KNOWN
from geraf2.io.samples import complex_pose
from geraf2.records import Pose, RawPose, Wall, Waveform
from geraf2.scene.aperture import Aperture
from geraf2.scene.capture import Capture
from geraf2.scene.plan import nyquist_spacing_m

# Antennas nearer to each other than this share one position: a fortieth of a wavelength at 77 GHz.
_SAME_POSITION_M = 1e-4
# Looking directions that differ by less than about 6 degrees do not fix a common point.
_MIN_SPREAD = 0.01
# A plane this wide focuses from two to four wavelengths before it, a narrower one nowhere.
_MIN_WAVELENGTHS_WIDE = 4.0
# The noise floor of an antenna is compared with the median of this many around it. Ten times the
# median: floors of 8 of 32 bins spread by a factor of 3.
_FLOOR_WINDOW, _MIN_FLOOR_SAMPLES = 31, 16
_NOISY = 10.0
# Samples of a plane in which clipping is looked for: of those 0.001 are 16.
_SATURATION_SAMPLES = 1 << 14
# Parts of a large pose whose samples are looked at.
_N_CHECKED_PARTS = 8
# Nearest antennas among which one across is sought: at first few, which a square raster needs, then
# more, since rows may lie 30 times as far apart as antennas.
_N_NEIGHBOURS = 9, 64
# 5 % over the limit moves the alias by 5 % of the scene's width.
_COARSE = 1.05


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseSummary:
    """One scan plane in numbers."""

    name: str
    n_antennas: int
    center: Floats
    """Mean phase centre (3,) [m]; NaN without antennas."""
    axes: Floats
    """Rows looking, horizontal, vertical, (3, 3)."""
    bounds_m: Floats
    """Smallest and largest coordinate of the phase centres along the three axes, (2, 3) [m]."""
    spacings_m: Floats
    """Median distance of an antenna's phase centre to the nearest other one, and to the nearest
    across from that: of a raster its steps, the finer first. NaN where there is none [m]."""
    n_repeated_positions: int
    """Antennas at the positions of another antenna."""
    n_bad_positions: int
    """Position coordinates that are not finite."""
    farthest_m: float
    """Largest magnitude of a finite coordinate [m]."""
    apart_m: float
    """Largest distance of a transmitter from its receiver [m]."""
    n_bad_samples: int
    """Samples that are not finite."""
    rms: float
    """Root mean square of the samples' magnitude."""
    n_constant: int
    """Antennas whose samples are all the same."""
    largest: float
    """Largest magnitude of a real or imaginary part."""
    saturated_fraction: float
    """Fraction of real and imaginary parts that sit exactly on the pose's largest value."""
    dc_fraction: float
    """Power of the mean over all samples, of that of the samples: a constant offset."""
    n_noisy: int
    """Antennas whose noise floor is 10 dB above that of the antennas around: interference."""
    profile: Floats
    """Mean power of the range profile under a Hann window, (n_samples,)."""
    digest: str
    """Hash of the samples."""

    @property
    def extent_m(self) -> Floats:
        """Extent of the phase centres along the three axes, (3,) [m]."""
        return np.asarray(self.bounds_m[1] - self.bounds_m[0])

    @property
    def corners_m(self) -> Floats:
        """Middle and corners of the rectangle that the phase centres cover, (5, 3) [m]."""
        return np.vstack([self.aperture.middle_m, self.aperture.corners_m])

    @property
    def aperture(self) -> Aperture:
        """Rectangle that the phase centres cover."""
        return Aperture(axes=self.axes, low_m=self.bounds_m[0], high_m=self.bounds_m[1])


@dataclass(frozen=True, kw_only=True, eq=False)
class CaptureSummary:
    """A capture in numbers."""

    waveform: Waveform
    walls: tuple[Wall, ...]
    poses: tuple[PoseSummary, ...]
    delay_given: bool = False
    """Whether the instrument delay was measured or given; not so where 0 was assumed."""

    @property
    def is_plane(self) -> bool:
        """Whether this is a single plane without a box, wide enough to focus to a depth."""
        narrowest = _MIN_WAVELENGTHS_WIDE * self.waveform.center_wavelength_m
        return len(self.usable_poses) == 1 and not self.walls and min(self.aperture_m) >= narrowest

    @property
    def n_antennas(self) -> int:
        """Antennas over all poses."""
        return sum(pose.n_antennas for pose in self.poses)

    @property
    def usable_poses(self) -> tuple[PoseSummary, ...]:
        """Poses with antennas at finite positions, and finite axes."""
        good = (p for p in self.poses if p.n_antennas and not p.n_bad_positions)
        return tuple(pose for pose in good if np.isfinite(pose.axes).all())

    @property
    def aperture_m(self) -> tuple[float, float]:
        """Median horizontal and vertical extent of a pose [m]."""
        extents = [pose.extent_m for pose in self.usable_poses]
        if not extents:
            return float("nan"), float("nan")
        _, horizontal, vertical = np.median(extents, axis=0)
        return float(horizontal), float(vertical)

    @property
    def spacings_m(self) -> Floats:
        """Median spacings along and across, (2,) [m], as of :class:`PoseSummary`."""
        return _medians([pose.spacings_m for pose in self.usable_poses])

    @property
    def spacing_m(self) -> float:
        """The coarser of these, which decides on grating lobes; NaN without two antennas [m]."""
        return float(np.fmax(*self.spacings_m))

    @property
    def is_coarse(self) -> bool:
        """Whether the antennas are so far apart that grating lobes lie on the scene."""
        return self.spacing_m > _COARSE * self.nyquist_spacing_m

    @property
    def focus(self) -> Floats | None:
        """Point that the poses face, (3,) [m].

        The point nearest to all looking axes; where these are almost parallel, the mean of the
        points at the strongest echo in front of each pose. None without usable poses, and where
        one frequency measures no range.
        """
        poses = self.usable_poses
        if not poses:
            return None
        centers = np.stack([pose.center for pose in poses])
        looking = np.stack([pose.axes[0] for pose in poses])
        across = np.eye(3) - looking[:, :, None] * looking[:, None, :]
        normal_matrix = across.mean(axis=0)
        if np.linalg.eigvalsh(normal_matrix)[0] > _MIN_SPREAD:
            offset = np.einsum("pij,pj->i", across, centers) / len(poses)
            return np.asarray(np.linalg.solve(normal_matrix, offset))
        if self.waveform.n_samples == 1:
            return None
        ranges = np.array([self.echo_range_m(pose) for pose in poses])
        return np.asarray((centers + ranges[:, None] * looking).mean(axis=0))

    @property
    def standoff_m(self) -> float:
        """Median distance from a pose to the point that the poses face [m]."""
        focus = self.focus
        if focus is None:
            return float("nan")
        return float(np.median([np.linalg.norm(pose.center - focus) for pose in self.usable_poses]))

    @property
    def planes(self) -> list[Aperture]:
        """Apertures of the usable poses."""
        return [pose.aperture for pose in self.usable_poses]

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
        if not self.walls or not np.isfinite(self.standoff_m):
            return wavelength / 4
        return nyquist_spacing_m(self.walls[0].size_m, self.standoff_m, wavelength)

    def numbers(self) -> dict[str, object]:
        """Properties by name, for `--json`: SI units, NaN where one is unknown."""
        waveform, focus = self.waveform, self.focus
        return {
            "n_planes": len(self.poses),
            "n_antennas": self.n_antennas,
            "n_samples": waveform.n_samples,
            "start_frequency_hz": waveform.start_frequency_hz,
            "bandwidth_hz": waveform.bandwidth_hz,
            "wavelength_m": waveform.center_wavelength_m,
            "range_cell_m": waveform.range_cell_m,
            "unambiguous_range_m": waveform.unambiguous_range_m,
            "path_bias_m": waveform.path_bias_m,
            "aperture_m": self.aperture_m,
            "spacings_m": self.spacings_m.tolist(),
            "nyquist_spacing_m": self.nyquist_spacing_m,
            "focus_m": None if focus is None else focus.tolist(),
            "standoff_m": self.standoff_m,
            "walls": [asdict(wall) for wall in self.walls],
        }

    def echo_range_m(self, pose: PoseSummary) -> float:
        """One-way range of the strongest mean echo of a pose, instrument delay subtracted [m]."""
        n_samples = self.waveform.n_samples
        strongest = int(np.argmax(pose.profile))
        path = strongest * SPEED_OF_LIGHT_M_PER_S / self.waveform.bandwidth_hz
        path -= self.waveform.path_bias_m
        period = n_samples * SPEED_OF_LIGHT_M_PER_S / self.waveform.bandwidth_hz
        return 0.5 * (path % period)


def summarize_capture(capture: Capture) -> CaptureSummary:
    """Numbers of a capture in memory."""
    return summarize_poses(
        capture.poses, capture.waveform, capture.walls, delay_given=is_delay_given(capture)
    )


def is_delay_given(capture: Capture) -> bool:
    """Whether the instrument delay of a capture is known: it is not 0, or stated to be 0."""
    stated = capture.provenance.get(DELAY_KEY, DELAY_NOT_KNOWN) != DELAY_NOT_KNOWN
    return stated or capture.waveform.path_bias_m != 0.0


def summarize_poses(
    poses: Iterable[Pose],
    waveform: Waveform,
    walls: tuple[Wall, ...] = (),
    *,
    delay_given: bool = False,
) -> CaptureSummary:
    """Numbers of a capture whose poses come one at a time."""
    return CaptureSummary(
        waveform=waveform,
        walls=walls,
        poses=tuple(summarize_pose(pose) for pose in poses),
        delay_given=delay_given,
    )


def summarize_in_parts(
    parts: Iterable[RawPose],
    n_antennas: Sequence[int],
    waveform: Waveform,
    walls: tuple[Wall, ...] = (),
    *,
    delay_given: bool = False,
) -> CaptureSummary:
    """Numbers of a capture whose poses come in consecutive parts, of which one is held at a time.

    Of a pose in many parts, samples, spacing and repeats are looked at in some evenly spread
    ones: a check of every sample would take longer than the import.

    parts: poses or parts of them, in order.
    n_antennas: antennas of each whole pose.
    waveform, walls, delay_given: as of the capture.
    """
    poses: list[PoseSummary] = []
    looked_at: list[PoseSummary] = []
    placed: list[_Extent] = []
    n_placed = 0
    for part in parts:
        total = n_antennas[len(poses)]
        part_size = placed[0].n_antennas if placed else part.n_antennas
        every = max(1, total // max(1, part_size) // _N_CHECKED_PARTS)
        if len(placed) % every == 0:
            looked_at.append(summarize_pose(complex_pose(part)))
        placed.append(_extent_of(part))
        n_placed += part.n_antennas
        if n_placed >= total:
            poses.append(looked_at[0] if len(placed) == 1 else _merge(looked_at, placed))
            looked_at, placed, n_placed = [], [], 0
    return CaptureSummary(
        waveform=waveform, walls=walls, poses=tuple(poses), delay_given=delay_given
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Extent:
    """Positions of the antennas of a part of a pose."""

    n_antennas: int
    center: Floats
    bounds_m: Floats


def _extent_of(part: RawPose) -> _Extent:
    if not part.n_antennas:
        return _Extent(n_antennas=0, center=np.full(3, np.nan), bounds_m=np.full((2, 3), np.nan))
    # Coordinates first: sums and extremes along the long axis take a quarter of the time.
    centers = 0.5 * (part.tx_positions.T + part.rx_positions.T).copy()
    along = part.axes @ centers
    return _Extent(
        n_antennas=part.n_antennas,
        center=centers.mean(axis=1),
        bounds_m=np.stack([along.min(axis=1), along.max(axis=1)]),
    )


def _merge(looked_at: Sequence[PoseSummary], placed: Sequence[_Extent]) -> PoseSummary:
    """Numbers of a pose from those of its parts, of which only some were read."""
    usable = [part for part in placed if np.isfinite(part.center).all()]
    n_usable = [part.n_antennas for part in usable]
    bounds = np.array([part.bounds_m for part in usable])
    weights = np.array([part.n_antennas for part in looked_at], dtype=np.float64)
    largest = max(part.largest for part in looked_at)
    on_largest = [part.saturated_fraction * (part.largest == largest) for part in looked_at]
    n_antennas = sum(part.n_antennas for part in placed)
    n_constant = sum(part.n_constant for part in looked_at)
    return PoseSummary(
        name=looked_at[0].name,
        n_antennas=n_antennas,
        center=np.average([part.center for part in usable], axis=0, weights=n_usable)
        if usable
        else np.full(3, np.nan),
        axes=looked_at[0].axes,
        bounds_m=np.stack([bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)])
        if usable
        else np.full((2, 3), np.nan),
        spacings_m=_medians([part.spacings_m for part in looked_at]),
        n_repeated_positions=sum(part.n_repeated_positions for part in looked_at),
        n_bad_positions=sum(part.n_bad_positions for part in looked_at),
        farthest_m=max(part.farthest_m for part in looked_at),
        apart_m=max(part.apart_m for part in looked_at),
        n_bad_samples=sum(part.n_bad_samples for part in looked_at),
        rms=float(np.sqrt(np.average([part.rms**2 for part in looked_at], weights=weights))),
        n_constant=round(n_constant * n_antennas / weights.sum()),
        largest=largest,
        saturated_fraction=float(np.average(on_largest, weights=weights)),
        dc_fraction=float(np.average([part.dc_fraction for part in looked_at], weights=weights)),
        n_noisy=sum(part.n_noisy for part in looked_at),
        profile=np.average([part.profile for part in looked_at], axis=0, weights=weights),
        digest=bytes_digest("".join(part.digest for part in looked_at).encode()),
    )


def summarize_pose(pose: Pose) -> PoseSummary:
    """Numbers of one pose; values that are not finite are counted and left out."""
    positions = np.hstack([pose.tx_positions, pose.rx_positions])
    good = np.isfinite(positions).all(axis=1)
    centers = pose.phase_centers[good]
    along = centers @ pose.axes.T
    finite = np.isfinite(pose.signal)
    signal = np.where(finite, pose.signal, 0)
    parts = np.abs(signal.view(signal.real.dtype)) if signal.size else np.zeros(1)
    largest = float(parts.max())
    constant, power = constant_antennas(signal), _range_power(signal)
    return PoseSummary(
        name=pose.name,
        n_antennas=pose.n_antennas,
        center=centers.mean(axis=0) if len(centers) else np.full(3, np.nan),
        axes=pose.axes,
        bounds_m=np.stack([along.min(axis=0), along.max(axis=0)])
        if len(along)
        else np.full((2, 3), np.nan),
        spacings_m=_median_spacings(centers),
        n_repeated_positions=int(good.sum()) - len(_distinct_positions(positions[good])),
        n_bad_positions=int((~np.isfinite(positions)).sum()),
        farthest_m=float(np.abs(positions[good]).max(initial=0.0)),
        apart_m=float(
            np.linalg.norm(positions[good, :3] - positions[good, 3:], axis=1).max(initial=0.0)
        ),
        n_bad_samples=int((~finite).sum()),
        rms=float(np.sqrt(np.mean(np.abs(signal) ** 2))) if signal.size else 0.0,
        n_constant=int(constant.sum()),
        largest=largest,
        saturated_fraction=_on_largest(signal),
        dc_fraction=_dc_fraction(signal),
        n_noisy=int(_are_noisy(power).sum()),
        profile=power.mean(axis=0, dtype=np.float64) if len(power) else np.zeros(signal.shape[1]),
        digest=bytes_digest(signal.tobytes()),
    )


def constant_antennas(signal: NDArray[np.complex64]) -> Bools:
    """Antennas whose samples are all the same, (n_antennas,).

    Of one frequency, all where each has the same as every other.

    signal: samples, (n_antennas, n_samples).
    """
    first = signal[:, :1] if signal.shape[1] > 1 else signal[:1]
    same = np.asarray((signal == first).all(axis=1))
    return same if signal.shape[1] > 1 else np.full(len(same), len(same) > 1 and same.all())


def saturation_share(capture: Capture) -> float:
    """Largest share over the planes of I and Q that sit on the plane's largest value, 0 to 1.

    Below 0.001 where nothing is cut off. Of large planes every so many antennas are looked at.
    """
    return max((_on_largest(_some_antennas(pose.signal)) for pose in capture.poses), default=0.0)


def _some_antennas(signal: NDArray[np.complex64]) -> NDArray[np.complex64]:
    # An odd step: channels that take turns are all met.
    return np.ascontiguousarray(signal[:: signal.size // _SATURATION_SAMPLES | 1])


def _on_largest(signal: NDArray[np.complex64]) -> float:
    """Share of I and Q that have the largest finite magnitude of either."""
    parts = np.abs(signal.view(signal.real.dtype))
    largest = float(np.max(parts, where=np.isfinite(parts), initial=0.0))
    return float((parts == largest).mean()) if largest > 0.0 else 0.0


def _dc_fraction(signal: NDArray[np.complex64]) -> float:
    power = float(np.mean(np.abs(signal) ** 2)) if signal.size else 0.0
    return float(np.abs(signal.mean()) ** 2) / power if power > 0 else 0.0


def noisy_antennas(signal: NDArray[np.complex64]) -> Bools:
    """Antennas whose noise floor exceeds that of those before and after, (n_antennas,).

    Another radar's chirp crosses the band in a few samples and raises the floor at all ranges, in
    one recording and not in the next. The floor is the quarter of the weakest range bins.

    signal: samples in the order in which they were taken, (n_antennas, n_samples).
    """
    return _are_noisy(_range_power(signal))


def _are_noisy(power: Floats) -> Bools:
    """`noisy_antennas` of power over range, (n_antennas, n_samples)."""
    n_antennas, n_samples = power.shape
    if n_antennas < 2 * _FLOOR_WINDOW or n_samples < _MIN_FLOOR_SAMPLES:
        return np.zeros(n_antennas, dtype=bool)
    floor = np.partition(power, n_samples // 4, axis=1)[:, n_samples // 4]
    around = median_filter(floor, _FLOOR_WINDOW, mode="nearest")
    return np.asarray(floor > _NOISY * np.maximum(around, 1e-30))


def _range_power(signal: NDArray[np.complex64]) -> Floats:
    """Power over range under a Hann window, (n_antennas, n_samples)."""
    # The signal is exp(-j 2 pi k t d / c): the inverse transform turns delay into range.
    window = np.hanning(signal.shape[1] + 2)[1:-1].astype(signal.real.dtype)
    weighted = signal.copy()
    # By parts: NumPy 2 crashes where it lacks memory for the buffers of a complex product.
    weighted.real *= window
    weighted.imag *= window
    profiles = np.fft.ifft(weighted, axis=1)
    return np.asarray(profiles.real**2 + profiles.imag**2)


def _median_spacings(centers: Floats) -> Floats:
    """Median distance of the nearest neighbour, and of the nearest at 45 degrees or more to it."""
    places = centers[_distinct_positions(centers)]
    if len(places) < 2:
        return np.full(2, np.nan)
    # Neighbours of a thousand positions: the search takes a third of the time of reading a capture.
    asked, tree = places[:: len(places) // 1000 + 1], KDTree(places)
    spacings = np.full((len(asked), 2), np.inf)
    for n in _N_NEIGHBOURS:
        lacks = np.isinf(spacings[:, 1])  # a line has none across
        apart, index = tree.query(asked[lacks], k=range(2, min(n, len(places)) + 1))
        offsets = places[index] - asked[lacks, None]
        along = np.einsum("ijk,ik->ij", offsets, offsets[:, 0])
        across = np.where(np.abs(along) < np.sqrt(0.5) * apart * apart[:, :1], apart, np.inf)
        spacings[lacks] = np.stack([apart[:, 0], across.min(axis=1)], axis=1)
    return _medians(spacings)


def _medians(pairs: Sequence[Floats] | Floats) -> Floats:
    """Median of each column without its NaN, (2,); NaN where it has nothing else."""
    columns = np.array(pairs, dtype=np.float64).reshape(-1, 2).T
    good = [column[np.isfinite(column)] for column in columns]
    return np.array([np.median(column) if len(column) else np.nan for column in good])


def _distinct_positions(positions: Floats) -> Ints:
    """First row of each position; np.unique over rows takes four times as long."""
    if len(positions) == 0:
        return np.zeros(0, dtype=np.int64)
    rounded = np.round(positions / _SAME_POSITION_M)
    order = np.lexsort(rounded.T)
    differs = (np.diff(rounded[order], axis=0) != 0.0).any(axis=1)
    return np.asarray(order[np.concatenate([[True], differs])], dtype=np.int64)
