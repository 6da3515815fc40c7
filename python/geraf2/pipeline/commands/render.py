"""Heat maps of any plane of antennas from a run, beside the measured ones."""

import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import numpy as np

from geraf2._bounds import Arg, Bounded, CellM, Degrees, Few, Seed
from geraf2.errors import UserError
from geraf2.io.atomic import write_npz_atomic, write_text_atomic
from geraf2.io.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from geraf2.io.digests import file_digest
from geraf2.io.run_folder import (
    CONTENT_NAME,
    ECHO_NAME,
    FIELDS_NAME,
    PSNR_NAME,
    REPORT_FILES,
    VIEWS_FOLDER,
    RunFolder,
    StageRecord,
    mesh_digest,
    stage_key,
)
from geraf2.pipeline.estimates import require_renderable
from geraf2.pipeline.events import Listener
from geraf2.pipeline.planes import keep_planes, planes_at, quarter_planes
from geraf2.pipeline.presets import BestPreset, CorrectedPaperPreset, FastPreset, PaperPreset
from geraf2.pipeline.reconstruction import Reconstruction, load_run
from geraf2.pipeline.run_scene import capture_of
from geraf2.scene import Capture, Grid, LosPrior, Pose
from geraf2.surfaces.config import ECHO_VERSION, SurfaceFitConfig

if TYPE_CHECKING:
    from collections.abc import Callable

    from geraf2.learned.novel_views import PlaneView
    from geraf2.surfaces.facets import SurfaceRenderer
    from geraf2.surfaces.surface_fit import SurfaceEcho

View: TypeAlias = "Callable[[Pose], PlaneView]"
"""Renders the heat map of a plane."""


@dataclass(frozen=True, kw_only=True)
class RenderOptions(Bounded):
    """Which planes are rendered, and how finely.

    Raises
    ------
    UserError
        For a value out of bounds.

    Examples
    --------
    >>> geraf2.RenderOptions(angles=(60.0,)).spacing_m  # [m]
    0.004
    """

    angles: tuple[Degrees, ...] = ()
    """Turntable angles of the planes [degrees]; those that the run left out when not given, else
    those nearest to 0, 90, 180 and 270."""
    spacing_m: CellM = 0.004
    """Voxels of the heat maps [m]."""
    n_draws: Annotated[Few, Arg(hidden=True)] = 4
    """Draws of the samples whose powers are averaged; of the preset paper."""
    seed: Annotated[Seed, Arg(hidden=True)] = 0
    """Of the draws, and of the points at which reflectivity is fitted."""
    echo: Annotated[SurfaceFitConfig, Arg(hidden=True)] = field(default_factory=SurfaceFitConfig)
    """Rendering of a surface, and the fit of its reflectivity."""


