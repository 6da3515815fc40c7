"""Residual field: small echoes beside a finished surface, for power that it leaves unexplained.

The field is the lensless model for low opacity: its samples do not hide each other, and only the
surface hides them. Their phases are unknown, so their powers add
(docs/math/heat-maps.md#residual-field).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.optimize import minimize

from geraf2._types import Floats, Ints, Progress
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.imaging.volume import pose_image
from geraf2.ops import signal_tracer
from geraf2.scene import Grid, Pose, Waveform
from geraf2.surfaces.config import ResidualFieldConfig
from geraf2.surfaces.facets import SurfaceRenderer
from geraf2.surfaces.surface_fit import SurfaceEcho, spread_evenly

_FOLDS = 4
"""Number of groups of planes in the cross-validation."""
_MIN_PLANES = 3
"""Planes that must see a voxel before it may hold an echo."""
_QUARTER = 0.25
"""Quantile over the planes of the unexplained power that bounds a voxel's power."""
_MIN_GAIN_DB = 0.1
"""Least decrease of the left-out planes' squared error that keeps a field [dB]."""
_MAX_STEPS = 40
_LOOK_PERIOD = (4, 4, 1)
"""Voxels along x, y, z between samples with the same look, more than a plane's resolution."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualField:
    """Small echoes of unknown phase beside a surface."""

    points: Floats
    """Voxel positions, (n_points, 3) [m]."""
    power: Floats
    """abs(P)^2 at each point, as if it were in the middle of the scene, (n_points,)."""
    looks: Ints
    """Look number of each point, (n_points,); points with the same number share a signal."""

    def arrays(self) -> dict[str, Floats]:
        """Arrays by name, for a checkpoint."""
        return {name: np.asarray(values, np.float64) for name, values in vars(self).items()}

    @classmethod
    def of_arrays(cls, arrays: dict[str, Floats]) -> "ResidualField":
        """Inverse of :meth:`arrays`."""
        looks = arrays["looks"].astype(np.int64)
        return cls(points=arrays["points"], power=arrays["power"], looks=looks)


class FittedField(NamedTuple):
    """Outcome of `fit_residual_field`."""

    field: ResidualField
    """Empty if no field lowered the error."""
    gain_db: float
    """Decrease of the squared error of left-out planes; 0 if empty [dB]."""


class PlaneAtTargets(NamedTuple):
    """Targets of one plane: voxels at which its heat map is compared."""

    matrix: NDArray[np.float32]
    """Largest power that each point may add at a target, (n_targets, n_points)."""
    surface: Floats
    """Power of the surface's image, (n_targets,)."""
    measured: Floats
    """Magnitudes of the measured image, (n_targets,)."""
    weights: Floats
    """Number of voxels that each target represents, (n_targets,)."""


def surface_image(
    renderer: SurfaceRenderer,
    echo: SurfaceEcho,
    pose: Pose,
    grid: Grid,
    *,
    num_threads: int | None = None,
) -> NDArray[np.complex64]:
    """Image of a surface and its box, rendered for a plane's antennas, grid.shape."""
    shares = echo.reflectivity_at(renderer.content.points)[None]
    factors = echo.power * np.concatenate([[1.0], echo.walls])
    signal = np.tensordot(factors, renderer.render(pose, shares), axes=1).astype(np.complex64)
    return pose_image(pose, grid, renderer.waveform, signal=signal, num_threads=num_threads)


