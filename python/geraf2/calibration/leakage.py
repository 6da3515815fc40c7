"""Direct leakage between transmitter and receiver: estimation and subtraction.

Leakage is the direct path, objects right in front of the antennas, and a constant of the converter.
Its delays are shorter than those of the box, and it may be much stronger. Sinusoids of short delays
are fitted to each antenna's samples and subtracted, with their copies at other delays, by ripple of
the chirp (docs/math/calibration.md#leakage).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Floats
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.errors import UserError
from geraf2.geometry.triangles import face_areas, unit_normals
from geraf2.scene import Capture, LosPrior, Pose, Waveform

_Complex = NDArray[np.complex64]

# Two-way path beyond the direct one within which an echo is not content: 4 cm in front [m].
_NEAR_M = 0.08
# Tolerance of the direct path for errors of the instrument delay [m].
_BEFORE_M = 0.02
# Largest share of the energy of an echo of the box that the fit may remove: 0.04 dB.
_MAX_TAKEN = 0.01
_MIN_RANK = 2
# Least share of the leakage in a sinusoid: 55 dB of suppression.
_MIN_SHARE = 1e-7
# Level relative to the echoes below which leakage has no effect; without any the fit finds -25 dB.
_MIN_LEVEL_DB = -15.0
# Least energy over that of noise in the fit.
_MIN_OVER_NOISE = 2.0
# Two-way path behind the box whose multipath the fit must not remove [m].
_BEHIND_M = 0.5
# Assumed ratio of echoes to noise in the fit: the weight of the delays to ignore.
_ECHO_OVER_NOISE = 1000.0
# Least steadiness: leakage has a constant amplitude, unlike an echo in front of the antennas.
_MIN_STEADINESS = 0.9
# Least number of planes for the leakage at other delays.
_MIN_TAIL_POSES = 4
# Level relative to the echoes below which that leakage has no effect; by symmetry, planes around a
# box share echoes at -25 dB.
_MIN_TAIL_DB = -8.0
# A wall is parallel to a plane within ten degrees: otherwise it averages out over 14 cm. Flat parts
# below this area are ignored.
_FACING, _FACING_AREA_M2 = float(np.cos(np.deg2rad(10.0))), 0.0025
# Largest share of clipped samples at which steady leakage can still be subtracted.
_MAX_CLIPPED = 0.5


@dataclass(frozen=True, kw_only=True, eq=False)
class Leakage:
    """Leakage of a capture, and the projection that subtracts it."""

    reason: str = ""
    """Reason for leaving the signal unchanged, with values."""
    level_db: float = -np.inf
    """Energy of the leakage relative to that of everything else but noise [dB]."""
    delays_m: tuple[float, float] = (0.0, 0.0)
    """Shortest and longest two-way path subtracted, without instrument delay [m]."""
    steadiness: float = 0.0
    """Share of the leakage that is the same for all antennas up to a factor."""
    tail_db: float = -np.inf
    """Energy of its part at the delays of the box, relative to its own [dB]."""
    basis: _Complex | None = None
    """Waveforms of the leakage, (n_samples, rank); None without leakage."""
    operator: _Complex | None = None
    """Matrix that gives their coefficients from samples, (n_samples, rank)."""

    @property
    def numbers(self) -> dict[str, float]:
        """Level [dB] and steadiness, if finite."""
        numbers = {"level_db": self.level_db, "steadiness": self.steadiness}
        return {name: value for name, value in numbers.items() if np.isfinite(value)}

    def __str__(self) -> str:
        if self.basis is None:
            return f"unchanged: {self.reason}"
        low, high = (1e3 * length for length in self.delays_m)
        return f"{self.level_db:.1f} dB over the echoes, at {low:.0f} to {high:.0f} mm of path"


def find_leakage(capture: Capture, prior: LosPrior) -> Leakage:
    """Estimate the signal with shorter delays than the box.

    capture: the scan; its instrument delay must be right to 15 cm of path.
    prior: outside of the box; any other delay may be that of an echo.

    Raises UserError if the leakage saturates the converter for most samples.
    """
    waveform = capture.waveform
    poses = [pose for pose in capture.poses if pose.n_antennas]
    if not poses:
        return Leakage(reason="there are no antennas")
    near, box = _paths(poses, waveform, prior)
    fit = leakage_operator(waveform, near, box)
    if fit is None:
        return Leakage(reason="delays are too coarse to separate leakage from the box")
    basis, operator = fit
    coefficients = [pose.signal @ operator for pose in capture.poses]
    in_noise = float((np.abs(operator) ** 2).sum())
    level_db, over_noise = _level(capture, coefficients, basis, in_noise)
    main = _strongest_waveform(coefficients).conj()
    references = [np.asarray(coefficient @ main, np.complex64) for coefficient in coefficients]
    size = np.abs(np.concatenate(references)).astype(np.float64)
    steadiness = float(size.mean() ** 2 / max((size**2).mean(), 1e-300))
    reason = ""
    if level_db < _MIN_LEVEL_DB or over_noise < _MIN_OVER_NOISE:
        reason = "no signal in front of the box"
    elif steadiness < _MIN_STEADINESS:
        reason = f"the signal in front of the box is not steady ({steadiness:.2f})"
    nothing = Leakage(reason=reason, level_db=level_db, steadiness=steadiness)
    if reason:
        return nothing
    clipped = clipped_share(capture)
    if clipped > _MAX_CLIPPED:
        raise UserError(
            what="leakage between transmitter and receiver saturates the converter",
            expected=f"at most {100 * _MAX_CLIPPED:g} % of the samples at its extreme values",
            got=f"{100 * clipped:.0f} %, leakage {level_db:.0f} dB over the echoes",
            hint="lower the receiver gain",
        )
    found = replace(nothing, delays_m=near, basis=basis, operator=operator)
    tail = _common_signal(without_leakage(capture, found), prior, references)
    if tail is None:
        return found
    with_tail = basis + np.outer(tail, main).astype(np.complex64)
    tail_db = 10.0 * float(np.log10(max(float((np.abs(tail) ** 2).sum()), 1e-30)))
    below_db, _ = _level(capture, coefficients, with_tail, in_noise)
    if below_db + tail_db < _MIN_TAIL_DB:
        return found
    own, whole = (
        sum(float(np.linalg.norm(c @ waveforms.T) ** 2) for c in coefficients)
        for waveforms in (basis, with_tail)
    )
    level_db = below_db + 10.0 * float(np.log10(whole / own))
    return replace(found, basis=with_tail, level_db=level_db, tail_db=tail_db)


def without_leakage(capture: Capture, leakage: Leakage) -> Capture:
    """Capture with the leakage subtracted; the same object if there is none."""
    basis, operator = leakage.basis, leakage.operator
    if basis is None or operator is None:
        return capture
    poses = (
        replace(
            pose, signal=np.asarray(pose.signal - pose.signal @ operator @ basis.T, np.complex64)
        )
        for pose in capture.poses
    )
    return replace(capture, poses=tuple(poses))


def clipped_share(capture: Capture) -> float:
    """Share of real and imaginary parts with the largest or the smallest value of all."""
    parts = [pose.signal.view(pose.signal.real.dtype) for pose in capture.poses if pose.signal.size]
    high, low = max(part.max() for part in parts), min(part.min() for part in parts)
    full = sum(int(((part == high) | (part == low)).sum()) for part in parts)
    return full / sum(part.size for part in parts)


def _paths(
    poses: list[Pose], waveform: Waveform, prior: LosPrior
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Shortest and longest two-way path of leakage, and of echoes of the box [m].

    The box's shortest is that to the bounding box of the prior, a lower bound.
    """
    tx, rx = (
        np.concatenate([getattr(p, f"{end}_positions") for p in poses]) for end in ("tx", "rx")
    )
    between, cell = np.linalg.norm(tx - rx, axis=1), 2.0 * waveform.range_cell_m
    near = float(between.min()) - _BEFORE_M, float(between.max()) + _NEAR_M
    wraps = near[0] + 2.0 * waveform.unambiguous_range_m - cell
    nearest, farthest = np.zeros(len(tx)), np.zeros(len(tx))
    for ends in (tx, rx):
        nearest += np.linalg.norm(ends - np.clip(ends, *prior.bounds), axis=1)
        separation = np.abs(ends - prior.bounds[:, None]).max(axis=0)
        farthest += np.linalg.norm(separation, axis=1)
    return near, (float(nearest.min()), min(float(farthest.max()) + _BEHIND_M, wraps))


