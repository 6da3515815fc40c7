"""`geraf2 demo`: simulate, reconstruct, evaluate, report."""

import time
from dataclasses import dataclass, field
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated

from geraf2._bounds import Arg, Seed
from geraf2.cli._console import CONSOLE, Threads, rows, say
from geraf2.cli._fields import Positional
from geraf2.cli._outcome import print_found, print_verdict
from geraf2.cli.evaluate import print_metrics
from geraf2.errors import UserError
from geraf2.io.atomic import write_json_atomic
from geraf2.io.container import LOS_NAME, TRUTH_NAME
from geraf2.io.outputs import require_folder
from geraf2.io.run_folder import CONTENT_NAME, FIGURES_FOLDER, METRICS_NAME, REPORT_NAME
from geraf2.pipeline.commands.evaluate import evaluate
from geraf2.pipeline.commands.image import ImageOptions, image_scene
from geraf2.pipeline.commands.reconstruct import reconstruct
from geraf2.pipeline.commands.simulate import require_simulable, simulate_scene
from geraf2.pipeline.presets import BestPreset
from geraf2.pipeline.run_record import RunOptions
from geraf2.simulation import load_spec

# Every fourth pose: the heat map is a picture here, and 9 poses show it in a few seconds.
_HEATMAP_EVERY = 4
_MARKER_NAME = "demo.json"


@dataclass(frozen=True, kw_only=True)
class Config:
    """Simulate a carton with an object inside, reconstruct it, and compare it with the truth."""

    out: Positional[Annotated[Path, Arg(metavar="OUT")]] = Path("geraf2-demo")
    """Folder for scene/ and run/."""
    spec: Path | None = None
    """Simulate this instead of the demo's own object."""
    seed: Seed = 0
    """Seed of noise and of the samples of the evaluation."""
    threads: Threads = None
    """Threads to use; all when not given."""
    settings: Annotated[BestPreset, Arg(name="", hidden=True)] = field(default_factory=BestPreset)
    """Constants of the method."""


def main(config: Config) -> int:
    """Run the command."""
    start, threads = time.perf_counter(), config.threads
    scene, out = config.out / "scene", config.out / "run"
    require_folder(config.out, "demo", own=(config.out / _MARKER_NAME).is_file())
    if config.spec is None:
        with as_file(files("geraf2.simulation") / "demo.toml") as path:
            spec = load_spec(path)
    else:
        spec = load_spec(config.spec)
    if not spec.walls:
        raise UserError(what="the spec has no walls, and so no box", where=config.spec)
    require_simulable(spec)
    write_json_atomic(config.out / _MARKER_NAME, {"format": "geraf2-demo", "format_version": 1})
    simulate_scene(
        spec, scene, seed=config.seed, overwrite=True, num_threads=threads, listener=CONSOLE
    )
    options = ImageOptions(every=_HEATMAP_EVERY)
    image_scene(scene, out, options, overwrite=True, num_threads=threads, listener=CONSOLE)
    result = reconstruct(
        scene,
        scene / LOS_NAME,
        config.settings,
        out,
        options=RunOptions(seed=config.seed),
        overwrite=True,  # of an earlier demo
        num_threads=threads,
        listener=CONSOLE,
    )
    truth = scene / TRUTH_NAME
    metrics = evaluate(result, truth, seed=config.seed, num_threads=threads, listener=CONSOLE)
    say()
    print_found(result)
    say()
    print_metrics(metrics)
    say()
    rows(
        [
            ("scene", str(scene)),
            ("mesh", str(out / CONTENT_NAME)),
            ("pictures", str(out / FIGURES_FOLDER)),
            ("metrics", str(out / METRICS_NAME)),
            ("report", str(out / REPORT_NAME)),
            ("time", f"{time.perf_counter() - start:.0f} s"),
        ]
    )
    return print_verdict(result.verdict)
