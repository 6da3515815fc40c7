"""What each antenna adds to the strong echoes of its sub-aperture."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Floats, Ints
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.imaging.peaks import PeakSet
from geraf2.scene import Capture, Pose, Waveform

# A surface between a point (0) and a plane (1) is tried in these steps, per direction.
_CURVATURES = np.linspace(0.0, 1.0, 6)
_MIN_ANTENNAS = 16


@dataclass(frozen=True, kw_only=True, eq=False)
class EchoPhases:
    """One echo, as the antennas of one sub-aperture have it."""

    pose: int
    antennas: Ints
    """(n,)."""
    values: NDArray[np.complex128]
    """Windowed contribution of each antenna to the focused echo, (n,).

    Their phases agree but for the errors of antennas: path and curvature are taken off.
    """
    directions: Floats
    """From each antenna to the echo, unit, (n, 3)."""
    looking: Floats
    """Looking direction of the pose, (3,)."""
    places_m: Floats
    """Of the antennas about the middle, horizontal and vertical, (n, 2) [m]."""

    @property
    def coherence(self) -> float:
        """|sum z| / sum |z|, 1 when all phases agree."""
        total = float(np.abs(self.values).sum())
        return float(np.abs(self.values.sum())) / total if total > 0 else 0.0


def collect_phases(
    capture: Capture, peaks: PeakSet, *, size_m: float = 0.08, n_echoes: int = 60
) -> list[EchoPhases]:
    """Strong echoes of the planes, antenna by antenna.

    capture: the scan; its instrument delay must be right to a few centimetres.
    peaks: of some of its planes.
    size_m: side of the sub-apertures, about the centres of those of the peaks [m].
    n_echoes: of each plane, the strongest.
    """
    found = []
    for number in np.unique(peaks.planes):
        pose, own = capture.poses[number], peaks.of_plane(number)
        own = own.select(np.argsort(-own.magnitudes, kind="stable")[:n_echoes])
        antennas = _Antennas(pose, int(number), capture.waveform, size_m)
        points = own.points
        parts: dict[int, EchoPhases] = {}  # by their place among the strongest
        for subaperture in np.unique(own.subapertures):
            members = np.flatnonzero(own.subapertures == subaperture)
            seen = antennas.phases(own.subaperture_centers[subaperture], points[members])
            parts |= zip(members[: len(seen)].tolist(), seen, strict=True)
        found += [parts[place] for place in sorted(parts)]
    return found


def response_at(
    signal: NDArray[np.complexfloating], path_m: Floats, waveform: Waveform
) -> NDArray[np.complex128]:
    """Each antenna's samples, (n, n_samples), against paths of its own, (..., n) [m], Hann window.

    Paths include the waveform's bias. Frequencies are equal steps, so that the sum is a polynomial
    in the phase of one (Horner): twenty times as fast as one exponential a sample. (..., n).
    """
    turn = 2j * np.pi / SPEED_OF_LIGHT_M_PER_S * path_m
    step = np.exp(turn * waveform.bandwidth_hz / waveform.n_samples)
    weighted = (signal * np.hanning(waveform.n_samples + 2)[1:-1]).T.copy()
    total = np.zeros(path_m.shape, dtype=np.complex128)
    for column in weighted[::-1]:
        total *= step
        total += column
    return np.asarray(total * np.exp(turn * waveform.frequencies_hz[0]))


class _Antennas:
    """Antennas of a pose, of which sub-apertures are cut."""

    def __init__(self, pose: Pose, number: int, waveform: Waveform, size_m: float) -> None:
        self.pose, self.number, self.waveform, self.size_m = pose, number, waveform, size_m
        self.centers = pose.phase_centers
        self.across = self.centers @ pose.axes[1:].T

    def phases(self, center: Floats, points: Floats) -> list[EchoPhases]:
        """Echoes from points (n_echoes, 3) [m] in the sub-aperture about a centre; none of few."""
        pose, waveform = self.pose, self.waveform
        places = self.across - pose.axes[1:] @ center
        inside = np.flatnonzero((np.abs(places) < 0.5 * self.size_m).all(axis=1))
        if len(inside) < _MIN_ANTENNAS:
            return []
        places = places[inside]
        window = np.prod(np.cos(np.pi / self.size_m * places), axis=1) ** 2
        to_points = points[:, None] - self.centers[inside]
        distances = _lengths(to_points)
        path = _lengths(points[:, None] - pose.tx_positions[inside])
        path += _lengths(points[:, None] - pose.rx_positions[inside]) + waveform.path_bias_m
        values = window * response_at(pose.signal[inside], path, waveform)
        flat = _flattened(values, places, waveform, distances.mean(axis=1))
        return [
            EchoPhases(
                pose=self.number,
                antennas=inside,
                values=own,
                directions=direction,
                looking=pose.axes[0],
                places_m=places,
            )
            for own, direction in zip(flat, to_points / distances[..., None], strict=True)
        ]


def _lengths(vectors: Floats) -> Floats:
    """Of each row; a third of the time of a norm."""
    return np.asarray(np.sqrt(np.einsum("...j,...j->...", vectors, vectors)))


def _flattened(
    values: NDArray[np.complex128], places: Floats, waveform: Waveform, ranges_m: Floats
) -> NDArray[np.complex128]:
    """Take off the wavefront's curvature that a smooth surface has less of than a point.

    A surface of radius rho at range R answers with the path 2 R + s^2 / (R + rho) over the place s
    on the aperture, a point with 2 R + s^2 / R. Values (n_echoes, n), places (n, 2).
    """
    k = 2.0 * np.pi / waveform.center_wavelength_m
    one = np.exp(-1j * k * _CURVATURES[1] / ranges_m[:, None, None] * places.T**2)
    bend = np.ones((len(_CURVATURES), *one.shape), dtype=np.complex128)  # (n_tried, n_echoes, 2, n)
    for number in range(1, len(bend)):
        np.multiply(bend[number - 1], one, out=bend[number])
    bent, across = values[:, None] * bend[:, :, 0].swapaxes(0, 1), bend[:, :, 1]
    sums = np.abs(bent @ across.transpose(1, 2, 0)).reshape(len(values), -1)
    first, second = np.divmod(sums.argmax(axis=1), len(_CURVATURES))
    every = np.arange(len(values))
    return np.asarray(bent[every, first] * across[second, every])
