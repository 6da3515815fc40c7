"""`geraf2 render`: heat maps of any plane of antennas from a run, beside the measured."""

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

from geraf2.cli._console import Positional, Threads, progress_bar, require_threads, rows, say
from geraf2.cli._paper import FIELDS_NAME
from geraf2.cli._planes import keep_planes, planes_at
from geraf2.cli._prior import load_prior
from geraf2.cli._surface_views import SurfaceViews, View
from geraf2.errors import UserError
from geraf2.io.atomic import write_json_atomic, write_npz_atomic
from geraf2.io.checkpoint import load_checkpoint
from geraf2.io.run_folder import CONFIG_NAME, CONTENT_NAME, VIEWS_FOLDER, RunFolder, mesh_digest
from geraf2.scene import Capture, Grid, LosPrior, Pose, load_capture
from geraf2.scene.store import capture_digest
from geraf2.surfaces.config import SurfaceFitConfig

if TYPE_CHECKING:
    from geraf2.paper.config import PaperConfig
    from geraf2.paper.novel_views import PlaneView

PSNR_NAME = "psnr.json"
_PAPER_ANGLES = (0.0, 90.0, 180.0, 270.0)


@dataclass(frozen=True, kw_only=True)
class Config:
    """Render the heat maps of planes from a run and compare them with the measured ones."""

    out: Positional[Annotated[Path, tyro.conf.arg(metavar="RUN")]]
    """Run folder of `geraf2 reconstruct` with the preset glint, hybrid or paper. The surface of the
    first two gets its reflectivity here, from the planes that the run did not leave out."""
    angles: Annotated[tuple[float, ...], tyro.conf.arg(metavar="DEG ...")] = ()
    """Turntable angles of the planes [degrees]; those that the run left out when not given, else 0,
    90, 180 and 270."""
    scene: Annotated[Path | None, tyro.conf.arg(metavar="SCENE")] = None
    """Scene folder, where it is no longer where the run found it."""
    spacing_m: float = 0.004
    """Voxels of the heat maps [m]."""
    n_draws: int = 4
    """Draws of the samples whose powers are averaged; of the preset paper."""
    seed: int = 0
    """Of the draws, and of the places at which reflectivity is fitted."""
    echo: SurfaceFitConfig = field(default_factory=SurfaceFitConfig)
    """How a surface is rendered, and what is fitted to it."""
    threads: Threads = None
    """Threads to use; all when not given."""


def main(config: Config) -> int:
    """Run the command."""
    num_threads = require_threads(config.threads)
    if not config.spacing_m > 0.0 or config.n_draws < 1:
        raise UserError(
            what="--spacing-m must be positive and --n-draws at least 1",
            got=f"{config.spacing_m:g} and {config.n_draws}",
        )
    run = RunFolder.read(config.out)
    settings = _settings(run)
    capture, prior = _scene(run, settings, config)
    preset = _require_renderable(run, settings.get("preset"))
    hold_out = tuple(settings.get("hold_out", ()))
    angles = config.angles or hold_out or _PAPER_ANGLES
    planes = planes_at(capture, angles, run.scene_name)
    grid = _grid(prior, config.spacing_m)
    if preset == "paper":
        view = _of_fields(config, run, capture, prior, grid)
    else:
        kept = keep_planes(capture, hold_out, run.scene_name)
        view = SurfaceViews(
            run=run, capture=kept, prior=prior, grid=grid, config=config.echo, seed=config.seed,
            num_threads=num_threads,
        ).view()  # fmt: skip
    values = _render(run, capture, planes, grid, view)
    held_out = set(planes_at(capture, hold_out, run.scene_name))
    table = [
        (f"{capture.poses[p].angle_deg:g} deg", f"{v:.2f} dB" + _seen(p in held_out))
        for p, v in zip(planes, values, strict=True)
    ]
    rows([*table, ("mean", f"{np.mean(values):.2f} dB")])
    say("PSNR: 10 log10(max(m)^2 / mean((r - m)^2)) of magnitudes over the box, nothing scaled")
    say(f"views    {run.path / VIEWS_FOLDER}")
    return 0


def _require_renderable(run: RunFolder, preset: object) -> str:
    """Preset of a run that holds what its rendering reads; UserError for another run."""
    if preset not in ("glint", "hybrid", "paper"):
        raise UserError(
            what="neither fields nor a surface with glints can be rendered from this run",
            where=run.path,
            expected="a run of the preset glint, hybrid or paper",
            got=str(preset),
        )
    name, stage = (FIELDS_NAME, "train") if preset == "paper" else (CONTENT_NAME, "mesh")
    if stage not in run.stages or not (run.path / name).is_file():
        raise UserError(
            what=f"the run has no {name}",
            where=run.path,
            hint="finish it with 'geraf2 reconstruct ... --resume'",
        )
    return str(preset)


