"""Images of small sub-apertures on a grid of direction and range, and their peaks."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from geraf2 import _core  # noqa: TID251 - ops is the package that wraps the native module
from geraf2._types import Array, Floats, Ints
from geraf2._validation import require_least, require_positive, require_shape
from geraf2.ops._geometry import native_waveform, require_antennas, require_positions
from geraf2.ops._threads import resolve_num_threads
from geraf2.records import Waveform

# Spreading of antennas between lattice points: errors of 5e-7 of the sum of all echoes, from the
# width and the oversampling as in Barnett, Magland and af Klinteberg, A parallel nonuniform fast
# Fourier transform library based on an "exponential of semicircle" kernel, 2019.
_SPREAD_WIDTH = 8
_SPREAD_OVERSAMPLING = 1.5
_MAX_LATTICE_POINTS = 2**20
"""A sub-aperture of 8 cm needs some 2^14; far more is a position in the wrong unit."""
_SPREAD_EXPONENT = 0.976 * np.pi * _SPREAD_WIDTH * (1.0 - 0.5 / _SPREAD_OVERSAMPLING)


@dataclass(frozen=True, kw_only=True)
class CosineAxis:
    """Direction cosines first + i * pitch."""

    count: int
    first: float
    pitch: float
    wraps: bool
    """Whether the axis is periodic."""

    @classmethod
    def symmetric(cls, count: int, pitch: float, *, wraps: bool) -> "CosineAxis":
        """Axis about zero: -period/2 to just below period/2 where it wraps, else odd."""
        if not wraps and count % 2 == 0:
            msg = f"count of an axis that does not wrap must be odd, got {count}"
            raise ValueError(msg)
        first = -0.5 * pitch * (count if wraps else count - 1)
        return cls(count=count, first=first, pitch=pitch, wraps=wraps)

    @property
    def values(self) -> Floats:
        """(count,), ascending."""
        return np.asarray(self.first + self.pitch * np.arange(self.count), dtype=np.float64)

    @property
    def period(self) -> float:
        """Period of the cosines (grating lobes); inf where the axis does not wrap."""
        return self.pitch * self.count if self.wraps else float("inf")

    @property
    def is_symmetric(self) -> bool:
        """Whether the axis is one of `symmetric`."""
        span = self.pitch * (self.count if self.wraps else self.count - 1)
        return abs(self.first + 0.5 * span) <= 1e-9 * max(span, self.pitch)


@dataclass(frozen=True, kw_only=True)
class SubapertureBins:
    """Bins of an image: horizontal and vertical direction cosine, one-way range."""

    horizontal: CosineAxis
    vertical: CosineAxis
    first_range_m: float
    range_pitch_m: float
    n_ranges: int

    def __post_init__(self) -> None:
        require_least(self, n_ranges=1)
        require_positive("horizontal.count", self.horizontal.count)
        require_positive("vertical.count", self.vertical.count)
        require_positive("range_pitch_m", self.range_pitch_m)
        require_positive("horizontal.pitch", self.horizontal.pitch)
        require_positive("vertical.pitch", self.vertical.pitch)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(n_horizontal, n_vertical, n_ranges)."""
        return self.horizontal.count, self.vertical.count, self.n_ranges

    @property
    def ranges_m(self) -> Floats:
        """(n_ranges,) [m]."""
        return np.asarray(
            self.first_range_m + self.range_pitch_m * np.arange(self.n_ranges), dtype=np.float64
        )

    def native(self) -> _core.SubapertureBins:
        """As the kernels read it."""
        horizontal, vertical = (
            _core.CosineAxis(count=a.count, first=a.first, pitch=a.pitch, wraps=a.wraps)
            for a in (self.horizontal, self.vertical)
        )
        ranges = _core.RangeAxis(
            count=self.n_ranges, first_m=self.first_range_m, pitch_m=self.range_pitch_m
        )
        return _core.SubapertureBins(horizontal=horizontal, vertical=vertical, ranges=ranges)


