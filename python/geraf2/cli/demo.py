"""`geraf2 demo`: simulate, reconstruct, evaluate, report."""

import shutil
import time
from dataclasses import dataclass, field
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated

from geraf2.cli import image, reconstruct
from geraf2.cli._console import Positional, Threads, require_threads, rows, say
from geraf2.cli._fields import Arg
from geraf2.cli.evaluate import evaluate_run, print_metrics
from geraf2.cli.simulate import simulate_scene
from geraf2.errors import UserError
from geraf2.io.atomic import write_json_atomic
from geraf2.io.container import LOS_NAME, TRUTH_NAME
from geraf2.io.mesh import read_mesh
from geraf2.io.run_folder import CONTENT_NAME, METRICS_NAME, REPORT_NAME, RUN_NAME, RunFolder
from geraf2.pipeline.image import ImageOptions
from geraf2.scene.store import capture_digest
from geraf2.simulation import load_spec
from geraf2.surfaces import ReconstructConfig

# Every fourth pose: the heat map is a picture here, and 9 poses show it in a few seconds.
_HEATMAP_EVERY = 4
_MARKER_NAME = "demo.json"


@dataclass(frozen=True, kw_only=True)
class Config:
    """Simulate a carton with a figure inside, reconstruct it, and compare it with the truth."""

    out: Positional[Annotated[Path, Arg(metavar="OUT")]] = Path("geraf2-demo")
    """Folder for scene/ and run/."""
    spec: Path | None = None
    """Simulate this instead of the demo's own figure."""
    seed: int = 0
    """Seed of noise and of the samples of the evaluation."""
    threads: Threads = None
    """Threads to use; all when not given."""
    settings: Annotated[ReconstructConfig, Arg(name="")] = field(default_factory=ReconstructConfig)
    """Constants of the method."""


def _require_demo_folder(folder: Path) -> None:
    """Refuse a folder that no earlier demo made: what lies there is replaced."""
    if folder.exists() and not folder.is_dir():
        raise UserError(what="is a file", where=folder, expected="a folder for the demo")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / _MARKER_NAME).is_file():
        raise UserError(
            what="holds files but no demo of geraf2", where=folder, hint="choose another folder"
        )


def main(config: Config) -> int:
    """Run the command."""
    start = time.perf_counter()
    num_threads = require_threads(config.threads)
    scene, run_path = config.out / "scene", config.out / "run"
    _require_demo_folder(config.out)
    if config.spec is None:
        with as_file(files("geraf2.simulation") / "demo.toml") as path:
            spec = load_spec(path)
    else:
        spec = load_spec(config.spec)
    if not spec.walls:
        raise UserError(what="the spec has no walls, and so no box to look into", where=config.spec)
    write_json_atomic(config.out / _MARKER_NAME, {"format": "geraf2-demo", "format_version": 1})
    capture, _ = simulate_scene(
        spec, scene, seed=config.seed, overwrite=True, num_threads=num_threads
    )
    has_run = (run_path / RUN_NAME).is_file()
    if has_run and RunFolder.read(run_path).scene_digest != capture_digest(capture):
        shutil.rmtree(run_path)  # an earlier demo of another figure or seed
    image.main(
        image.Config(
            scene=scene,
            out=run_path,
            options=ImageOptions(every=_HEATMAP_EVERY),
            threads=config.threads,
        )
    )
    run = reconstruct.reconstruct_scene(
        reconstruct.Config(
            scene=scene,
            out=run_path,
            los=scene / LOS_NAME,
            seed=config.seed,
            threads=config.threads,
            settings=config.settings,
            no_report=True,  # the evaluation draws it
        )
    )
    truth = read_mesh(scene / TRUTH_NAME)
    metrics = evaluate_run(run, truth, 10000, config.seed, num_threads)
    say()
    print_metrics(metrics)
    say()
    rows(
        [
            ("scene", str(scene)),
            ("mesh", str(run.path / CONTENT_NAME)),
            ("pictures", str(run.path / "figures")),
            ("metrics", str(run.path / METRICS_NAME)),
            ("report", str(run.path / REPORT_NAME)),
            ("time", f"{time.perf_counter() - start:.0f} s"),
        ]
    )
    return 0
