"""Sign of the phase of a capture, determined by focusing.

A path of length d gives exp(-j 2 pi (nu + k t) d / c) here; other software stores the complex
conjugate. Only the right sign focuses. The wrong one doubles the curvature of the echo's wavefront
over the aperture instead of cancelling it, and mirrors ranges about half the unambiguous range. A
single plane on a raster is focused at all depths. Its strongest echo may be flat, which both signs
focus equally, so the sharpest slices of both signs are compared.
"""

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from geraf2._types import Floats
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.errors import UserError
from geraf2.imaging.plane_waves import search_depth
from geraf2.io.container import join_parts
from geraf2.io.samples import complex_pose
from geraf2.ops import matched_filter
from geraf2.records import RawPose
from geraf2.scene import Pose, Waveform

# Least ratio of the focused powers of both signs that decides; white noise stays below 1.25.
_CLEAR_RATIO = 1.5
# Antennas, samples and step in range cells of a quick check. If its ratio is below the next value,
# a full check decides. From that ratio on, the evidence also overrides the sign of the format.
_QUICK_ANTENNAS, _QUICK_SAMPLES, _QUICK_STEP = 128, 64, 1.0
_DECIDED_RATIO = 8.0
_MAX_ANTENNAS, _STEP = 512, 0.5
_MAX_POSES = 4
# Antennas of a pose from which _MAX_ANTENNAS are drawn at random, since even steps may coincide
# with the rows of a raster.
_N_SAMPLED = 4096
_N_OF_RASTER = 1 << 16  # for a single plane, which needs its whole raster
_N_DIRECTIONS = 25
_MAX_COSINE = 0.5


EVIDENCE_KEY = "phase_sign_evidence"
"""Entry of a scene's provenance."""


@dataclass(frozen=True, kw_only=True)
class PhaseSign:
    """Sign of the phase, and the evidence for it."""

    sign: int
    """-1 if the capture follows exp(-j 2 pi f d / c), +1 if it must be conjugated."""
    evidence: float
    """Largest focused power with this sign over that with the other sign; of a single plane that is
    searched in depth its largest sharpness, sum(power^2) / sum(power)^2, which no gain changes."""
    n_poses: int
    """Number of poses used."""
    depth_m: float | None = None
    """Depth at which a single plane is sharpest [m]; None where power decides."""
    stated: int | None = None
    """Sign by the format or the spectrum; only a large ratio overrides it."""
    is_forced: bool = False
    """Whether `stated` is used for any evidence."""

    @property
    def is_clear(self) -> bool:
        """Whether the evidence decides if nothing is stated."""
        return self.evidence >= _CLEAR_RATIO

    @property
    def is_positive(self) -> bool:
        """Whether the capture must be conjugated."""
        if self.stated is None or (self.evidence >= _DECIDED_RATIO and not self.is_forced):
            return self.sign > 0
        return self.stated > 0

    @property
    def provenance(self) -> dict[str, str]:
        """Entries of the provenance of a scene."""
        return {"phase_sign": "+1" if self.is_positive else "-1", EVIDENCE_KEY: str(self)}

    @property
    def doubts(self) -> tuple[str, ...]:
        """Warnings: the evidence does not decide, or contradicts the stated sign."""
        if self.stated is None and not self.is_clear:
            return (
                "the sign of the phase is not clear: check the image, or the positions and delay; "
                "--phase-sign forces it",
            )
        if not self.is_clear or self.stated in (None, self.sign):
            return ()
        if self.is_forced or self.is_positive == ((self.stated or 0) > 0):
            source = "--phase-sign" if self.is_forced else "the format or the spectrum"
            return (
                f"the image focuses better, {self.evidence:.3g} times, with the sign of the phase "
                f"that {source} does not have; --phase-sign {self.sign:+d} takes that one",
            )
        return (
            "the image focuses with the sign of the phase that the format or the spectrum does "
            "not have: check the positions, the looking direction, and I and Q; "
            f"--phase-sign {self.stated:+d} keeps it",
        )

    def __str__(self) -> str:
        name = "exp(+j...), conjugated on import" if self.is_positive else "exp(-j...)"
        if self.is_forced:
            return f"phase sign {name}: as given"
        if self.stated is not None and not (self.is_clear and self.is_positive == (self.sign > 0)):
            why = "prefers the other" if self.is_clear else "does not decide"
            return f"phase sign {name}: by the format or its spectrum; focusing {why}"
        doubt = "" if self.is_clear else "; this is not clear"
        if self.depth_m is not None:
            return (
                f"phase sign {name}: the image {self.depth_m:.3g} m before the plane is "
                f"{self.evidence:.3g} times as sharp as any with the other sign{doubt}"
            )
        return (
            f"phase sign {name}: focuses {self.evidence:.3g} times the power of the other sign "
            f"({self.n_poses} planes){doubt}"
        )


