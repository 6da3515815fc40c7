"""Slow errors of the antennas' recorded positions, estimated by focusing.

Gauss-Newton steps on the phases of the matched filter's terms. A displacement delta of antenna i
changes its term by exp(-2 j k u_i . delta), with the direction u_i to the reflector. Displacements
are cubic splines along the trajectory of each pose, in its looking direction, which has the largest
effect. Each echo has a free shift, slope and curvature of its phase, because a surface may have any
position, orientation and curvature (docs/math/calibration.md#positions).
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import groupby
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from geraf2._bounds import Bounded, Few, LengthM
from geraf2._types import Bools, Floats
from geraf2.calibration.acceptance import N_INDEPENDENT, Gain, coherence_nats
from geraf2.echoes.echo_phases import EchoPhases
from geraf2.scene import Capture, Waveform

DRIFT_SIZE_M = 0.10
"""Side of the sub-apertures [m]: in 8 cm too much of a slow drift equals a curvature."""

_N_ROUNDS = 6
# Phases are sums of at least _MIN_PER_BIN antennas, about a column of a sub-aperture each.
_MAX_BINS = 24
_MIN_PER_BIN = 8
# Singular value, relative to the largest, of shifts, slopes and curvatures that count as separable.
_MIN_MODE = 0.05
# Lower bound of the phase variance of an echo [rad^2].
_MIN_PHASE_VARIANCE = 0.01
_DEGREE = 3


@dataclass(frozen=True, kw_only=True)
class AutofocusConfig(Bounded):
    """Model of the antennas' drift."""

    n_coefficients: Annotated[int, Interval(ge=_DEGREE + 1, le=1000)] = 12
    """Number of coefficients of the spline along the antennas of each plane; at least 4."""
    sigma_m: LengthM = 0.0005
    """Expected displacement [m]."""
    n_at_once: Few = 1
    """Successive antennas that are recorded at one time, and move alike."""


@dataclass(frozen=True, kw_only=True, eq=False)
class AntennaDrift:
    """Displacements of the antennas, to be added to the recorded positions."""

    coefficients_m: Floats
    """Coefficients of the splines, along each pose's looking direction, (n_poses, n) [m]."""
    sigma_m: float
    """RMS of their standard deviations [m]."""
    coherence_before: float
    """Mean |sum z| / sum |z| of held-out echoes."""
    coherence_after: float
    gain: Gain
    """Gain of held-out echoes."""

    def displacements(self, pose: int, n_antennas: int) -> Floats:
        """Displacement of each antenna along the pose's looking direction, (n_antennas,) [m]."""
        basis = trajectory_basis(n_antennas, self.coefficients_m.shape[1])
        return np.asarray(basis @ self.coefficients_m[pose])

    def rms_m(self, capture: Capture) -> float:
        """RMS displacement [m]."""
        parts = [self.displacements(i, p.n_antennas) for i, p in enumerate(capture.poses)]
        each = np.concatenate([np.zeros(0), *parts])
        return float(np.sqrt((each**2).sum() / max(len(each), 1)))