@dataclass(frozen=True, kw_only=True)
class RenderedPlane:
    """Difference between the rendered heat map of a plane and the measured one."""

    angle_deg: float
    """Turntable angle of the plane [degrees]."""
    psnr_db: float
    """10 log10(max(m)^2 / mean((r - m)^2)) of magnitudes over the box, nothing scaled [dB]."""
    held_out: bool
    """Whether the run left it out."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Views:
    """Input of the rendering of planes."""

    run: RunFolder
    capture: Capture
    prior: LosPrior
    grid: Grid
    options: RenderOptions
    num_threads: int | None
    listener: Listener


def render(
    run: Reconstruction | Path | str,
    options: RenderOptions | None = None,
    *,
    scene: Path | str | Capture | None = None,
    num_threads: int | None = None,
    listener: Listener | None = None,
) -> tuple[RenderedPlane, ...]:
    """Render heat maps of planes from a run and compare them with the measured ones.

    Parameters
    ----------
    run
        A reconstruction of the preset fast, best, paper or paper-corrected, or its folder, which
        gets pictures and arrays in `views/`. Its report, if there is one, shows them. The surface
        of the first two presets gets its reflectivity here, from the planes that the run used.
    options
        Which planes are rendered, and how finely.
    scene
        Capture of the run or its folder, if it is no longer where the run found it.
    num_threads
        Threads of the kernels; all when None.
    listener
        Receives progress.

    Returns
    -------
    tuple of RenderedPlane
        How near each map is to the measured one [dB], in the order of the angles.

    Raises
    ------
    UserError
        For another preset, a run without a surface, another scene, or an angle without a plane.

    Examples
    --------
    >>> from geraf2.surfaces.config import SurfaceFitConfig
    >>> echo = SurfaceFitConfig(max_edge_m=0.006, wall_edge_m=0.01, n_planes=1, n_targets=200)
    >>> options = geraf2.RenderOptions(angles=(60.0,), spacing_m=0.02, echo=echo)
    >>> capture, truth = geraf2.examples.small_capture()
    >>> planes = geraf2.render(geraf2.examples.small_run(), options, scene=capture)
    >>> [plane.angle_deg for plane in planes]
    [60.0]
    """
    result = run if isinstance(run, Reconstruction) else load_run(run)
    options = options or RenderOptions()
    is_paper = isinstance(result.record.config, PaperPreset | CorrectedPaperPreset)
    _require_rendered(result, is_paper=is_paper)
    capture = capture_of(result, scene)
    hold_out, name = result.record.options.hold_out, result.run.scene_name
    asked = options.angles or hold_out
    planes = planes_at(capture, asked, name) if asked else quarter_planes(capture, name)
    require_renderable(result.prior, capture, options.spacing_m, options.echo)
    held_out = set(planes_at(capture, hold_out, name))
    chosen = [(capture.poses[plane], plane in held_out) for plane in planes]
    half = 0.5 * max(result.prior.size_m)
    views = _Views(
        run=result.run,
        capture=capture if is_paper else keep_planes(capture, hold_out, name),
        prior=result.prior,
        grid=Grid.cube(result.prior.center_m, half, round(2.0 * half / options.spacing_m) + 1),
        options=options,
        num_threads=num_threads,
        listener=listener or Listener(),
    )
    with result.run.lock():
        # `result` may have been read before another run replaced the mesh
        view = _of_fields(views) if is_paper else _of_surface(views, load_run(result.path))
        rendered = _render(views, chosen, view)
        if result.report is not None:
            from geraf2.report import write_report  # noqa: PLC0415 - matplotlib takes 0.5 s

            with views.listener.step("drawing the report"), result.run.rewrite(*REPORT_FILES):
                write_report(result.path, num_threads=num_threads)
    return tuple(rendered)


def _require_rendered(result: Reconstruction, *, is_paper: bool) -> None:
    """Refuse a run that cannot be rendered."""
    config = result.record.config
    if not is_paper and not isinstance(config, FastPreset | BestPreset):
        raise UserError(
            what="neither fields nor a surface with glints can be rendered from this run",
            where=result.path,
            expected="a run of the preset fast, best, paper or paper-corrected",
            got=config.preset,
        )
    needed = FIELDS_NAME if is_paper else CONTENT_NAME
    if result.run.find_file(needed) is None:
        raise UserError(
            what=f"the run has no {needed}",
            where=result.path,
            hint="repeat it with 'geraf2 reconstruct --overwrite'",
        )


def _render(
    views: _Views, chosen: Sequence[tuple[Pose, bool]], view_of: View
) -> list[RenderedPlane]:
    """Write views of planes; chosen: each, and whether the run left it out."""
    from geraf2.report.figures import projections  # noqa: PLC0415 - matplotlib takes 0.5 s

    folder, grid, values = views.run.path / VIEWS_FOLDER, views.grid, list[RenderedPlane]()
    folder.mkdir(exist_ok=True)
    with views.listener.step("rendering") as progress, views.run.rewrite(f"{VIEWS_FOLDER}/*"):
        for number, (pose, held_out) in enumerate(chosen, start=1):
            view, angle = view_of(pose), f"{pose.angle_deg:g}"
            plane = RenderedPlane(
                angle_deg=float(pose.angle_deg or 0.0),
                psnr_db=view.psnr_db,
                held_out=held_out,
            )
            values.append(plane)
            name = f"angle_{pose.angle_deg:05.1f}"
            arrays: dict[str, Any] = {
                "rendered": view.rendered,
                "measured": view.measured,
                "origin_m": np.asarray(grid.origin_m),
                "spacing_m": np.asarray(grid.spacing_m),
            }
            write_npz_atomic(folder / f"{name}.npz", arrays)
            for kind in ("measured", "rendered"):
                title = f"{kind}, {angle} degrees, PSNR {view.psnr_db:.1f} dB"
                projections(arrays[kind], grid, folder / f"{name}_{kind}.png", title=title)
            progress(number / len(chosen))
        found = {f"{plane.angle_deg:g}": plane.psnr_db for plane in values}
        mean = float(np.mean([*found.values()]))
        record: dict[str, Any] = {"psnr_db": found, "mean_psnr_db": mean}
        text = json.dumps({**record, **mesh_digest(views.run.path)}, indent=2) + "\n"
        write_text_atomic(folder / PSNR_NAME, text)
    views.run.log("render", level="info", **record)
    return values


def _of_fields(views: _Views) -> View:
    """Prepare to render planes from trained fields."""
    from geraf2.learned.checkpoints import KIND, VERSION, config_of, load_model  # noqa: PLC0415 - needs torch
    from geraf2.learned.model import PaperModel, domain_of, make_renderer  # noqa: PLC0415 - needs torch
    from geraf2.learned.novel_views import render_plane  # noqa: PLC0415 - needs torch

    path, options, threads = views.run.path / FIELDS_NAME, views.options, views.num_threads
    checkpoint = load_checkpoint(path, kind=KIND, version=VERSION)
    paper = config_of(checkpoint.header, path)
    model = PaperModel(domain_of(views.prior, paper), paper)
    load_model(model, checkpoint.arrays, path)
    renderer = make_renderer(views.capture.waveform, views.prior, paper, num_threads=threads)
    with_reflectivity = checkpoint.header["stage"] == 2 and paper.stage2.train_reflectivity
    return lambda pose: render_plane(
        renderer,
        model,
        pose,
        views.grid,
        with_reflectivity=with_reflectivity,
        n_draws=options.n_draws,
        seed=options.seed,
        num_threads=threads,
    )


def _of_surface(views: _Views, result: Reconstruction) -> View:
    """Prepare the renderer of the run's mesh, and read or fit its echo."""
    from geraf2.learned.novel_views import render_surface_plane  # noqa: PLC0415 - needs torch
    from geraf2.surfaces.surface_fit import make_surface_renderer  # noqa: PLC0415 - needs torch

    renderer = make_surface_renderer(
        result.content_mesh,
        views.prior,
        views.capture.waveform,
        views.options.echo,
        num_threads=views.num_threads,
    )
    echo = _echo(views, renderer)
    return lambda pose: render_surface_plane(
        renderer, echo, pose, views.grid, num_threads=views.num_threads
    )


