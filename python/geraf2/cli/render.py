"""`geraf2 render`: heat maps of any plane of antennas from a run, beside the measured."""

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np

from geraf2._bounds import Arg
from geraf2.cli._console import CONSOLE, keep, rows, say, threads
from geraf2.cli._fields import Positional
from geraf2.io.run_folder import VIEWS_FOLDER
from geraf2.pipeline.commands.render import RenderOptions, render


@dataclass(frozen=True, kw_only=True)
class Config:
    """Render the heat maps of planes from a run and compare them with the measured ones.

    Constants of the fit, fields of `geraf2.RenderOptions`, are flags too: --echo.n-nodes 48.
    """

    out: Positional[Annotated[Path, Arg(metavar="RUN")]]
    """Run folder of `geraf2 reconstruct` with the preset fast, best or paper. The surface of the
    first two gets its reflectivity here, from the planes that the run did not leave out."""
    scene: Annotated[Path | None, Arg(metavar="SCENE")] = None
    """Scene folder, if it was moved after the run."""
    options: Annotated[RenderOptions, Arg(name="")] = field(default_factory=RenderOptions)
    """Which planes are rendered, and how finely."""


def main(config: Config) -> int:
    """Run the command."""
    planes = render(
        config.out, config.options, scene=config.scene, num_threads=threads(), listener=CONSOLE
    )
    table = [
        (
            f"{plane.angle_deg:g} deg",
            f"{plane.psnr_db:.2f} dB" + ("" if plane.held_out else "  (seen in training)"),
        )
        for plane in planes
    ]
    mean = np.mean([plane.psnr_db for plane in planes])
    keep({"planes": [asdict(plane) for plane in planes], "mean_psnr_db": float(mean)})
    keep({"views": str(config.out / VIEWS_FOLDER)})
    rows([*table, ("mean", f"{mean:.2f} dB")])
    say("PSNR: 10 log10(max(m)^2 / mean((r - m)^2)) of magnitudes over the box, nothing scaled")
    say(f"views    {config.out / VIEWS_FOLDER}")
    return 0
