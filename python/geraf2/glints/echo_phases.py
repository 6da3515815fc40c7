"""What each antenna adds to the strong echoes of its sub-aperture."""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Floats, Ints
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.imaging.subapertures import SubapertureConfig, pose_images
from geraf2.scene import Capture, LosPrior, Pose, Waveform

# How deep below the strongest echo of a pose others are looked at.
_DYNAMIC_RANGE_DB = 15.0
_NOISE_MARGIN_DB = 15.0
_SUBAPERTURES = SubapertureConfig(step_m=0.02, direction_oversampling=2.0)
# A surface between a point (0) and a plane (1) is tried in these steps, per direction.
_CURVATURES = np.linspace(0.0, 1.0, 6)
_MIN_ANTENNAS = 16
# Of the prior's diagonal: its outside is looked at as well, wherever it turns out to stand.
_REACH = 0.6


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
    capture: Capture,
    prior: LosPrior,
    *,
    poses: Collection[int] | None = None,
    step_m: float = 0.02,
    size_m: float = _SUBAPERTURES.size_m,
    n_echoes: int = 60,
    num_threads: int | None = None,
) -> list[EchoPhases]:
    """Strong echoes of the poses from the prior and around it.

    capture: the scan; its instrument delay must be right to a few centimetres.
    prior: outside of the box, roughly in the capture frame.
    poses: numbers of those that are looked at; all when None.
    step_m: from one sub-aperture to the next [m].
    size_m: side of a sub-aperture [m].
    n_echoes: of each pose, the strongest.
    """
    found = []
    target, reach_m = prior.bounds.mean(axis=0), _REACH * float(np.linalg.norm(prior.size_m))
    cut = replace(_SUBAPERTURES, step_m=step_m, size_m=size_m)
    for number, pose in enumerate(capture.poses):
        if pose.n_antennas < _MIN_ANTENNAS or not (poses is None or number in poses):
            continue
        distance = float(np.linalg.norm(pose.phase_centers.mean(axis=0) - target))
        low = max(distance - reach_m, capture.waveform.range_cell_m)
        span = (low, max(distance + reach_m, low + capture.waveform.range_cell_m))
        images = pose_images(pose, capture.waveform, target, span, cut)
        echoes = images.echoes(_DYNAMIC_RANGE_DB, _NOISE_MARGIN_DB, num_threads=num_threads)
        cut_places = _Places(pose, size_m)
        strongest = np.argsort(-echoes.magnitudes, kind="stable")[:n_echoes]
        for index in strongest:
            center = echoes.centers[index]
            point = center + echoes.ranges_m[index] * echoes.directions[index]
            one = _phases(cut_places, capture.waveform, number, center, point)
            if one is not None:
                found.append(one)
    return found


def response_at(
    signal: NDArray[np.complexfloating], path_m: Floats, waveform: Waveform
) -> NDArray[np.complex128]:
    """Each antenna's samples, (n, n_samples), against one path of its own, (n,) [m], Hann window.

    Paths include the waveform's bias. Frequencies are equal steps, so that the sum is a polynomial
    in the phase of one (Horner): twenty times as fast as one exponential a sample. (n,).
    """
    turn = 2j * np.pi / SPEED_OF_LIGHT_M_PER_S * path_m
    frequencies = waveform.frequencies_hz
    step = np.exp(turn * waveform.bandwidth_hz / waveform.n_samples)
    weighted = (signal * np.hanning(waveform.n_samples + 2)[1:-1]).T.copy()
    total = np.zeros(len(path_m), dtype=np.complex128)
    for column in weighted[::-1]:
        total *= step
        total += column
    return np.asarray(total * np.exp(turn * frequencies[0]))


class _Places:
    """Antennas of a pose in the sub-apertures that echoes were found in, each worked out once."""

    def __init__(self, pose: Pose, size_m: float) -> None:
        self.pose, self.centers, self.size_m = pose, pose.phase_centers, size_m
        self.across = self.centers @ pose.axes[1:].T
        self.known: dict[bytes, tuple[Ints, Floats, Floats, Pose]] = {}

    def around(self, center: Floats) -> tuple[Ints, Floats, Floats, Pose]:
        """Antennas of a sub-aperture, (n,), and a pose of them alone.

        Between the two their places about its middle, (n, 2) [m], and window, (n,).
        """
        key = center.tobytes()
        if key not in self.known:
            places, size = self.across - self.pose.axes[1:] @ center, self.size_m
            inside = np.nonzero((np.abs(places) < 0.5 * size).all(axis=1))[0]
            window = np.prod(np.cos(np.pi * places[inside] / size), axis=1) ** 2
            own = replace(
                self.pose,
                signal=self.pose.signal[inside],
                tx_positions=self.pose.tx_positions[inside],
                rx_positions=self.pose.rx_positions[inside],
            )
            self.known[key] = inside, places[inside], window, own
        return self.known[key]


def _phases(
    cut: _Places, waveform: Waveform, number: int, center: Floats, point: Floats
) -> EchoPhases | None:
    inside, places, window, own = cut.around(center)
    if len(inside) < _MIN_ANTENNAS:
        return None
    to_point = point - cut.centers[inside]
    distance = _lengths(to_point)
    path = _lengths(point - own.tx_positions) + _lengths(point - own.rx_positions)
    values = window * response_at(own.signal, path + waveform.path_bias_m, waveform)
    return EchoPhases(
        pose=number,
        antennas=inside,
        values=_flattened(values, places, waveform, float(distance.mean())),
        directions=to_point / distance[:, None],
        looking=own.axes[0],
        places_m=places,
    )


def _lengths(vectors: Floats) -> Floats:
    """Of each row; a third of the time of a norm."""
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", vectors, vectors)))


def _flattened(
    values: NDArray[np.complex128], places: Floats, waveform: Waveform, range_m: float
) -> NDArray[np.complex128]:
    """Take off the wavefront's curvature that a smooth surface has less of than a point.

    A surface of radius rho at range R answers with the path 2 R + s^2 / (R + rho) over the place s
    on the aperture, a point with 2 R + s^2 / R.
    """
    k = 2.0 * np.pi / waveform.center_wavelength_m
    one = np.exp(-1j * k / range_m * places**2 * _CURVATURES[1])
    bend = one[:, :, None] ** np.arange(len(_CURVATURES))  # (n, 2, n_tried)
    sums = np.abs((values[:, None] * bend[:, 0]).T @ bend[:, 1])
    a, b = np.unravel_index(int(sums.argmax()), sums.shape)
    return np.asarray(values * bend[:, 0, a] * bend[:, 1, b])


def mean_coherence(echoes: list[EchoPhases]) -> float:
    """Mean coherence over echoes; 0 without any."""
    return float(np.mean([echo.coherence for echo in echoes])) if echoes else 0.0
