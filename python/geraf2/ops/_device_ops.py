"""The ops of a lensless training step in torch alone, for tensors where the kernels do not run.

Same formulas, arguments and results as the functions that call them, whole arrays at a time. Every
derivative is torch's own. Paths are taken in double precision, as the kernels take them, and only
their remainder of a turn is kept in the precision of the signal.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch.utils.checkpoint import checkpoint

from geraf2._types import Floats, Ints
from geraf2._validation import require_shape
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.ops._forms import EchoForm, SamplePairs
from geraf2.records import Waveform
from geraf2.scene.grid import Grid

Tensor = torch.Tensor

# Phasors in memory at once: 64 MiB of complex64, as much again where gradients are taken.
_PHASORS = 2**23
# Gradients shorter than this have no direction, as in the kernels.
_MIN_LENGTH = 1e-6


def sdf_grid(values: Any, grid: Grid, points: Any, cubic: bool) -> tuple[Tensor, Tensor]:
    """Value (n,) and gradient (n, 3) of grid values at points (n, 3) [m]."""
    values, points = _move_together(values, points)
    require_shape("values", values, tuple(grid.shape))
    require_shape("points", points, (None, 3))
    taps = torch.arange(-1, 3) if cubic else torch.arange(2)
    index, weight, slope = [], [], []
    for axis, length in enumerate(grid.shape):
        position = (points[:, axis].double() - grid.origin_m[axis]) / grid.spacing_m
        inside = ((position >= 0.0) & (position <= length - 1)).to(values.dtype)
        position = position.clamp(0, length - 1)
        cell = position.detach().floor().clamp(0, max(length - 2, 0))
        weights, slopes = _tap_weights((position - cell).to(values.dtype), cubic)
        index.append((cell.long()[:, None] + taps.to(cell.device)).clamp(0, length - 1))
        weight.append(weights)
        slope.append(slopes * (inside / grid.spacing_m)[:, None])
    x, y, z = index
    at = (x[:, :, None, None] * grid.shape[1] + y[:, None, :, None]) * grid.shape[2]
    near: Tensor = values.reshape(-1)[at + z[:, None, None, :]]

    def sum_taps(wx: Tensor, wy: Tensor, wz: Tensor) -> Tensor:
        along_y = ((near * wz[:, None, None]).sum(dim=3) * wy[:, None]).sum(dim=2)
        return torch.sum(along_y * wx, dim=1)

    gradient = [
        sum_taps(*(slope[a] if a == axis else weight[a] for a in range(3))) for axis in range(3)
    ]
    return sum_taps(*weight), torch.stack(gradient, dim=1)


def _tap_weights(r: Tensor, cubic: bool) -> tuple[Tensor, Tensor]:
    """Weights of an axis' taps at r in [0, 1] of a cell, and their derivatives, (n, n_taps)."""
    if not cubic:
        one = torch.ones_like(r)
        return torch.stack([1.0 - r, r], dim=1), torch.stack([-one, one], dim=1)
    r2, r3 = r * r, r * r * r
    weights = [2.0 * r2 - r - r3, 2.0 - 5.0 * r2 + 3.0 * r3, r + 4.0 * r2 - 3.0 * r3, r3 - r2]
    slopes = [
        *(4.0 * r - 1.0 - 3.0 * r2, 9.0 * r2 - 10.0 * r),
        *(1.0 + 8.0 * r - 9.0 * r2, 3.0 * r2 - 2.0 * r),
    ]
    return 0.5 * torch.stack(weights, dim=1), 0.5 * torch.stack(slopes, dim=1)