def _echo_key(views: _Views) -> str:
    return stage_key(
        version=ECHO_VERSION,
        scene=views.run.scene_digest,
        mesh=views.run.files[CONTENT_NAME],
        planes=[pose.name for pose in views.capture.poses],
        spacing_m=views.grid.spacing_m,
        walls=views.prior.walls,
        config=views.options.echo,
        seed=views.options.seed,
    )


def _echo(views: _Views, renderer: "SurfaceRenderer") -> "SurfaceEcho":
    """Read the echo of the surface that an earlier call fitted, or fit it to the planes."""
    from geraf2.surfaces.surface_fit import SurfaceEcho, fit_surface_echo  # noqa: PLC0415 - needs torch

    run, options, key = views.run, views.options, _echo_key(views)
    path, kind = run.path / ECHO_NAME, "surface-echo"
    if run.find_file(ECHO_NAME) is not None and file_digest(path) == run.files[ECHO_NAME]:
        kept = load_checkpoint(path, kind=kind, version=ECHO_VERSION)
        if kept.header.get("key") == key:
            return SurfaceEcho.of_arrays(kept.arrays)
    start = time.perf_counter()
    with views.listener.step("fitting reflectivity") as progress:
        echo = fit_surface_echo(
            renderer,
            views.capture.poses,
            views.grid,
            options.echo,
            seed=options.seed,
            num_threads=views.num_threads,
            progress=progress,
        )
    walls, reflectivity = np.abs(echo.walls).tolist(), echo.reflectivity.tolist()
    numbers = {"power": echo.power, "walls": walls, "reflectivity": reflectivity}
    arrays, header = dict(echo.arrays()), {"config": asdict(options.echo), "key": key}
    made = Checkpoint(kind=kind, version=ECHO_VERSION, arrays=arrays, header=header)
    with run.rewrite(ECHO_NAME):
        save_checkpoint(path, made)
        seconds = round(time.perf_counter() - start, 3)
        run.stages["echo"] = StageRecord(seconds=seconds, numbers=numbers)
    run.log("echo", level="info", **numbers)
    return echo