def _sinusoids(waveform: Waveform, paths_m: Floats) -> _Complex:
    """Compute samples of single paths, instrument delay added, (n_samples, n_paths)."""
    seconds = (paths_m + waveform.path_bias_m) / SPEED_OF_LIGHT_M_PER_S
    return np.asarray(np.exp(-2j * np.pi * np.outer(waveform.frequencies_hz, seconds)))


def _covariance(waveform: Waveform, low_m: float, high_m: float) -> _Complex:
    """Mean v v^H over sinusoids v of all paths in an interval, (n_samples, n_samples)."""
    f = waveform.frequencies_hz
    separation = (f[:, None] - f) / SPEED_OF_LIGHT_M_PER_S
    middle = 0.5 * (low_m + high_m) + waveform.path_bias_m
    return np.asarray(
        np.exp(-2j * np.pi * separation * middle) * np.sinc(separation * (high_m - low_m))
    )


def leakage_operator(
    waveform: Waveform, near_m: tuple[float, float], box_m: tuple[float, float]
) -> tuple[_Complex, _Complex] | None:
    """Weighted least-squares fit of short delays and a constant, insensitive to the box's delays.

    near_m, box_m: two-way paths of leakage and of echoes, without instrument delay [m].

    Returns an orthonormal basis and the matrix that gives its coefficients from samples, both
    (n_samples, rank). The rank suppresses leakage by 55 dB, or less if the fit would remove too
    much of the box's echoes. None if the rank is below two.
    """
    if not near_m[1] < box_m[0] < box_m[1]:
        return None
    cell, period = 2.0 * waveform.range_cell_m, 2.0 * waveform.unambiguous_range_m
    covariance = _covariance(waveform, *near_m)
    # The constant of a converter is not an echo with a delay.
    if (-waveform.path_bias_m - box_m[0] + cell) % period > box_m[1] - box_m[0] + 2.0 * cell:
        covariance += 1.0
    values, vectors = np.linalg.eigh(covariance)
    vectors = vectors[:, ::-1]
    most = int((values > _MIN_SHARE * values[-1]).sum())
    others = _ECHO_OVER_NOISE * _covariance(waveform, *box_m)
    weight = np.linalg.inv(np.eye(waveform.n_samples) + others)
    echoes = _sinusoids(waveform, np.arange(box_m[0], box_m[1], 0.1 * cell))
    for rank in range(most, _MIN_RANK - 1, -1):
        basis = vectors[:, :rank]
        weighted = basis.conj().T @ weight
        operator = np.linalg.solve(weighted @ basis, weighted)
        share = (np.abs(operator @ echoes) ** 2).sum(axis=0) / waveform.n_samples
        if share.max() <= _MAX_TAKEN:
            return basis.astype(np.complex64), operator.T.astype(np.complex64)
    return None


