"""`geraf2 demo`: simulate, reconstruct, evaluate, report."""

import time
from dataclasses import dataclass, field
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated

from geraf2._bounds import Arg, Seed
from geraf2.cli._console import CONSOLE, rows, say, threads
from geraf2.cli._fields import Positional
from geraf2.cli._outcome import print_found, print_next, print_verdict
from geraf2.cli.evaluate import print_metrics
from geraf2.io.atomic import write_json_atomic
from geraf2.io.container import LOS_NAME, TRUTH_NAME
from geraf2.io.outputs import require_folder
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
    seed: Seed = 0
    """Seed of noise and of the samples of the evaluation."""
    settings: Annotated[BestPreset, Arg(name="", hidden=True)] = field(default_factory=BestPreset)
    """Constants of the method."""


def main(config: Config) -> int:
    """Run the command."""
    start, n_threads = time.perf_counter(), threads()
    scene, out = config.out / "scene", config.out / "run"
    require_folder(config.out, "demo", own=(config.out / _MARKER_NAME).is_file())
    with as_file(files("geraf2.simulation") / "demo.toml") as path:
        spec = load_spec(path)
    require_simulable(spec)
    write_json_atomic(config.out / _MARKER_NAME, {"format": "geraf2-demo", "format_version": 1})
    simulate_scene(
        spec, scene, seed=config.seed, overwrite=True, num_threads=n_threads, listener=CONSOLE
    )
    options = ImageOptions(every=_HEATMAP_EVERY)
    image_scene(scene, out, options, overwrite=True, num_threads=n_threads, listener=CONSOLE)
    result = reconstruct(
        scene,
        scene / LOS_NAME,
        config.settings,
        out,
        options=RunOptions(seed=config.seed),
        overwrite=True,  # of an earlier demo
        num_threads=n_threads,
        listener=CONSOLE,
    )
    truth = scene / TRUTH_NAME
    metrics = evaluate(result, truth, seed=config.seed, num_threads=n_threads, listener=CONSOLE)
    say()
    print_found(result)
    say()
    print_metrics(metrics)
    say()
    rows([("time", f"{time.perf_counter() - start:.0f} s"), ("scene", str(scene))])
    print_next(result)
    return print_verdict(result.verdict)
