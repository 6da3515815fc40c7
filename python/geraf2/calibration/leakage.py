"""Direct leakage between transmitter and receiver: estimation and subtraction.

Leakage is the direct path, objects right in front of the antennas, and a constant of the converter.
Its delays are shorter than those of the box, and it may be much stronger. Sinusoids of short delays
are fitted to each antenna's samples and subtracted. Steady leakage also gives the phase of each
antenna's samples (docs/math/calibration.md#leakage).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Floats
from geraf2.calibration.channel_phase import phase_gain, with_phases
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.echoes.echo_phases import collect_phases
from geraf2.errors import UserError
from geraf2.geometry.triangles import face_areas, unit_normals
from geraf2.imaging.peaks import KeptPeaks
from geraf2.scene import Capture, LosPrior, Pose, Waveform

_Complex = NDArray[np.complex64]
LeakageMethod = Literal["none", "projected", "reference"]
"""Unchanged; short delays subtracted; the leakage's phase also removed from each antenna."""

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
_N_POSES = 3
# Largest share of clipped samples at which steady leakage can still be subtracted.
_MAX_CLIPPED = 0.5


@dataclass(frozen=True, kw_only=True, eq=False)
class Leakage:
    """Leakage of a capture, and the values to subtract it."""

    method: LeakageMethod
    reason: str
    """Reason for this method, with values."""
    level_db: float = -np.inf
    """Energy of the leakage relative to that of everything else but noise [dB]."""
    delays_m: tuple[float, float] = (0.0, 0.0)
    """Shortest and longest two-way path subtracted, without instrument delay [m]. Both are 0 for a
    background of any delays that all antennas share."""
    steadiness: float = 0.0
    """Share of the leakage that is the same for all antennas up to a factor."""
    tail_db: float = -np.inf
    """Energy of its part at the delays of the box, relative to its own [dB]."""
    phase_rms_deg: float = 0.0
    """RMS of the removed phases about each pose's mean [degrees]."""
    basis: _Complex | None = None
    """Waveforms of the leakage, (n_samples, rank)."""
    coefficients: tuple[_Complex, ...] = ()
    """Coefficients of the basis of each pose, (n_antennas, rank)."""
    phases_rad: tuple[Floats, ...] = ()
    """Phase removed from each antenna of each pose, (n_antennas,) [rad]; empty: none."""
    operator: _Complex | None = None
    """Matrix that gives the coefficients from samples, (n_samples, rank); None where all antennas
    have the same ones, and for stored leakage."""

    def of_more(self, poses: Sequence[Pose], wavelength_m: float) -> "Leakage | None":
        """Leakage of a capture with further poses, which come last; None if that needs an estimate.

        poses: all of them. wavelength_m: at the middle of the chirp [m].
        """
        if self.method == "none":
            return self
        more, same = list(self.coefficients), self.coefficients[0][:1]
        has_phase = self.method == "reference"
        if self.operator is None and (has_phase or any((own != same).any() for own in more)):
            return None
        new = poses[len(more) :]
        for pose in new:
            if self.operator is None:
                more.append(np.repeat(same, pose.n_antennas, axis=0))
            else:
                more.append(np.asarray(pose.signal @ self.operator))
        phases = list(self.phases_rad)
        if has_phase:
            main = _strongest_waveform(self.coefficients).conj()
            own = [coefficient @ main for coefficient in more[len(phases) :]]
            phases += _phases(new, own, wavelength_m)
        return replace(self, coefficients=tuple(more), phases_rad=tuple(phases))

    @property
    def numbers(self) -> dict[str, float]:
        """Level [dB], steadiness and RMS of the phases [rad], if finite."""
        numbers = {"level_db": self.level_db, "steadiness": self.steadiness}
        if self.method == "reference":
            numbers["phase_rms_rad"] = float(np.deg2rad(self.phase_rms_deg))
        return {name: value for name, value in numbers.items() if np.isfinite(value)}

    def __str__(self) -> str:
        if self.method == "none":
            return f"unchanged: {self.reason}"
        low, high = (1e3 * length for length in self.delays_m)
        where = f"at {low:.0f} to {high:.0f} mm of path" if high else "the same at all antennas"
        what = "subtracted" if self.method == "projected" else "subtracted, its phase removed"
        return f"{self.level_db:.1f} dB over the echoes, {where}, {what}: {self.reason}"