def _level(
    capture: Capture, coefficients: Sequence[_Complex], basis: _Complex, in_noise: float
) -> tuple[float, float]:
    """Energy of leakage relative to the echoes [dB], and relative to noise in the fit.

    in_noise: energy of the coefficients of noise of unit power.
    """
    n = max(capture.n_antennas, 1)
    n_samples, rank = basis.shape
    window = np.hanning(n_samples + 2)[1:-1].astype(np.float32)
    spectrum, rest, leakage = np.zeros(n_samples), 0.0, 0.0
    for pose, coefficient in zip(capture.poses, coefficients, strict=True):
        leakage += float((np.abs(coefficient) ** 2).sum(dtype=np.float64)) / n
        residual = pose.signal - coefficient @ basis.T
        rest += float((np.abs(residual) ** 2).sum(dtype=np.float64)) / n
        spectrum += (np.abs(np.fft.fft(residual * window, axis=1)) ** 2).sum(axis=0) / n
    # The quietest tenth of the delays contains only noise.
    noise = float(np.quantile(spectrum, 0.1) / (window**2).sum())
    in_fit = noise * in_noise
    leakage, rest = max(leakage - in_fit, 0.0), rest - noise * (n_samples - rank)
    if leakage <= 0.0:
        return -np.inf, 0.0
    level_db = 10.0 * float(np.log10(leakage / max(rest, 1e-12 * leakage)))
    return level_db, leakage / max(in_fit, 1e-300)


def _common_signal(
    capture: Capture, prior: LosPrior, references: list[_Complex]
) -> NDArray[np.complex128] | None:
    """Find samples that all antennas share in proportion to their references, (n_samples,).

    They are the same in all parts of all planes. Of the box, only a wall parallel to a plane has
    such an echo, so planes parallel to a wall are not used. None if too few planes remain.
    """
    away = [n for n, pose in enumerate(capture.poses) if not _faces_a_wall(pose, prior)]
    if len(away) < _MIN_TAIL_POSES:
        return None
    parts = []
    for number in away:
        pose, reference = capture.poses[number], references[number]
        member = _nine_parts(pose)
        share = (member * np.abs(reference) ** 2).sum(axis=1)
        mean = (member * reference.conj()) @ pose.signal / np.maximum(share, 1e-30)[:, None]
        parts.append(np.fft.fft(mean[share > 0.0]))
    each = np.concatenate(parts)
    common = np.median(each.real, axis=0) + 1j * np.median(each.imag, axis=0)
    # Standard over median deviation, times the uncertainty of a median over that of a mean.
    sigma = 1.85 * np.median(np.abs(each - common), axis=0) / np.sqrt(len(each))
    return np.asarray(np.fft.ifft(np.where(np.abs(common) > 3.0 * sigma, common, 0.0)))


def _nine_parts(pose: Pose) -> Floats:
    """Mask of the antennas in each of three by three parts of the plane, (9, n_antennas)."""
    local = pose.phase_centers @ pose.axes[1:].T
    span = np.ptp(local, axis=0) + 1e-9
    third = np.floor(3.0 * (local - local.min(axis=0)) / span).clip(0, 2)
    return np.asarray(np.arange(9)[:, None] == 3.0 * third[:, 0] + third[:, 1], np.float32)


def _faces_a_wall(pose: Pose, prior: LosPrior) -> bool:
    """Whether a flat part of the prior is parallel to the plane, within ten degrees."""
    corners = prior.vertices[prior.faces]
    cosine = -unit_normals(corners) @ pose.axes[0]
    areas = face_areas(corners)
    return pose.n_antennas == 0 or float(areas[cosine > _FACING].sum()) > _FACING_AREA_M2


def _strongest_waveform(coefficients: Sequence[_Complex]) -> _Complex:
    """Coefficients of the strongest waveform, normalised, (rank,)."""
    covariance = sum(c.T @ c.conj() for c in coefficients)
    return np.asarray(np.linalg.eigh(covariance)[1][:, -1])