def ray_march(
    sdf: Any, cos: Any, step: Any, inv_s: Any, power: int
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Alpha, transmittance to `power`, weight, depth; all but the last (n_rays, n_samples)."""
    sdf, cos, step = _move_together(sdf, cos, step)
    sharpness = inv_s.reshape(()).to(sdf) if isinstance(inv_s, Tensor) else inv_s
    change = -0.5 * torch.relu(-cos) * step
    log_phi = torch.nn.functional.logsigmoid
    kept = log_phi(sharpness * (sdf + change)) - log_phi(sharpness * (sdf - change))
    alpha = -torch.expm1(kept)
    before = torch.cumsum(torch.nn.functional.pad(kept, (1, 0))[:, :-1], dim=1)
    transmittance = torch.exp(power * before)
    weight = transmittance * alpha
    middle = torch.cumsum(step, dim=1) - 0.5 * step
    return alpha, transmittance, weight, (weight * middle).sum(dim=1)


def facing_samples(
    alpha: Tensor, gradient: Tensor, points: Floats, form: EchoForm, n_looks: int
) -> tuple[Ints, Ints]:
    """Find samples that may echo to groups, and where each part begins; arrays, not tensors."""
    positions, centers = _to_double(points, alpha), _to_double(form.centers, alpha)
    leg, slope = positions - centers[:, None], gradient.detach().double()
    square = slope.square().sum(dim=1).clamp(min=_MIN_LENGTH**2)
    along = (leg * slope).sum(dim=2)
    lit = alpha.detach().reshape(-1).expand_as(along) != 0.0
    if form.lobe_power != 1.0:
        lit = lit & ~(2.0 * along.square() <= square * leg.square().sum(dim=2))
    sample = torch.arange(along.shape[1], device=alpha.device)
    ray = sample // alpha.shape[1]
    draw = (sample % alpha.shape[1] + 5 * ray) % n_looks
    of_part = lit[:, None] & (draw == torch.arange(n_looks, device=alpha.device)[:, None])
    counts = of_part.sum(dim=2).reshape(-1).cpu().numpy()
    found = of_part.nonzero()[:, 2].cpu().numpy()
    return found, np.concatenate([[0], np.cumsum(counts)])


def echo_amplitudes(
    alpha: Tensor,
    transmittance: Tensor,
    gradient: Tensor,
    points: Floats,
    pairs: SamplePairs,
    shift: Tensor,
    form: EchoForm,
) -> tuple[Tensor, Tensor]:
    """Amplitudes (n_pairs,) and unit normals (n_pairs, 3)."""
    sample, group = _index(pairs.sample, alpha), _index(pairs.group(), alpha)
    slope = gradient.index_select(0, sample)
    length = torch.linalg.vector_norm(slope, dim=1, keepdim=True)
    normals = slope / length.clamp(min=_MIN_LENGTH)
    leg = _to_double(np.take(points, pairs.sample, axis=0), alpha)
    leg = leg - _to_double(form.centers, alpha).index_select(0, group)
    distance = torch.linalg.vector_norm(leg, dim=1, keepdim=True)
    through = (transmittance.reshape(-1).index_select(0, sample) + shift).clamp(min=0.0)
    amplitude = alpha.reshape(-1).index_select(0, sample) * through**form.two_way_power
    if form.lobe_power != 1.0:
        cosine = (normals * (leg / distance).to(alpha.dtype)).sum(dim=1)
        lobe = 2.0 * cosine.square() - 1.0
        dark = lobe <= 0.0  # a power below one has no derivative at zero
        lobe = torch.where(dark, 1.0, lobe).pow(form.lobe_power - 1.0)
        amplitude = amplitude * torch.where(dark, 0.0, lobe)
    if form.references is not None:
        reference = _to_double(form.references, alpha).index_select(0, group)
        amplitude = amplitude * (reference / distance[:, 0]).square().to(alpha.dtype)
    return amplitude, normals


def trace_pairs(
    amplitude: Tensor,
    points: Floats,
    normals: Tensor,
    pairs: SamplePairs,
    tx: Floats,
    rx: Floats,
    groups: list[Ints],
    waveform: Waveform,
) -> Tensor:
    """Signals, complex (n_looks, n_antennas, n_samples)."""
    n_looks, parts = pairs.n_looks, np.arange(len(pairs.offsets) - 1)
    draw = _index(np.repeat(parts % pairs.n_looks, np.diff(pairs.offsets)), amplitude)
    positions = _to_double(np.take(points, pairs.sample, axis=0), amplitude)
    of_groups = []
    for number, antennas in enumerate(groups):
        ends = [_to_double(p[antennas], amplitude) for p in (tx, rx)]
        begin, end = (int(pairs.offsets[(number + k) * n_looks]) for k in (0, 1))

        def part(
            strength: Tensor, turned: Tensor, at: Tensor, draws: Tensor, ends: list[Tensor] = ends
        ) -> Tensor:
            echo = _echoes(strength, turned, at, ends, waveform)
            return echo.new_zeros((n_looks, *echo.shape[1:])).index_add(0, draws, echo)

        total = amplitude.new_zeros(
            (n_looks, len(antennas), waveform.n_samples), dtype=amplitude.dtype.to_complex()
        )
        n_at_once = max(_PHASORS // (len(antennas) * waveform.n_samples), 1)
        for first in range(begin, end, n_at_once):
            now = slice(first, min(first + n_at_once, end))
            total = total + _recompute(
                part, amplitude[now], normals[now], positions[now], draw[now]
            )
        of_groups.append(total)
    signal = of_groups[0].new_zeros((n_looks, len(tx), waveform.n_samples))
    return signal.index_copy(1, _index(np.concatenate(groups), amplitude), torch.cat(of_groups, 1))


def _echoes(
    strength: Tensor, normals: Tensor, positions: Tensor, ends: list[Tensor], waveform: Waveform
) -> Tensor:
    """Echo of each point alone, complex (n_points, n_antennas, n_samples)."""
    there, back = (positions[:, None] - end for end in ends)
    lengths = [torch.linalg.vector_norm(leg, dim=2) for leg in (there, back)]
    # A point on an antenna has no direction: its leg is zero, and stays so.
    incoming, outgoing = (
        (leg / length.clamp(min=1e-12)[:, :, None]).to(strength.dtype)
        for leg, length in zip((there, back), lengths, strict=True)
    )
    turned = normals[:, None]
    mirrored = incoming - 2.0 * (turned * incoming).sum(dim=2, keepdim=True) * turned
    specular = -(mirrored * outgoing).sum(dim=2)
    weight = strength[:, None] * specular.clamp(min=0.0)
    phasors = _phasors(lengths[0] + lengths[1], waveform, strength.dtype, -1.0)
    return torch.mul(weight[:, :, None], phasors)


def point_images(
    signals: Tensor, tx: Floats, rx: Floats, points: Floats, waveform: Waveform
) -> Tensor:
    """Images of signals (n_signals, n_antennas, n_samples), complex (n_signals, n_points)."""
    real = signals.real.dtype
    ends = [_to_double(p, signals) for p in (tx, rx)]
    rows = signals.reshape(signals.shape[0], -1)

    def part(rows: Tensor, at: Tensor) -> Tensor:
        path = sum(
            (torch.linalg.vector_norm(at[:, None] - e, dim=2) for e in ends), at.new_zeros(())
        )
        phasors = _phasors(path, waveform, real, 1.0).reshape(at.shape[0], -1)
        return rows @ phasors.T / len(tx)

    n_at_once = max(_PHASORS // max(rows.shape[1], 1), 1)
    positions = torch.split(_to_double(points, signals), n_at_once)
    return torch.cat([_recompute(part, rows, at) for at in positions], dim=1)


def length_defect(gradients: Tensor) -> Tensor:
    """Mean of (|g| - 1)^2 over rows, with |g| the root of |g|^2 + 1e-12."""
    return (torch.sqrt(gradients.square().sum(dim=1) + 1e-12) - 1.0).square().mean()


def _phasors(path: Tensor, waveform: Waveform, real: torch.dtype, sign: float) -> Tensor:
    """exp(sign 2 pi j f(t) d / c) of two-way paths d [m] without the bias, (*path, n_samples)."""
    delay = (path + waveform.path_bias_m) / SPEED_OF_LIGHT_M_PER_S
    turns = torch.frac(delay * waveform.start_frequency_hz)
    rate = waveform.chirp_slope_hz_per_s / waveform.sample_rate_hz
    number = torch.arange(waveform.n_samples, dtype=real, device=path.device)
    phase = turns.to(real)[..., None] + torch.frac(delay * rate).to(real)[..., None] * number
    phase = sign * 2.0 * math.pi * phase
    return torch.complex(torch.cos(phase), torch.sin(phase))


def _recompute(part: Callable[..., Tensor], *inputs: Tensor) -> Tensor:
    """`part` of the inputs; what it holds is computed again for its gradient, not kept."""
    out: Tensor = checkpoint(part, *inputs, use_reentrant=False, preserve_rng_state=False)
    return out


def _move_together(*values: Any) -> list[Tensor]:
    """Arrays beside tensors as tensors where those are."""
    device = next(v.device for v in values if isinstance(v, Tensor))
    return [v if isinstance(v, Tensor) else torch.as_tensor(v, device=device) for v in values]


def _to_double(values: Floats, beside: Tensor) -> Tensor:
    """Positions as a tensor where another one is."""
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float64)).to(beside.device)


def _index(values: Ints, beside: Tensor) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.int64)).to(beside.device)