def find_leakage(capture: Capture, prior: LosPrior, peaks: KeptPeaks | None = None) -> Leakage:
    """Estimate the signal with shorter delays than the box, and whether its phase helps.

    capture: the scan; its instrument delay must be right to 15 cm of path.
    prior: outside of the box; any other delay may be that of an echo.

    Raises UserError if the leakage saturates the converter for most samples.
    """
    waveform = capture.waveform
    poses = [pose for pose in capture.poses if pose.n_antennas]
    if not poses:
        return Leakage(method="none", reason="there are no antennas")
    near, box = _paths(poses, waveform, prior)
    fit = leakage_operator(waveform, near, box)
    if fit is None:
        return Leakage(
            method="none", reason="delays are too coarse to separate leakage from the box"
        )
    basis, taken = fit
    coefficients = tuple(pose.signal @ taken for pose in capture.poses)
    in_noise = float((np.abs(taken) ** 2).sum())
    level_db, over_noise = _level(capture, coefficients, basis, in_noise)
    references, steadiness = _references(coefficients)
    nothing = Leakage(
        method="none",
        reason="no signal in front of the box",
        level_db=level_db,
        steadiness=steadiness,
    )
    if level_db < _MIN_LEVEL_DB or over_noise < _MIN_OVER_NOISE:
        return _background(capture, prior, nothing)
    if steadiness < _MIN_STEADINESS:
        reason = f"the signal in front of the box is not steady ({steadiness:.2f})"
        return _background(capture, prior, replace(nothing, reason=reason))
    clipped = clipped_share(capture)
    if clipped > _MAX_CLIPPED:
        raise UserError(
            what="leakage between transmitter and receiver saturates the converter",
            expected=f"at most {100 * _MAX_CLIPPED:g} % of the samples at its extreme values",
            got=f"{100 * clipped:.0f} %, leakage {level_db:.0f} dB over the echoes",
            hint="lower the receiver gain",
        )
    found = Leakage(
        method="projected",
        reason="",
        level_db=level_db,
        delays_m=near,
        steadiness=steadiness,
        basis=basis,
        coefficients=coefficients,
        operator=taken,
    )
    found = _with_tail(capture, prior, found, references, in_noise)
    return _test_phase(capture, found, references, peaks or KeptPeaks(prior))


def without_leakage(capture: Capture, leakage: Leakage) -> Capture:
    """Capture with the leakage subtracted; the same object if there is none."""
    if leakage.method == "none" or leakage.basis is None:
        return capture
    poses = [
        replace(pose, signal=pose.signal - coefficient @ leakage.basis.T)
        for pose, coefficient in zip(capture.poses, leakage.coefficients, strict=True)
    ]
    found = replace(capture, poses=tuple(poses))
    return with_phases(found, [-p for p in leakage.phases_rad]) if leakage.phases_rad else found


def clipped_share(capture: Capture) -> float:
    """Share of real and imaginary parts with the largest or the smallest value of all."""
    parts = [pose.signal.view(np.float32) for pose in capture.poses if pose.signal.size]
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
    capture: Capture, coefficients: tuple[_Complex, ...], basis: _Complex, in_noise: float
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


def _references(coefficients: tuple[_Complex, ...]) -> tuple[list[_Complex], float]:
    """Leakage of each antenna as one number, and the steadiness of its amplitude."""
    main = _strongest_waveform(coefficients).conj()
    found = [np.asarray(coefficient @ main) for coefficient in coefficients]
    size = np.abs(np.concatenate(found)).astype(np.float64)
    return found, float(size.mean() ** 2 / max((size**2).mean(), 1e-300))


def _with_tail(
    capture: Capture,
    prior: LosPrior,
    found: Leakage,
    references: list[_Complex],
    in_noise: float,
) -> Leakage:
    """Add the leakage at other delays: ripple of the chirp or of the receiver."""
    assert found.basis is not None  # the caller has found leakage
    tail = _common_signal(without_leakage(capture, found), prior, references)
    if tail is None:
        return found
    basis = found.basis + np.outer(tail, _strongest_waveform(found.coefficients).conj()).astype(
        np.complex64
    )
    level_db, _ = _level(capture, found.coefficients, basis, in_noise)
    tail_db = 10.0 * float(np.log10(max(float((np.abs(tail) ** 2).sum()), 1e-30)))
    if level_db + tail_db < _MIN_TAIL_DB:
        return found
    own, whole = (
        sum(float(np.linalg.norm(c @ waveforms.T) ** 2) for c in found.coefficients)
        for waveforms in (found.basis, basis)
    )
    level_db += 10.0 * float(np.log10(whole / own))
    return replace(found, basis=basis, level_db=level_db, tail_db=tail_db)


