"""Views of a run that has a surface: its reflectivity is fitted at first, and kept in the run."""

import time
from dataclasses import asdict
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from geraf2.cli._console import progress_bar, say
from geraf2.io.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from geraf2.io.mesh import read_mesh
from geraf2.io.run_folder import RunFolder, stage_key
from geraf2.scene import Capture, Grid, LosPrior, Pose
from geraf2.training.config import SurfaceFitConfig

if TYPE_CHECKING:
    from collections.abc import Callable

    from geraf2.rendering.surface import SurfaceRenderer
    from geraf2.training.novel_views import PlaneView
    from geraf2.training.surface_fit import SurfaceEcho

ECHO_NAME = "echo.safetensors"
ECHO_STAGE = "echo"
CONTENT_NAME = "mesh_content.ply"
_KIND = "surface-echo"
_VERSION = 1

View: TypeAlias = "Callable[[Pose], PlaneView]"
"""Renders the heat map of a plane."""


def view_of_surface(
    run: RunFolder,
    capture: Capture,
    prior: LosPrior,
    grid: Grid,
    config: SurfaceFitConfig,
    seed: int,
    num_threads: int | None,
) -> View:
    """Prepare to render planes from the run's mesh, made of the planes in `capture`."""
    from geraf2.training.novel_views import render_surface_plane  # noqa: PLC0415 - needs torch
    from geraf2.training.surface_fit import make_surface_renderer  # noqa: PLC0415 - needs torch

    content = read_mesh(run.path / CONTENT_NAME)
    renderer = make_surface_renderer(
        content, prior, capture.waveform, config, num_threads=num_threads
    )
    echo = _echo(run, capture, prior, grid, config, seed, renderer, num_threads)
    low, high = float(echo.reflectivity.min()), float(echo.reflectivity.max())
    say(
        f"content  reflectivity {low:.2f} to {high:.2f} of its mean at {len(echo.nodes)} places, "
        f"walls {abs(echo.walls[0]):.2f} of it"
    )

    def view(pose: Pose) -> "PlaneView":
        return render_surface_plane(renderer, echo, pose, grid, num_threads=num_threads)

    return view


def _echo(
    run: RunFolder,
    capture: Capture,
    prior: LosPrior,
    grid: Grid,
    config: SurfaceFitConfig,
    seed: int,
    renderer: "SurfaceRenderer",
    num_threads: int | None,
) -> "SurfaceEcho":
    """Read the fitted echo of the run's surface, or fit it to the planes."""
    from geraf2.training.surface_fit import (  # noqa: PLC0415 - needs torch
        SurfaceEcho,
        fit_surface_echo,
    )

    path = run.path / ECHO_NAME
    key = stage_key(
        version=_VERSION,
        scene=run.scene_digest,
        mesh=run.stages["mesh"].files[CONTENT_NAME],
        planes=[pose.name for pose in capture.poses],
        spacing_m=grid.spacing_m,
        walls=prior.walls,
        config=config,
        seed=seed,
    )
    if run.is_done(ECHO_STAGE, key):
        return SurfaceEcho.of_arrays(load_checkpoint(path, kind=_KIND, version=_VERSION).arrays)
    start = time.perf_counter()
    with progress_bar("fitting reflectivity") as report:
        echo = fit_surface_echo(
            renderer, capture.poses, grid, config,
            seed=seed, num_threads=num_threads, progress=report,
        )  # fmt: skip
    save_checkpoint(
        path,
        Checkpoint(
            kind=_KIND, version=_VERSION, arrays=echo.arrays(), header={"config": asdict(config)}
        ),
    )
    run.mark_done(ECHO_STAGE, key, [ECHO_NAME], time.perf_counter() - start)
    run.log(
        "reflectivity", level="info", power=echo.power, walls=np.abs(echo.walls).tolist(),
        reflectivity=echo.reflectivity.tolist(),
    )  # fmt: skip
    return echo