def _seen(held_out: bool) -> str:
    return "" if held_out else "  (seen in training)"


def _grid(prior: LosPrior, spacing_m: float) -> Grid:
    half = 0.5 * max(prior.size_m)
    return Grid.cube(prior.center_m, half, round(2.0 * half / spacing_m) + 1)


def _render(
    run: RunFolder, capture: Capture, planes: list[int], grid: Grid, view_of: View
) -> list[float]:
    from geraf2.report.figures import projections  # noqa: PLC0415 - matplotlib takes 0.5 s

    folder = run.path / VIEWS_FOLDER
    folder.mkdir(exist_ok=True)
    values: list[float] = []
    with progress_bar("rendering") as report:
        for number, plane in enumerate(planes, start=1):
            pose = capture.poses[plane]
            view = view_of(pose)
            values.append(view.psnr_db)
            name = f"angle_{pose.angle_deg:05.1f}"
            write_npz_atomic(
                folder / f"{name}.npz",
                {
                    "rendered": view.rendered,
                    "measured": view.measured,
                    "origin_m": np.asarray(grid.origin_m),
                    "spacing_m": np.asarray(grid.spacing_m),
                },
            )
            for kind, volume in (("measured", view.measured), ("rendered", view.rendered)):
                projections(
                    volume, grid, folder / f"{name}_{kind}.png",
                    title=f"{kind}, {pose.angle_deg:g} degrees, PSNR {view.psnr_db:.1f} dB",
                )  # fmt: skip
            report(number / len(planes))
    by_angle = {f"{capture.poses[p].angle_deg:g}": v for p, v in zip(planes, values, strict=True)}
    record = {"psnr_db": by_angle, "mean_psnr_db": float(np.mean(values))}
    write_json_atomic(folder / PSNR_NAME, {**record, **mesh_digest(run.path)})
    run.log("render", level="info", **record)
    return values


def _settings(run: RunFolder) -> dict[str, Any]:
    path = run.path / CONFIG_NAME
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UserError(what=f"cannot be read: {error}", where=path) from None


def _scene(run: RunFolder, settings: dict[str, Any], config: Config) -> tuple[Capture, LosPrior]:
    path = config.scene if config.scene is not None else Path(str(settings.get("scene", "")))
    capture = load_capture(path)
    if capture_digest(capture) != run.scene_digest:
        raise UserError(
            what="is not the scene of the run",
            where=path,
            expected=repr(run.scene_name),
            hint="name it with --scene",
        )
    box, los = settings.get("box"), settings.get("los")
    center = settings.get("box_center", (0.0, 0.0, 0.0))
    prior, _ = load_prior(
        None if los is None else Path(los),
        None if box is None else (float(box[0]), float(box[1]), float(box[2])),
        (float(center[0]), float(center[1]), float(center[2])),
        capture.walls,
    )
    return capture, prior


def _of_fields(
    config: Config, run: RunFolder, capture: Capture, prior: LosPrior, grid: Grid
) -> View:
    """Prepare to render planes from trained fields."""
    from geraf2.paper.checkpoints import (  # noqa: PLC0415 - needs torch
        KIND,
        VERSION,
        config_of,
        load_model,
    )
    from geraf2.paper.model import PaperModel, domain_of  # noqa: PLC0415 - needs torch
    from geraf2.paper.novel_views import render_plane  # noqa: PLC0415 - needs torch
    from geraf2.paper.trainer import make_renderer  # noqa: PLC0415 - needs torch

    path = run.path / FIELDS_NAME
    checkpoint = load_checkpoint(path, kind=KIND, version=VERSION)
    paper: PaperConfig = config_of(checkpoint.header, path)
    model = PaperModel(domain_of(prior), paper)
    load_model(model, checkpoint.arrays, path)
    renderer = make_renderer(capture.waveform, prior, paper, num_threads=config.threads)
    with_reflectivity = checkpoint.header["stage"] == 2 and paper.stage2.train_reflectivity

    def view(pose: Pose) -> "PlaneView":
        return render_plane(
            renderer, model, pose, grid, with_reflectivity=with_reflectivity,
            n_draws=config.n_draws, seed=config.seed, num_threads=config.threads,
        )  # fmt: skip

    return view