@dataclass(frozen=True, kw_only=True)
class Lattice:
    """Lattice about the middle of a sub-aperture, on whose points all antennas lie."""

    shape: tuple[int, int]
    spacing_m: tuple[float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Subapertures:
    """Antennas of the sub-apertures of one pose, packed one sub-aperture after the other."""

    offsets: Ints
    """Where each begins in the next three, (n_subapertures + 1,)."""
    antennas: Ints
    """(n_members,)."""
    weights: Floats
    """(n_members,); of each sub-aperture with sum 1."""
    positions: Floats
    """Along the horizontal and vertical axis, from the middle, (n_members, 2) [m]."""
    focus: Floats
    """Point on which each is focused, (n_subapertures, 3) [m]."""
    focus_range_m: Floats
    """Distance of that point from the centre, (n_subapertures,) [m]."""
    lattice: Lattice | None
    """Lattice on which the antennas lie; None for any positions."""

    def __post_init__(self) -> None:
        n_subapertures, n_members = len(self.focus_range_m), len(self.antennas)
        require_shape("offsets", self.offsets, (n_subapertures + 1,))
        require_shape("weights", self.weights, (n_members,))
        require_shape("positions", self.positions, (n_members, 2))
        require_shape("focus", self.focus, (n_subapertures, 3))
        ends = (self.offsets[0], self.offsets[-1])
        if ends != (0, n_members) or (np.diff(self.offsets) < 0).any():
            msg = f"offsets must ascend from 0 to {n_members}, got {self.offsets}"
            raise ValueError(msg)
        require_positions("focus", self.focus)
        for name in ("weights", "positions", "focus_range_m"):
            if not np.isfinite(getattr(self, name)).all():
                msg = f"{name} must be finite"
                raise ValueError(msg)

    def native(self) -> _core.SubapertureMembers:
        """As the kernels read it."""
        return _core.SubapertureMembers(
            offsets=np.ascontiguousarray(self.offsets, dtype=np.int64),
            antennas=np.ascontiguousarray(self.antennas, dtype=np.int64),
            weights=np.ascontiguousarray(self.weights, dtype=np.float64),
            positions=np.ascontiguousarray(self.positions, dtype=np.float64),
            focus=np.ascontiguousarray(self.focus, dtype=np.float64),
            focus_range_m=np.ascontiguousarray(self.focus_range_m, dtype=np.float64),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class SubaperturePeaks:
    """Local maxima of the images of many sub-apertures, one sub-aperture after the other."""

    subapertures: Ints
    """(n_peaks,)."""
    cosines: Floats
    """Horizontal and vertical direction cosine, (n_peaks, 2)."""
    ranges_m: Floats
    """One-way distance from the centre, (n_peaks,) [m]."""
    magnitudes: Floats
    """(n_peaks,)."""
    noise: Floats
    """Root mean square of the noise in the peak's range bin, (n_peaks,)."""
    tops: Floats
    """Largest magnitude of each image, (n_subapertures,)."""


def subaperture_peaks(
    signal: Array,
    tx: Floats,
    rx: Floats,
    waveform: Waveform,
    subapertures: Subapertures,
    bins: SubapertureBins,
    *,
    thresholds_db: tuple[float, float],
    num_threads: int | None = None,
) -> SubaperturePeaks:
    """Peaks of the magnitudes of the focused images, which are not kept.

    I(u, r) = |sum_a sum_t w_a w_t s_a(t) exp(j k_t (2 r + q_a + b)) exp(-2 j k_c u . delta_a)|
    with the path q_a to the focus less that of the centre, the instrument delay b, and Hann
    weights w_t over the chirp (docs/math/images.md#sub-aperture-images). On a lattice the sums
    separate and are exact to rounding. Antennas at any positions are spread over a lattice first,
    which errs by 5e-7 of the largest possible magnitude. Not differentiable. A peak is a maximum
    among 26 neighbours, refined by a parabola through three log magnitudes per axis. The noise of a
    range bin is seen by the median direction, as long as echoes fill less than about half of them.

    signal: complex64 or complex128, which is the precision of the sums, (n_antennas, n_samples).
    tx, rx: (n_antennas, 3) [m].
    subapertures: which antennas form which image.
    bins: where the images are taken.
    thresholds_db: peaks weaker than the image's largest by more than the first, or less than the
        second above the noise floor of their range bin, are dropped [dB].
    """
    arguments = _native_arguments(signal, tx, rx, waveform, subapertures, bins)
    found = _core.subaperture_peaks(
        **arguments,
        thresholds=_thresholds(thresholds_db),
        num_threads=resolve_num_threads(num_threads),
    )
    return _peaks(found)


def _native_arguments(
    signal: Array,
    tx: Floats,
    rx: Floats,
    waveform: Waveform,
    subapertures: Subapertures,
    bins: SubapertureBins,
) -> dict[str, Any]:
    if signal.dtype not in (np.complex64, np.complex128):
        msg = f"signal must be complex64 or complex128, got {signal.dtype}"
        raise TypeError(msg)
    tx_rows, rx_rows = require_antennas(tx, rx)
    require_shape("signal", signal, (len(tx_rows), waveform.n_samples))
    members = subapertures.antennas
    if len(members) and (members.min() < 0 or members.max() >= len(tx_rows)):
        msg = f"antennas must lie in 0 to {len(tx_rows) - 1}, got {members.min()}, {members.max()}"
        raise ValueError(msg)
    for name, axis in (("horizontal", bins.horizontal), ("vertical", bins.vertical)):
        if not axis.is_symmetric:
            msg = f"bins.{name} must be symmetric about zero, got first {axis.first}"
            raise ValueError(msg)
    return {
        "signal": np.ascontiguousarray(signal),
        "tx": tx_rows,
        "rx": rx_rows,
        "waveform": native_waveform(waveform),
        "members": subapertures.native(),
        "lattice": _native_lattice(subapertures, bins, waveform.center_wavelength_m),
        "bins": bins.native(),
    }


def _native_lattice(
    subapertures: Subapertures, bins: SubapertureBins, wavelength_m: float
) -> _core.SubapertureLattice:
    lattice = subapertures.lattice
    if lattice is not None:
        (n_h, n_v), (h_spacing, v_spacing) = lattice.shape, lattice.spacing_m
        is_small = min(n_h, n_v) >= 1 and n_h * n_v <= _MAX_LATTICE_POINTS
        if not (is_small and min(h_spacing, v_spacing) > 0.0):
            msg = f"lattice needs 1 to {_MAX_LATTICE_POINTS} positions and spacings, got {lattice}"
            raise ValueError(msg)
        return _core.SubapertureLattice(n_h, n_v, h_spacing, v_spacing, 1, 0.0)
    positions = []
    for k, axis in enumerate((bins.horizontal, bins.vertical)):
        largest = max(abs(axis.first), axis.pitch)
        # The lattice repeats directions after wavelength / (2 spacing).
        spacing = wavelength_m / (4.0 * largest * _SPREAD_OVERSAMPLING)
        reach = float(np.abs(subapertures.positions[:, k]).max(initial=0.0))
        if reach > spacing * _MAX_LATTICE_POINTS:
            msg = f"`places` must lie in a sub-aperture [m], got one {reach:g} m from its middle"
            raise ValueError(msg)
        count = 2 * (int(np.ceil(reach / spacing)) + _SPREAD_WIDTH // 2) + 1
        positions.append((count, spacing))
    (n_h, h_spacing), (n_v, v_spacing) = positions
    if n_h * n_v > _MAX_LATTICE_POINTS:
        reaches = np.abs(subapertures.positions).max(axis=0, initial=0.0).tolist()
        msg = f"`places` must lie in a sub-aperture [m], got up to {reaches} from its middle"
        raise ValueError(msg)
    return _core.SubapertureLattice(n_h, n_v, h_spacing, v_spacing, _SPREAD_WIDTH, _SPREAD_EXPONENT)


def _thresholds(thresholds_db: tuple[float, float]) -> _core.PeakThresholds:
    dynamic_range, noise_margin = thresholds_db
    return _core.PeakThresholds(
        dynamic_range=10.0 ** (-dynamic_range / 20.0), noise_margin=10.0 ** (noise_margin / 20.0)
    )


def _peaks(found: tuple[Array, ...]) -> SubaperturePeaks:
    return SubaperturePeaks(**dict(zip(SubaperturePeaks.__dataclass_fields__, found, strict=True)))