def field_power(
    renderer: SurfaceRenderer,
    field: ResidualField,
    pose: Pose,
    grid: Grid,
    *,
    seed: int = 0,
    num_threads: int | None = None,
) -> Floats:
    """Power that a field adds to a plane's heat map, grid.shape.

    The power is summed over look numbers. Samples with the same number are farther apart than the
    resolution, and have random phases.
    """
    phases = np.exp(2j * np.pi * np.random.default_rng(seed).random(len(field.points)))
    amplitudes = np.sqrt(field.power) / renderer.waveform.n_samples * phases
    total = np.zeros(grid.shape)
    for look in np.unique(field.looks):
        chosen = np.flatnonzero((field.looks == look) & (field.power > 0.0))
        signal = np.zeros((pose.n_antennas, renderer.waveform.n_samples), np.complex64)
        for group in renderer.groups(pose):
            lit = renderer.lit_points(field.points[chosen], pose.phase_centers[group].mean(axis=0))
            if lit.index.size:
                signal[group] = signal_tracer(
                    (amplitudes[chosen[lit.index]] * lit.spreading).astype(np.complex64),
                    lit.points,
                    pose.tx_positions[group],
                    pose.rx_positions[group],
                    renderer.waveform,
                    num_threads=num_threads,
                )
        image = pose_image(pose, grid, renderer.waveform, signal=signal, num_threads=num_threads)
        total += np.abs(image).astype(np.float64) ** 2
    return total


def power_matrix(
    renderer: SurfaceRenderer, pose: Pose, points: Floats, targets: Floats
) -> NDArray[np.float32]:
    """Power at targets of an echo of power 1 at each of the points, (n_targets, n_points).

    The power is abs(K)^2 with

        K(x, v) = (1 / N) sum_g V_gv (R_0 / R_gv)^2 D(d_g(x) - d_g(v))
                  sum_(i in g) exp(j k (d_i(x) - d_i(v)))

    for groups g of the N antennas. V is 1 if a group has a line of sight to v, and d is the two-way
    path. D is the mean of the chirp's phasors at that path difference, for the centre of the group.
    The carrier's phase is that of each antenna.
    """
    waveform = renderer.waveform
    wavenumber = 2.0 * np.pi / waveform.center_wavelength_m
    total = np.zeros((len(targets), len(points)), np.complex64)
    for group in renderer.groups(pose):
        tx, rx = pose.tx_positions[group], pose.rx_positions[group]
        lit = renderer.lit_points(points, pose.phase_centers[group].mean(axis=0))
        if not lit.index.size:
            continue
        there, back = (
            np.exp(1j * wavenumber * _paths(tx, rx, ends)).astype(np.complex64)
            for ends in (targets, lit.points)
        )
        sums = there.T @ (back.conj() * (lit.spreading / pose.n_antennas).astype(np.float32))
        middles = tx.mean(axis=0)[None], rx.mean(axis=0)[None]
        path_difference = _paths(*middles, targets).T - _paths(*middles, lit.points)
        total[:, lit.index] += sums * _chirp_mean(path_difference, waveform)
    return np.square(total.real) + np.square(total.imag)


def _paths(tx: Floats, rx: Floats, points: Floats) -> Floats:
    """Two-way paths from transmitters over points to receivers, (n_antennas, n_points) [m]."""
    legs = (np.linalg.norm(points[None] - ends[:, None], axis=2) for ends in (tx, rx))
    return np.asarray(sum(legs))


def _chirp_mean(path_difference: Floats, waveform: Waveform) -> NDArray[np.float32]:
    """Mean over samples t of exp(j 2 pi (f_t - mean f) apart / c)."""
    n = waveform.n_samples
    step = waveform.chirp_slope_hz_per_s / waveform.sample_rate_hz
    half = np.pi * step / SPEED_OF_LIGHT_M_PER_S * path_difference
    sine = np.sin(half)
    whole = np.abs(sine) < 1e-9
    mean = np.where(whole, 1.0, np.sin(n * half) / (n * np.where(whole, 1.0, sine)))
    return mean.astype(np.float32)


