"""Views of a run that has a surface: its reflectivity is fitted at first, and kept in the run."""

import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from geraf2.cli._console import progress_bar, say
from geraf2.io.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from geraf2.io.mesh import read_mesh
from geraf2.io.run_folder import CONTENT_NAME, RunFolder, stage_key
from geraf2.scene import Capture, Grid, LosPrior, Pose
from geraf2.surfaces.config import SurfaceFitConfig

if TYPE_CHECKING:
    from collections.abc import Callable

    from geraf2.paper.novel_views import PlaneView
    from geraf2.rendering.surface import SurfaceRenderer
    from geraf2.surfaces.surface_fit import SurfaceEcho

ECHO_NAME = "echo.safetensors"
ECHO_STAGE = "echo"
_KIND = "surface-echo"
ECHO_VERSION = 1
"""Raised when the same surface and planes give another echo, or another picture of it."""

View: TypeAlias = "Callable[[Pose], PlaneView]"
"""Renders the heat map of a plane."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceViews:
    """Renders planes from a run's mesh."""

    run: RunFolder
    """A finished run; the fitted echo is kept in it."""
    capture: Capture
    """The planes that the mesh was made of."""
    prior: LosPrior
    """Of the run."""
    grid: Grid
    """Of the heat maps."""
    config: SurfaceFitConfig
    """How the surface is rendered, and what is fitted to it."""
    seed: int
    """Of the places at which reflectivity is fitted."""
    num_threads: int | None

    def view(self) -> View:
        """Prepare the renderer, and read or fit the echo."""
        from geraf2.paper.novel_views import (  # noqa: PLC0415 - needs torch
            render_surface_plane,
        )
        from geraf2.surfaces.surface_fit import (  # noqa: PLC0415 - needs torch
            make_surface_renderer,
        )

        renderer = make_surface_renderer(
            read_mesh(self.run.path / CONTENT_NAME), self.prior, self.capture.waveform,
            self.config, num_threads=self.num_threads,
        )  # fmt: skip
        echo = self._echo(renderer)
        low, high = float(echo.reflectivity.min()), float(echo.reflectivity.max())
        say(
            f"content  reflectivity {low:.2f} to {high:.2f} of its mean at {len(echo.nodes)} "
            f"places, walls {abs(echo.walls[0]):.2f} of it"
        )

        def view(pose: Pose) -> "PlaneView":
            return render_surface_plane(
                renderer, echo, pose, self.grid, num_threads=self.num_threads
            )

        return view

    def _key(self) -> str:
        return stage_key(
            version=ECHO_VERSION,
            scene=self.run.scene_digest,
            mesh=self.run.stages["mesh"].files[CONTENT_NAME],
            planes=[pose.name for pose in self.capture.poses],
            spacing_m=self.grid.spacing_m,
            walls=self.prior.walls,
            config=self.config,
            seed=self.seed,
        )

    def _echo(self, renderer: "SurfaceRenderer") -> "SurfaceEcho":
        """Read the fitted echo of the surface, or fit it to the planes."""
        from geraf2.surfaces.surface_fit import (  # noqa: PLC0415 - needs torch
            SurfaceEcho,
            fit_surface_echo,
        )

        run, path, key = self.run, self.run.path / ECHO_NAME, self._key()
        if run.is_done(ECHO_STAGE, key):
            kept = load_checkpoint(path, kind=_KIND, version=ECHO_VERSION)
            return SurfaceEcho.of_arrays(kept.arrays)
        start = time.perf_counter()
        with progress_bar("fitting reflectivity") as report:
            echo = fit_surface_echo(
                renderer, self.capture.poses, self.grid, self.config,
                seed=self.seed, num_threads=self.num_threads, progress=report,
            )  # fmt: skip
        header = {"config": asdict(self.config)}
        save_checkpoint(
            path, Checkpoint(kind=_KIND, version=ECHO_VERSION, arrays=echo.arrays(), header=header)
        )
        run.mark_done(ECHO_STAGE, key, [ECHO_NAME], time.perf_counter() - start)
        run.log(
            "reflectivity", level="info", power=echo.power, walls=np.abs(echo.walls).tolist(),
            reflectivity=echo.reflectivity.tolist(),
        )  # fmt: skip
        return echo