@lru_cache(maxsize=64)
def trajectory_basis(n_antennas: int, n_coefficients: int, n_at_once: int = 1) -> Floats:
    """Cubic splines over the antennas of a pose in their order, (n_antennas, n_coefficients).

    n_at_once: successive antennas with the same value.
    """
    from scipy.interpolate import BSpline  # noqa: PLC0415 - takes 0.1 s to import

    if n_antennas == 0:
        return np.zeros((0, n_coefficients))
    inner = np.linspace(0.0, 1.0, n_coefficients - _DEGREE + 1)
    knots = np.concatenate([np.zeros(_DEGREE), inner, np.ones(_DEGREE)])
    position = (np.arange(n_antennas) // n_at_once + 0.5) * n_at_once / n_antennas
    return np.asarray(BSpline.design_matrix(position, knots, _DEGREE).toarray())


def focus_antennas(
    capture: Capture, echoes: Iterable[EchoPhases], config: AutofocusConfig | None = None
) -> AntennaDrift:
    """Displacements at which the phases of echoes agree best.

    There are three estimates: from each half of the echoes, tested by the other half, and from all.
    Echoes of one plane err together: they share antennas, and what a thin body does to the phases.

    echoes: strong echoes of the capture, with the phases of channels removed; those of a plane
        one after the other.
    config: model of the displacements.
    """
    config = config or AutofocusConfig()
    n, n_poses = config.n_coefficients, len(capture.poses)
    coefficients = np.zeros((n_poses, n))
    variances = np.full((n_poses, n), config.sigma_m**2)
    judged = [np.zeros((3, 0))]
    # One plane at a time: its phases take some megabytes.
    for pose, group in groupby(echoes, key=lambda echo: echo.pose):
        basis = trajectory_basis(capture.poses[pose].n_antennas, n, config.n_at_once)
        every = _Phases.of(list(group), basis, capture.waveform)
        is_first = np.arange(len(every.root)) % 2 == 0
        for half in (is_first, ~is_first):
            trial, _ = _estimate(every.select(half), config)
            others = every.select(~half)
            # The free shift, slope and curvature of each echo are removed in both cases.
            both = (others.coherence(values) for values in (np.zeros(n), trial))
            judged.append(np.stack([np.full(len(others.root), pose), *both]))
        coefficients[pose], variances[pose] = _estimate(every, config)
    plane, before, after = np.concatenate(judged, axis=1)
    nats = coherence_nats(before, after)
    by_plane = np.bincount(np.unique(plane, return_inverse=True)[1], nats).astype(np.float64)
    return AntennaDrift(
        coefficients_m=coefficients,
        sigma_m=float(np.sqrt(variances.mean())),
        coherence_before=float(before.mean()) if len(before) else 0.0,
        coherence_after=float(after.mean()) if len(after) else 0.0,
        gain=max(Gain.of(nats), Gain.of(by_plane), key=lambda gain: gain.error),
    )


def with_displacements(capture: Capture, coefficients_m: Floats, n_at_once: int = 1) -> Capture:
    """Capture with antennas displaced by splines along each pose's looking direction.

    coefficients_m: of the splines, (n_poses, n_coefficients) [m].
    n_at_once: successive antennas with the same displacement.
    """
    poses = []
    for pose, own in zip(capture.poses, coefficients_m, strict=True):
        shift_m = trajectory_basis(pose.n_antennas, len(own), n_at_once) @ own
        poses.append(pose.moved(shift_m[:, None] * pose.axes[0]))
    return replace(capture, poses=tuple(poses))


def _estimate(echoes: "_Phases", config: AutofocusConfig) -> tuple[Floats, Floats]:
    """Coefficients of a plane [m] and their variances [m^2], (n,) each."""
    n = config.n_coefficients
    solution, matrix = np.zeros(n), np.eye(n) / config.sigma_m**2
    for _ in range(_N_ROUNDS if len(echoes.root) else 0):
        matrix, vector = echoes.normal_equations(solution)
        matrix += np.eye(n) / config.sigma_m**2
        vector -= solution / config.sigma_m**2
        solution = solution + np.linalg.solve(matrix, vector)
    return solution, np.diag(np.linalg.inv(matrix))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Phases:
    """Phases of the echoes of a pose as linear functions of the coefficients.

    The free modes of each echo are removed. Consecutive antennas are summed: the sums exceed the
    noise, and their phases change slowly enough to be unwrapped.
    """

    sums: NDArray[np.complex128]  # (n_echoes, n_bins)
    phase: Floats  # radians per metre of each coefficient, (n_echoes, n_bins, n_coefficients)
    free: Floats  # constant, slopes, curvatures; orthonormal with `root`, (n_echoes, n_bins, 6)
    root: Floats  # square root of the weight, (n_echoes, n_bins)

    @classmethod
    def of(cls, echoes: list[EchoPhases], basis: Floats, waveform: Waveform) -> "_Phases":
        sums = np.zeros((len(echoes), _MAX_BINS), dtype=np.complex128)
        weights, modes = np.zeros(sums.shape), np.zeros((*sums.shape, 6))
        phase = np.zeros((*sums.shape, basis.shape[1]))
        k = 2.0 * np.pi / waveform.center_wavelength_m
        for number, echo in enumerate(echoes):
            n_antennas = len(echo.antennas)
            n_bins = max(4, min(_MAX_BINS, n_antennas // _MIN_PER_BIN))
            starts = -(-np.arange(n_bins) * n_antennas // n_bins)
            size = np.abs(echo.values)
            weight = np.add.reduceat(size, starts)
            h, v = echo.offsets_m.T / (0.5 * DRIFT_SIZE_M)
            columns = np.stack([size, size * h, size * v, size * h * h, size * h * v, size * v * v])
            path = (2.0 * k * size * echo.cosines) * basis.T[:, echo.antennas]
            binned = np.add.reduceat(np.concatenate([columns, path]), starts, axis=1).T
            binned /= np.maximum(weight, 1e-300)[:, None]
            sums[number, :n_bins] = np.add.reduceat(echo.values, starts)
            sums[number, n_bins:] = sums[number, n_bins - 1]
            weights[number, :n_bins] = weight
            modes[number, :n_bins], phase[number, :n_bins] = binned[:, :6], binned[:, 6:]
        root = np.sqrt(weights / weights.sum(axis=1, keepdims=True))
        left, strength, _ = np.linalg.svd(root[..., None] * modes, full_matrices=False)
        known = strength > _MIN_MODE * strength[:, :1]
        return cls(sums=sums, phase=phase, free=left * known[:, None], root=root)

    def select(self, keep: Bools) -> "_Phases":
        """Keep some of the echoes, by mask."""
        return _Phases(**{name: getattr(self, name)[keep] for name in self.__dataclass_fields__})

    def residual(self, coefficients: Floats) -> Floats:
        """Phase without model and free modes, weighted by `root`, (n_echoes, n_bins) [rad]."""
        focused = self.sums * np.exp(-1j * self.phase @ coefficients)
        return self._without_free(self.root * np.unwrap(np.angle(focused), axis=1))

    @cached_property
    def design(self) -> Floats:
        """Derivative of the residual by the coefficients, negative, (n_echoes, n_bins, n)."""
        return self._without_free(self.root[..., None] * self.phase)

    def normal_equations(self, coefficients: Floats) -> tuple[Floats, Floats]:
        """Matrix and vector of the normal equations of all echoes, (n, n) and (n,)."""
        residual = self.residual(coefficients)
        # Phase noise of the echo itself, from the current residual.
        variance = np.maximum((residual**2).sum(axis=1), _MIN_PHASE_VARIANCE)
        scale = np.sqrt(N_INDEPENDENT / variance)
        design = (scale[:, None, None] * self.design).reshape(-1, self.phase.shape[2])
        return design.T @ design, design.T @ (scale[:, None] * residual).ravel()

    def coherence(self, coefficients: Floats) -> Floats:
        """|sum z| / sum |z| over bins, without the free modes, (n_echoes,)."""
        residual = self.residual(coefficients) / np.where(self.root > 0.0, self.root, 1.0)
        return np.asarray(np.abs((self.root**2 * np.exp(1j * residual)).sum(axis=1)))

    def _without_free(self, values: Floats) -> Floats:
        """Remove the free modes from values (n_echoes, n_bins), or with one more axis."""
        n_columns = values.shape[2] if values.ndim == 3 else 1  # -1 fails without echoes
        columns = values.reshape(*self.root.shape, n_columns)
        rest = columns - self.free @ (self.free.swapaxes(1, 2) @ columns)
        return np.asarray(rest.reshape(values.shape))