class SignSample:
    """Some antennas of some poses for the check of the sign, collected while all are read once.

    n_antennas: of every pose of the capture, in order.
    """

    def __init__(self, n_antennas: Sequence[int]) -> None:
        chosen = range(0, len(n_antennas), max(1, len(n_antennas) // _MAX_POSES))[:_MAX_POSES]
        most = _N_SAMPLED if len(n_antennas) > 1 else _N_OF_RASTER
        self._every = {number: max(1, n_antennas[number] // most) for number in chosen}
        self._n_seen: Counter[int] = Counter()
        self._parts: dict[int, list[RawPose]] = {}

    def add(self, number: int, part: RawPose) -> None:
        """Add the next antennas of pose `number`; copies what it stores."""
        if number not in self._every:
            return
        every = self._every[number]
        rows = np.arange(-self._n_seen[number] % every, part.n_antennas, every)
        self._n_seen[number] += part.n_antennas
        tx, rx = part.tx_positions[rows], part.rx_positions[rows]
        sample = replace(part, signal=part.signal[rows], tx_positions=tx, rx_positions=rx)
        self._parts.setdefault(number, []).append(sample)

    def poses(self) -> list[Pose]:
        """Return the collected poses."""
        return [complex_pose(join_parts(parts)) for parts in self._parts.values()]


def find_phase_sign(
    poses: Sequence[Pose],
    waveform: Waveform,
    *,
    stated: int | None = None,
    num_threads: int | None = None,
) -> PhaseSign:
    """Determine the sign of the phase by focusing with both.

    poses: poses of the capture; at most four, evenly spread, are used.
    stated: -1 or +1 if the capture itself states the sign.
    num_threads: threads of the matched filter.
    """
    usable = [pose for pose in poses if pose.n_antennas > 1]
    chosen = [usable[i] for i in _evenly(len(usable), _MAX_POSES)]
    if len(poses) == 1 and chosen:
        with suppress(UserError):  # irregular or coarse raster: treated like several planes
            plane = replace(_sharpest_of_both(chosen[0], waveform), stated=stated)
            if plane.is_clear or stated is not None:
                return plane
    n_quick = min(waveform.n_samples, _QUICK_SAMPLES)
    beginnings = [replace(pose, signal=pose.signal[:, :n_quick]) for pose in chosen]
    shorter = replace(waveform, n_samples=n_quick)
    quick = _focus_with_both(beginnings, shorter, _QUICK_ANTENNAS, _QUICK_STEP, num_threads)
    if quick.evidence >= _DECIDED_RATIO:
        return replace(quick, stated=stated)
    found = _focus_with_both(chosen, waveform, _MAX_ANTENNAS, _STEP, num_threads)
    return replace(found, stated=stated)


def _sharpest_of_both(pose: Pose, waveform: Waveform) -> PhaseSign:
    """Sharpest slice in front of a single plane with either sign."""
    farthest = 0.5 * waveform.unambiguous_range_m
    depths, right = search_depth(pose, waveform, farthest)
    conjugated = replace(pose, signal=np.conj(pose.signal))
    # The recorded delay belongs to the assumed sign of the samples.
    _, other = search_depth(conjugated, waveform, farthest)
    both = np.array([[right.max()], [other.max()]])
    ratio, sharper = _mean_ratio(both), right if right.max() >= other.max() else other
    return PhaseSign(
        sign=-1 if ratio >= 1.0 else 1,
        evidence=max(ratio, 1.0 / ratio),
        n_poses=1,
        depth_m=float(depths[sharper.argmax()]),
    )


def _focus_with_both(
    poses: Sequence[Pose],
    waveform: Waveform,
    n_antennas: int,
    step_cells: float,
    num_threads: int | None,
) -> PhaseSign:
    peaks = np.zeros((2, len(poses)))
    for number, pose in enumerate(poses):
        antennas = np.sort(np.random.default_rng(number).permutation(pose.n_antennas)[:n_antennas])
        signal = pose.signal[antennas]
        points = _points_in_front(pose, waveform, step_cells)
        tx, rx = pose.tx_positions[antennas], pose.rx_positions[antennas]
        for index, candidate in enumerate((signal, np.conj(signal))):
            image = matched_filter(candidate, tx, rx, points, waveform, num_threads=num_threads)
            peaks[index, number] = float(np.abs(image).max()) ** 2
    ratio = _mean_ratio(peaks)  # geometric, so that no single strong pose decides
    sign = -1 if ratio >= 1.0 else 1
    return PhaseSign(sign=sign, evidence=ratio**-sign, n_poses=len(poses))


def _mean_ratio(values: Floats) -> float:
    good = (values > 0).all(axis=0)
    if not good.any():
        return 1.0
    return float(np.exp(np.mean(np.log(values[0, good] / values[1, good]))))


def _evenly(n: int, n_chosen: int) -> list[int]:
    return sorted({int(i) for i in np.linspace(0, n - 1, min(n, n_chosen))}) if n else []


def _points_in_front(pose: Pose, waveform: Waveform, step_cells: float) -> Floats:
    """Polar grid in front of the aperture over half the unambiguous path, (n_points, 3) [m].

    Ranges have steps of `step_cells` range cells, and at most the depth of focus of the aperture,
    2 lambda r^2 / D^2, near the antennas. Directions are up to 30 degrees off axis. The wrong sign
    moves echoes to the other half of the ranges. The right sign has no echo there, since it would
    be farther than any scan of a box.
    """
    step = 0.5 * step_cells * SPEED_OF_LIGHT_M_PER_S / waveform.bandwidth_hz
    # The path includes the instrument delay, which shifts the ranges.
    farthest = max(0.5 * waveform.unambiguous_range_m, 4 * step)
    ranges = _ranges(step, farthest, waveform.center_wavelength_m, _width_m(pose))
    cosines = np.linspace(-_MAX_COSINE, _MAX_COSINE, _N_DIRECTIONS)
    u_h, u_v, r = (a.ravel() for a in np.meshgrid(cosines, cosines, ranges, indexing="ij"))
    local = np.stack([np.sqrt(1.0 - u_h**2 - u_v**2), u_h, u_v], axis=1)
    return np.asarray(pose.phase_centers.mean(axis=0) + (r[:, None] * local) @ pose.axes)


def _ranges(step: float, farthest: float, wavelength: float, width: float) -> Floats:
    """Ranges in even steps, denser where the depth of focus requires it [m]."""
    even = np.arange(step, farthest, step)
    focused, r = [], max(width, 2 * wavelength)
    while 2 * wavelength * (r / width) ** 2 < step and r < farthest:
        focused.append(r)
        r += 2 * wavelength * (r / width) ** 2
    return np.concatenate([focused, even])


def _width_m(pose: Pose) -> float:
    """Longer side of the aperture [m]."""
    return max(float(np.ptp(pose.phase_centers @ pose.axes[1:].T, axis=0).max()), 1e-9)