def _background(capture: Capture, prior: LosPrior, nothing: Leakage) -> Leakage:
    """Leakage that all antennas share, if there is none at shorter delays than the box."""
    ones = [np.ones(pose.n_antennas, np.complex64) for pose in capture.poses]
    common = _common_signal(capture, prior, ones)
    size = 0.0 if common is None else float(np.linalg.norm(common))
    if common is None or size == 0.0:
        return nothing
    basis = (common / size).astype(np.complex64)[:, None]
    coefficients = tuple(np.float32(size) * one[:, None] for one in ones)
    level_db, _ = _level(capture, coefficients, basis, 0.0)
    if level_db < _MIN_TAIL_DB:
        return nothing
    return replace(
        nothing,
        method="projected",
        reason="echoes of the box differ between antennas",
        level_db=level_db,
        basis=basis,
        coefficients=coefficients,
    )


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
    # 1.48: standard over median deviation; 1.25: uncertainty of a median over that of a mean.
    sigma = 1.48 * 1.25 * np.median(np.abs(each - common), axis=0) / np.sqrt(len(each))
    return np.asarray(np.fft.ifft(np.where(np.abs(common) > 3.0 * sigma, common, 0.0)))


def _nine_parts(pose: Pose) -> Floats:
    """Mask of the antennas in each of three by three parts of the plane, (9, n_antennas)."""
    local = pose.phase_centers @ pose.axes[1:].T
    span = np.ptp(local, axis=0) + 1e-9
    third = np.floor(3.0 * (local - local.min(axis=0)) / span).clip(0, 2)
    return np.asarray(np.arange(9.0)[:, None] == 3.0 * third[:, 0] + third[:, 1], np.float32)


def _faces_a_wall(pose: Pose, prior: LosPrior) -> bool:
    """Whether a flat part of the prior is parallel to the plane, within ten degrees."""
    corners = prior.vertices[prior.faces]
    cosine = -unit_normals(corners) @ pose.axes[0]
    areas = face_areas(corners)
    return pose.n_antennas == 0 or float(areas[cosine > _FACING].sum()) > _FACING_AREA_M2


def _strongest_waveform(coefficients: tuple[_Complex, ...]) -> _Complex:
    """Coefficients of the strongest waveform, normalised, (rank,)."""
    covariance = sum(c.T @ c.conj() for c in coefficients)
    return np.asarray(np.linalg.eigh(covariance)[1][:, -1])


def _test_phase(
    capture: Capture, found: Leakage, references: list[_Complex], peaks: KeptPeaks
) -> Leakage:
    """Test with the echoes of some poses whether to remove the leakage's phase from the antennas.

    The phases come from the leakage alone, so all echoes are held out.
    """
    filled = [number for number, pose in enumerate(capture.poses) if pose.n_antennas]
    chosen = [filled[i] for i in np.unique(np.linspace(0, len(filled) - 1, _N_POSES).astype(int))]
    clean = without_leakage(capture, found)
    clean = replace(clean, poses=tuple(clean.poses[number] for number in chosen))
    phases = _phases(capture.poses, references, capture.waveform.center_wavelength_m)
    chosen_phases = [phases[number] for number in chosen]
    gain, _, _ = phase_gain(clean, chosen_phases, lambda c: collect_phases(c, peaks.of(c)))
    reason = f"with its phase removed, {gain}"
    if not gain.is_sure:
        return replace(found, reason=reason)
    return replace(
        found,
        method="reference",
        reason=reason,
        phase_rms_deg=float(np.rad2deg(_phase_rms(phases))),
        phases_rad=tuple(phases),
    )


def _phases(
    poses: Sequence[Pose], references: Sequence[_Complex], wavelength_m: float
) -> list[Floats]:
    """Phase of the leakage at each antenna, without that of the direct path."""
    k = 2.0 * np.pi / wavelength_m
    found = []
    for pose, reference in zip(poses, references, strict=True):
        separation = np.linalg.norm(pose.tx_positions - pose.rx_positions, axis=1)
        found.append(np.angle(reference * np.exp(1j * k * separation)))
    return found


def _phase_rms(phases: list[Floats]) -> float:
    """RMS of phases about the mean of their pose [rad]."""
    units = [np.exp(1j * phase) for phase in phases if len(phase)]
    return float(np.sqrt(np.mean(np.concatenate([np.angle(u / u.mean()) ** 2 for u in units]))))
