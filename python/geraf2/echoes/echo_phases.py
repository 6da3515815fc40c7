"""Contribution of each antenna to the strong echoes of its sub-aperture."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from geraf2._types import Array, Floats, Ints
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.imaging.peaks import PeakSet
from geraf2.imaging.subapertures import MIN_ANTENNAS
from geraf2.scene import Capture, Pose, Waveform

# Shares of a point's wavefront curvature that are removed, in trials along each axis: none for a
# point (0), all for a plane (1).
_CURVATURES = np.linspace(0.0, 1.0, 6)


@dataclass(frozen=True, kw_only=True, eq=False)
class EchoPhases:
    """One echo at the antennas of one sub-aperture."""

    pose: int
    antennas: Ints
    """Indices of the antennas in the pose, ascending, (n,)."""
    values: NDArray[np.complex128]
    """Windowed contribution of each antenna to the focused echo, (n,).

    Path and wavefront curvature are removed, so only errors of the antennas remain in the phases.
    """
    cosines: Floats
    """Between the looking direction and that from each antenna to the reflector, (n,)."""
    offsets_m: Floats
    """Antenna positions about the sub-aperture's centre, horizontal and vertical, (n, 2) [m]."""

    @property
    def coherence(self) -> float:
        """|sum z| / sum |z|, 1 when all phases agree."""
        total = float(np.abs(self.values).sum())
        return float(np.abs(self.values.sum())) / total if total > 0 else 0.0


def collect_phases(
    capture: Capture, peaks: PeakSet, *, size_m: float, n_echoes: int
) -> Iterator[EchoPhases]:
    """Strong echoes at each antenna, plane by plane.

    capture: the scan; its instrument delay must be right to a few centimetres.
    peaks: of some of its planes.
    size_m: side of the sub-apertures around the centres of those of the peaks [m].
    n_echoes: number of the strongest echoes of each plane.
    """
    for number in np.unique(peaks.planes):
        pose, own = capture.poses[number], peaks.of_plane(number)
        own = own.select(np.argsort(-own.magnitudes, kind="stable")[:n_echoes])
        antennas = _Antennas(pose, int(number), capture.waveform, size_m)
        points = own.points
        parts: dict[int, EchoPhases] = {}  # by rank of the magnitude
        for subaperture in np.unique(own.subapertures):
            members = np.flatnonzero(own.subapertures == subaperture)
            seen = antennas.phases(own.subaperture_centers[subaperture], points[members])
            parts |= zip(members[: len(seen)].tolist(), seen, strict=True)
        yield from (parts[rank] for rank in sorted(parts))


def response_at(
    signal: NDArray[np.complexfloating], path_m: Floats, waveform: Waveform
) -> NDArray[np.complex128]:
    """Range response of each antenna's samples, (n, n_samples), at its own paths, (..., n) [m].

    With a Hann window, in the precision of the signal. Paths include the waveform's bias. Returns
    (..., n). Frequencies have equal steps, so the sum is a polynomial in a phasor. Horner's rule is
    twenty times as fast as one exponential per sample.
    """
    delay_s = path_m / SPEED_OF_LIGHT_M_PER_S
    step = _phasor(delay_s * (waveform.bandwidth_hz / waveform.n_samples), signal.dtype)
    window = np.hanning(waveform.n_samples + 2)[1:-1].astype(step.real.dtype)
    weighted = np.multiply(signal.T, window[:, None], order="C")
    total = np.zeros(path_m.shape, dtype=signal.dtype)
    for column in weighted[::-1]:
        total *= step
        total += column
    total *= _phasor(delay_s * waveform.frequencies_hz[0], signal.dtype)
    return total.astype(np.complex128)


def _phasor(turns: Floats, dtype: np.dtype[Any]) -> Array:
    """exp(2 pi j turns); sine and cosine in single precision take a tenth of the time."""
    phasor = np.empty(turns.shape, dtype=dtype)
    angle = (2.0 * np.pi * (turns - np.rint(turns))).astype(phasor.real.dtype)
    np.cos(angle, out=phasor.real)
    np.sin(angle, out=phasor.imag)
    return phasor


class _Antennas:
    """Antennas of a pose, from which sub-apertures are selected."""

    def __init__(self, pose: Pose, number: int, waveform: Waveform, size_m: float) -> None:
        self.pose, self.number, self.waveform, self.size_m = pose, number, waveform, size_m
        self.centers = pose.phase_centers
        self.across = pose.axes[1:] @ self.centers.T

    def phases(self, center: Floats, points: Floats) -> list[EchoPhases]:
        """Echoes from points (n, 3) [m] in the sub-aperture around a centre; [] if it is sparse."""
        pose, waveform = self.pose, self.waveform
        offsets = self.across - (pose.axes[1:] @ center)[:, None]
        inside = np.flatnonzero((np.abs(offsets) < 0.5 * self.size_m).all(axis=0))
        if len(inside) < MIN_ANTENNAS:
            return []
        offsets, centers = offsets[:, inside], self.centers[inside]
        window = np.prod(np.cos(np.pi / self.size_m * offsets), axis=0) ** 2
        distances = cdist(points, centers)
        path = cdist(points, pose.tx_positions[inside])
        path += cdist(points, pose.rx_positions[inside]) + waveform.path_bias_m
        values = window * response_at(pose.signal[inside], path, waveform)
        flat = _without_curvature(values, offsets, waveform, distances.mean(axis=1))
        ahead_m = (points @ pose.axes[0])[:, None] - centers @ pose.axes[0]
        return [
            EchoPhases(
                pose=self.number,
                antennas=inside,
                values=own,
                cosines=cosines,
                offsets_m=offsets.T,
            )
            for own, cosines in zip(flat, ahead_m / distances, strict=True)
        ]


def _without_curvature(
    values: NDArray[np.complex128], offsets: Floats, waveform: Waveform, ranges_m: Floats
) -> NDArray[np.complex128]:
    """Remove the difference between a surface's wavefront curvature and that of a point.

    At the offset s on the aperture, a surface of radius rho at range R has the path
    2 R + s^2 / (R + rho), and a point 2 R + s^2 / R. Values (n_echoes, n), offsets (2, n).
    """
    turns = -_CURVATURES[1] / waveform.center_wavelength_m / ranges_m[:, None, None] * offsets**2
    one = _phasor(turns, np.dtype(np.complex64))
    bend = np.ones((len(_CURVATURES), *one.shape), dtype=one.dtype)  # (n_tried, n_echoes, 2, n)
    for number in range(1, len(bend)):
        np.multiply(bend[number - 1], one, out=bend[number])
    across = bend[:, :, 1]
    bent = values.astype(one.dtype)[:, None] * bend[:, :, 0].swapaxes(0, 1)
    sums = np.abs(bent @ across.transpose(1, 2, 0)).reshape(len(values), -1)
    first, second = np.divmod(sums.argmax(axis=1), len(_CURVATURES))
    every = np.arange(len(values))
    return np.asarray(bent[every, first] * across[second, every], dtype=np.complex128)
