"""`geraf2 simulate`: a physical-optics capture from a spec."""

from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Annotated

from geraf2._bounds import Arg, Seed
from geraf2.cli._console import CONSOLE, keep, rows, threads
from geraf2.cli._fields import Positional
from geraf2.io.container import LOS_NAME, TRUTH_NAME
from geraf2.pipeline.commands.simulate import simulate_scene
from geraf2.simulation import load_spec
from geraf2.simulation.spec import use_scan_file


@dataclass(frozen=True, kw_only=True)
class Config:
    """Simulate the capture of a metal object in boxes; writes a scene with its truth."""

    spec: Positional[Annotated[Path, Arg(metavar="SPEC.toml")]]
    """What to simulate."""
    out: Positional[Annotated[Path, Arg(metavar="OUT")]]
    """Scene folder to make; also gets truth.ply and los.ply."""
    scan: Annotated[Path | None, Arg(metavar="SCAN.json")] = None
    """Scan file of `geraf2 plan --out`, instead of the planes of the spec."""
    seed: Seed = 0
    """Seed of noise, jitter, and scatterers."""
    overwrite: bool = False
    """Replace another scene in this folder."""


def main(config: Config) -> int:
    """Run the command."""
    spec = load_spec(config.spec)
    if config.scan is not None:
        spec = use_scan_file(spec, config.scan)
    simulate_scene(
        spec,
        config.out,
        seed=config.seed,
        overwrite=config.overwrite,
        num_threads=threads(),
        listener=CONSOLE,
    )
    written = [("scene", config.out), ("truth", config.out / TRUTH_NAME)]
    if spec.walls:
        written.append(("box", config.out / LOS_NAME))
    keep({name: str(path) for name, path in written})
    command = "reconstruct" if spec.belt is None else "belt"
    next_command = f"geraf2 {command} {quote(str(config.out))} out"
    rows([*((name, str(path)) for name, path in written), ("next", next_command)])
    return 0
