"""Rendered heat maps of planes, and their similarity to the measured ones."""

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from geraf2._validation import require_shape
from geraf2.learned.lensless import LenslessRenderer
from geraf2.learned.model import PaperModel
from geraf2.ops import MatchedFilterPlan
from geraf2.scene import Grid, Pose, Waveform
from geraf2.surfaces.facets import SurfaceRenderer
from geraf2.surfaces.surface_fit import SurfaceEcho


class PlaneView(NamedTuple):
    """One plane's heat map, rendered and measured."""

    rendered: NDArray[np.float32]
    """Root of the mean |P|^2 over draws of the samples, grid.shape."""
    measured: NDArray[np.float32]
    """|P|, grid.shape."""
    psnr_db: float
    """See :func:`psnr_db`."""


def render_plane(
    renderer: LenslessRenderer,
    model: PaperModel,
    pose: Pose,
    grid: Grid,
    *,
    with_reflectivity: bool = True,
    n_draws: int = 4,
    seed: int = 0,
    num_threads: int | None = None,
) -> PlaneView:
    """Heat map of a plane's antennas, rendered from trained fields and measured.

    renderer, model: of the training.
    pose: the plane, with its signal.
    grid: voxels of the heat maps.
    with_reflectivity: whether reflectivity was trained.
    n_draws: independent draws of the samples along the rays; averaging their powers reduces
        speckle.
    """
    generator = torch.Generator().manual_seed(seed)
    power = np.zeros(grid.shape)
    plan = _plan(pose, grid, renderer.waveform, num_threads)
    with torch.no_grad():
        for _ in range(n_draws):
            signal = renderer.render(
                model.sdf,
                model.reflectivity if with_reflectivity else None,
                model.power(),
                model.sharpness(),
                renderer.sampler.sample(pose.axes, generator),
                pose.tx_positions,
                pose.rx_positions,
            ).signal
            for part in signal.numpy():
                power += np.abs(plan.execute(part)) ** 2
    rendered = np.sqrt(power / n_draws).astype(np.float32)
    return _beside_measured(rendered, plan.execute(pose.signal))


def render_surface_plane(
    renderer: SurfaceRenderer,
    echo: SurfaceEcho,
    pose: Pose,
    grid: Grid,
    *,
    num_threads: int | None = None,
) -> PlaneView:
    """Heat map of a plane's antennas, rendered from a surface and its box, and measured.

    renderer, echo: the surface, and its reflectivity.
    pose, grid, num_threads: as those of :func:`render_plane`.
    """
    shares = echo.reflectivity_at(renderer.content.points)[None]
    factors = echo.power * np.concatenate([[1.0], echo.walls])
    signal = np.tensordot(factors, renderer.render(pose, shares), axes=1).astype(np.complex64)
    plan = _plan(pose, grid, renderer.waveform, num_threads)
    return _beside_measured(np.abs(plan.execute(signal)), plan.execute(pose.signal))


def _plan(pose: Pose, grid: Grid, waveform: Waveform, num_threads: int | None) -> MatchedFilterPlan:
    return MatchedFilterPlan(
        pose.tx_positions, pose.rx_positions, grid, waveform, num_threads=num_threads
    )


def _beside_measured(
    rendered: NDArray[np.float32], image: NDArray[np.complexfloating]
) -> PlaneView:
    measured = np.abs(image).astype(np.float32)
    return PlaneView(rendered, measured, psnr_db(rendered, measured))


def psnr_db(rendered: NDArray[np.floating], measured: NDArray[np.floating]) -> float:
    """Peak signal-to-noise ratio of a heat map, 10 log10(max(m)^2 / mean((r - m)^2)) [dB].

    Both are magnitudes on the same grid; nothing is scaled or aligned. The peak is the measured
    map's own. As in Mildenhall et al. 2020, where the peak is 1.
    """
    require_shape("rendered", rendered, measured.shape)
    peak = float(measured.max(initial=0.0))
    if not peak > 0.0:
        msg = "measured must be positive somewhere"
        raise ValueError(msg)
    error = float(np.mean((rendered.astype(np.float64) - measured) ** 2))
    return float("inf") if error == 0.0 else 10.0 * float(np.log10(peak**2 / error))
