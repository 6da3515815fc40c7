"""Heat maps of planes that a training did not see, and how near they come to the measured ones."""

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from geraf2._validation import require_shape
from geraf2.learned.model import PaperModel
from geraf2.learned.rendering.lensless import LenslessRenderer
from geraf2.ops import matched_filter
from geraf2.scene import Grid, Pose, Waveform
from geraf2.surfaces.facets import SurfaceRenderer
from geraf2.surfaces.residual_field import ResidualField, field_power, surface_image
from geraf2.surfaces.surface_fit import SurfaceEcho


class PlaneView(NamedTuple):
    """One plane's heat map, rendered and measured."""

    rendered: NDArray[np.float32]
    """Root of the mean |P|^2 over draws of the samples, grid.shape."""
    measured: NDArray[np.float32]
    """|P|, grid.shape."""
    psnr_db: float
    """See :func:`psnr_db`."""
    surface_psnr_db: float | None = None
    """That of the surface alone, where a field was added to it."""


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
    """Render the heat map of a plane's antennas from trained fields, beside the measured one.

    renderer, model: of the training.
    pose: the plane: places of its antennas, its direction, its signal.
    grid: where the heat maps are wanted.
    with_reflectivity: whether reflectivity was trained.
    n_draws: independent draws of the samples along the rays: volume samples are coarser than the
        wavelength, so that one draw is speckled; their mean power is not.
    seed: of the draws.
    """
    generator = torch.Generator().manual_seed(seed)
    power = np.zeros(grid.shape)
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
            for look in signal.numpy():
                image = _image(look, pose, grid, renderer.waveform, num_threads)
                power += np.abs(image) ** 2
    rendered = np.sqrt(power / n_draws).astype(np.float32)
    return _beside_measured(rendered, pose, grid, renderer.waveform, num_threads)


def render_surface_plane(
    renderer: SurfaceRenderer,
    echo: SurfaceEcho,
    pose: Pose,
    grid: Grid,
    *,
    field: ResidualField | None = None,
    seed: int = 0,
    num_threads: int | None = None,
) -> PlaneView:
    """Render the heat map of a plane's antennas from a finished surface, beside the measured one.

    renderer, echo: the surface, and how strongly it echoes.
    pose, grid, num_threads: as those of :func:`render_plane`.
    field: what is there beside it: powers add.
    seed: of the field's phases.
    """
    rendered = np.abs(surface_image(renderer, echo, pose, grid, num_threads=num_threads))
    alone = _beside_measured(rendered, pose, grid, renderer.waveform, num_threads)
    if field is None:
        return alone
    added = field_power(renderer, field, pose, grid, seed=seed, num_threads=num_threads)
    both = np.sqrt(rendered.astype(np.float64) ** 2 + added).astype(np.float32)
    return PlaneView(both, alone.measured, psnr_db(both, alone.measured), alone.psnr_db)


def _beside_measured(
    rendered: NDArray[np.float32],
    pose: Pose,
    grid: Grid,
    waveform: Waveform,
    num_threads: int | None,
) -> PlaneView:
    measured = np.abs(_image(pose.signal, pose, grid, waveform, num_threads)).astype(np.float32)
    return PlaneView(rendered, measured, psnr_db(rendered, measured))


def _image(
    signal: NDArray[np.complex64],
    pose: Pose,
    grid: Grid,
    waveform: Waveform,
    num_threads: int | None,
) -> NDArray[np.complex64]:
    return matched_filter(
        signal, pose.tx_positions, pose.rx_positions, grid, waveform, num_threads=num_threads
    )


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
