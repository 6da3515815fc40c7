"""`geraf2 render`: heat maps of any plane of antennas from a trained run, beside the measured."""

import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

from geraf2.cli._console import Positional, Threads, progress_bar, require_threads, rows, say
from geraf2.cli._paper import FIELDS_NAME
from geraf2.cli._planes import planes_at
from geraf2.cli._prior import load_prior
from geraf2.errors import UserError
from geraf2.io.atomic import write_npz_atomic, write_text_atomic
from geraf2.io.checkpoint import load_checkpoint
from geraf2.io.run_folder import CONFIG_NAME, RunFolder
from geraf2.scene import Capture, Grid, LosPrior, load_capture
from geraf2.scene.store import capture_digest

if TYPE_CHECKING:
    from geraf2.rendering import LenslessRenderer
    from geraf2.training.config import PaperConfig
    from geraf2.training.model import PaperModel

VIEWS_FOLDER = "views"
PSNR_NAME = "psnr.json"
_PAPER_ANGLES = (0.0, 90.0, 180.0, 270.0)


@dataclass(frozen=True, kw_only=True)
class Config:
    """Render the heat maps of planes from a trained run and compare them with the measured ones."""

    out: Positional[Annotated[Path, tyro.conf.arg(metavar="RUN")]]
    """Run folder of `geraf2 reconstruct --preset paper`."""
    angles: Annotated[tuple[float, ...], tyro.conf.arg(metavar="DEG ...")] = ()
    """Turntable angles of the planes [degrees]; those that the run left out when not given, else 0,
    90, 180 and 270."""
    scene: Annotated[Path | None, tyro.conf.arg(metavar="SCENE")] = None
    """Scene folder, where it is no longer where the run found it."""
    spacing_m: float = 0.004
    """Voxels of the heat maps [m]."""
    n_draws: int = 4
    """Draws of the samples whose powers are averaged."""
    seed: int = 0
    """Of the draws."""
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
    require_fields(run)
    if settings.get("preset") != "paper":
        raise UserError(
            what="the fields are not of --preset paper",
            where=run.path,
            got=str(settings.get("preset")),
        )
    angles = config.angles or tuple(settings.get("hold_out", ())) or _PAPER_ANGLES
    planes = planes_at(capture, angles, run.scene_name)
    renderer, model, trained = _fields(run, capture, prior, num_threads)
    values = _render(config, run, capture, prior, planes, (renderer, model, trained), num_threads)
    held_out = set(planes_at(capture, tuple(settings.get("hold_out", ())), run.scene_name))
    table = [
        (f"{capture.poses[p].angle_deg:g} deg", f"{v:.2f} dB" + _seen(p in held_out))
        for p, v in zip(planes, values, strict=True)
    ]
    rows([*table, ("mean", f"{np.mean(values):.2f} dB")])
    say("PSNR: 10 log10(max(m)^2 / mean((r - m)^2)) of magnitudes over the box, nothing scaled")
    say(f"views    {run.path / VIEWS_FOLDER}")
    return 0


def _seen(held_out: bool) -> str:
    return "" if held_out else "  (seen in training)"


def _render(
    config: Config,
    run: RunFolder,
    capture: Capture,
    prior: LosPrior,
    planes: list[int],
    trained: tuple["LenslessRenderer", "PaperModel", bool],
    num_threads: int | None,
) -> list[float]:
    from geraf2.report.figures import projections  # noqa: PLC0415 - matplotlib takes 0.5 s
    from geraf2.training.novel_views import render_plane  # noqa: PLC0415 - needs torch

    renderer, model, with_reflectivity = trained
    folder = run.path / VIEWS_FOLDER
    folder.mkdir(exist_ok=True)
    half = 0.5 * max(prior.size_m)
    grid = Grid.cube(prior.center_m, half, round(2.0 * half / config.spacing_m) + 1)
    values: list[float] = []
    with progress_bar("rendering") as report:
        for number, plane in enumerate(planes, start=1):
            pose = capture.poses[plane]
            view = render_plane(
                renderer, model, pose, grid, with_reflectivity=with_reflectivity,
                n_draws=config.n_draws, seed=config.seed, num_threads=num_threads,
            )  # fmt: skip
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
    write_text_atomic(folder / PSNR_NAME, json.dumps(record, indent=2) + "\n")
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


def require_fields(run: RunFolder) -> None:
    """Raise UserError unless the run has trained fields."""
    if not (run.path / FIELDS_NAME).is_file():
        raise UserError(
            what=f"the run has no {FIELDS_NAME}",
            where=run.path,
            hint="make one with 'geraf2 reconstruct --preset paper'",
        )


def _fields(
    run: RunFolder, capture: Capture, prior: LosPrior, num_threads: int | None
) -> tuple["LenslessRenderer", "PaperModel", bool]:
    from geraf2.training.checkpoints import (  # noqa: PLC0415 - needs torch
        KIND,
        VERSION,
        config_of,
        load_model,
    )
    from geraf2.training.model import PaperModel, domain_of  # noqa: PLC0415 - needs torch
    from geraf2.training.trainer import make_renderer  # noqa: PLC0415 - needs torch

    path = run.path / FIELDS_NAME
    checkpoint = load_checkpoint(path, kind=KIND, version=VERSION)
    paper: PaperConfig = config_of(checkpoint.header, path)
    model = PaperModel(domain_of(prior), paper)
    load_model(model, checkpoint.arrays, path)
    renderer = make_renderer(capture.waveform, prior, paper, num_threads=num_threads)
    return renderer, model, checkpoint.header["stage"] == 2 and paper.stage2.train_reflectivity