def fit_residual_field(
    renderer: SurfaceRenderer,
    echo: SurfaceEcho,
    poses: Sequence[Pose],
    grid: Grid,
    config: ResidualFieldConfig | None = None,
    *,
    seed: int = 0,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> FittedField:
    """Fit small echoes beside a surface so that its heat maps agree with the measured ones.

    Minimises sum (sqrt(abs(S)^2 + sum_v w_v abs(K_v)^2) - abs(P))^2 for 0 <= w_v <= c_v, over drawn
    voxels of all planes. S is the image of surface and box, P the measured one, K_v that of an echo
    at v. c_v is the lower quartile, over the planes that see v, of abs(P)^2 - abs(S)^2 at v. The
    points v are the voxels with the largest c_v. A field is kept if fits to three quarters of the
    planes lower the error of the last quarter by 0.1 dB, in four-fold cross-validation. With fewer
    than four planes, one plane at a time is left out.

    renderer, echo: the surface and its reflectivity.
    poses: planes available for the fit.
    grid: voxels of the heat maps and of the field, over the box.
    config: settings of the fit.
    seed: of the voxels at which planes are compared.
    """
    config = config or ResidualFieldConfig()
    poses = spread_evenly(poses, config.n_planes)
    rng = np.random.default_rng(seed)
    images, evidence = list[tuple[Floats, Floats]](), list[Floats]()
    for number, pose in enumerate(poses, start=1):
        rendered = surface_image(renderer, echo, pose, grid, num_threads=num_threads)
        measured = pose_image(pose, grid, renderer.waveform, num_threads=num_threads)
        images.append((np.abs(rendered).astype(np.float64) ** 2, np.abs(measured)))
        evidence.append(_unexplained(renderer, pose, *images[-1], grid))
        if progress is not None:
            progress(0.5 * number / len(poses))
    seen = np.stack(evidence)
    allowed = allowed_power(seen)
    chosen = _largest(allowed, config.n_points)
    positions = grid.points()
    planes = []
    for number, (pose, image) in enumerate(zip(poses, images, strict=True), start=1):
        targets, weights = _draw(*image, config.n_targets, rng)
        matrix = power_matrix(renderer, pose, positions[chosen], positions[targets])
        of_surface, magnitudes = (values.ravel()[targets] for values in image)
        planes.append(PlaneAtTargets(matrix, of_surface, magnitudes.astype(np.float64), weights))
        if progress is not None:
            progress(0.5 + 0.5 * number / len(poses))
    gain = left_out_gain(planes, seen, chosen, config) if chosen.size else 0.0
    if not gain > _MIN_GAIN_DB:
        chosen, gain = chosen[:0], 0.0
    power = _solve(planes, allowed[chosen]) if chosen.size else np.zeros(0)
    looks = np.stack(np.unravel_index(chosen, grid.shape)) % np.array(_LOOK_PERIOD)[:, None]
    field = ResidualField(
        points=positions[chosen],
        power=power,
        looks=np.ravel_multi_index(tuple(looks), _LOOK_PERIOD),
    )
    return FittedField(field, gain)


def _unexplained(
    renderer: SurfaceRenderer, pose: Pose, surface: Floats, measured: Floats, grid: Grid
) -> Floats:
    """Unexplained power at the voxels in line of sight of a plane, else NaN, (n_voxels,)."""
    lit = renderer.lit_points(grid.points(), pose.phase_centers.mean(axis=0))
    rest = np.maximum(measured.astype(np.float64) ** 2 - surface, 0.0)
    at = ((lit.points - np.asarray(grid.origin_m)) / grid.spacing_m).T
    out = np.full(grid.n_voxels, np.nan)
    out[lit.index] = map_coordinates(rest, at, order=1, mode="nearest") / lit.spreading**2
    return out


def allowed_power(unexplained: Floats) -> Floats:
    """Upper bound of the power at each point, (n_points,): lower quartile over the planes.

    unexplained: power of each plane, NaN without line of sight, (n_planes, n_points). The bound is
    zero where fewer than three planes have a line of sight.
    """
    seen = np.isfinite(unexplained)
    ascending = np.sort(np.where(seen, unexplained, np.inf), axis=0)
    rank = (_QUARTER * np.maximum(seen.sum(axis=0) - 1, 0)).astype(np.int64)
    value = np.take_along_axis(ascending, rank[None], axis=0)[0]
    return np.where(seen.sum(axis=0) >= _MIN_PLANES, value, 0.0)


def _largest(values: Floats, n: int) -> Ints:
    """Ascending indices of the n largest positive values."""
    order = np.argsort(-values, kind="stable")[:n]
    return np.sort(order[values[order] > 0.0])


def _draw(
    surface: Floats, measured: Floats, n_targets: int, rng: np.random.Generator
) -> tuple[Ints, Floats]:
    """Draw voxels, half by unexplained power, half uniformly, and how many each represents."""
    rest = np.abs(measured.astype(np.float64) ** 2 - surface).ravel()
    chance = 0.5 * rest / max(float(rest.sum()), 1e-300) + 0.5 / rest.size
    drawn = rng.choice(rest.size, n_targets, p=chance / chance.sum())
    return drawn, 1.0 / (n_targets * chance[drawn])


def _solve(planes: Sequence[PlaneAtTargets], allowed: Floats) -> Floats:
    """Fitted power of each point, (n_points,)."""
    matrix = np.concatenate([plane.matrix for plane in planes])
    surface, measured, weights = (
        np.concatenate([getattr(plane, name) for plane in planes])
        for name in ("surface", "measured", "weights")
    )
    start = np.full(len(allowed), 0.5)
    found = minimize(
        loss_of_shares,
        start,
        args=(matrix * allowed.astype(np.float32), surface, measured, weights),
        jac=True,
        bounds=[(0.0, 1.0)] * len(allowed),
        method="L-BFGS-B",
        options={"maxiter": _MAX_STEPS},
    )
    return np.asarray(found.x) * allowed


def loss_of_shares(
    shares: Floats, matrix: Floats, surface: Floats, measured: Floats, weights: Floats
) -> tuple[float, Floats]:
    """Weighted squared error of magnitudes and its gradient to the shares, (n_points,).

    shares: power of each point relative to its bound, (n_points,).
    matrix: power at the targets for shares of 1, (n_targets, n_points).
    surface, measured, weights: power, magnitude and number of voxels of each target, (n_targets,).
    """
    power = surface + matrix @ shares.astype(matrix.dtype)
    # The root has no gradient at zero; a share of zero there is at its bound.
    magnitude = np.sqrt(np.maximum(power, 1e-12 * float(np.max(measured**2))))
    rest = magnitude - measured
    slope = (weights * rest / magnitude).astype(matrix.dtype)
    return float(np.sum(weights * rest**2)), np.asarray(slope @ matrix, dtype=np.float64)


def left_out_gain(
    planes: Sequence[PlaneAtTargets], unexplained: Floats, chosen: Ints, config: ResidualFieldConfig
) -> float:
    """Decrease of the squared error of left-out planes by fitted fields [dB]."""
    without = with_field = 0.0
    n_folds = min(_FOLDS, len(planes))
    for fold in range(n_folds) if n_folds > 1 else ():
        kept = np.arange(len(planes)) % n_folds != fold
        allowed = allowed_power(unexplained[kept])
        own = _largest(allowed, config.n_points)
        own_points = np.flatnonzero(np.isin(chosen, own))
        cut = [plane._replace(matrix=plane.matrix[:, own_points]) for plane in planes]
        power = _solve(
            [p for p, k in zip(cut, kept, strict=True) if k], allowed[chosen[own_points]]
        )
        for plane in cut[fold::n_folds]:
            rendered = np.sqrt(plane.surface + plane.matrix @ power.astype(np.float32))
            without += float(plane.weights @ (np.sqrt(plane.surface) - plane.measured) ** 2)
            with_field += float(plane.weights @ (rendered - plane.measured) ** 2)
    return 10.0 * float(np.log10(without / max(with_field, 1e-9 * without))) if without else 0.0
