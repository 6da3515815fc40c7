"""`geraf2 image`: matched-filter volume of a scene."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from geraf2._bounds import Arg
from geraf2.cli._console import CONSOLE, keep, say, threads
from geraf2.cli._fields import Positional
from geraf2.io.run_folder import IMAGE_NAME
from geraf2.pipeline.commands.image import (
    DEPTH_PICTURE_NAME,
    PICTURE_NAME,
    SIDECAR_NAME,
    ImageOptions,
    image_scene,
)

_LABELS = {
    IMAGE_NAME: "volume",
    SIDECAR_NAME: "about it",
    PICTURE_NAME: "projections",
    DEPTH_PICTURE_NAME: "sharpest slice",
}


@dataclass(frozen=True, kw_only=True)
class Config:
    """Image a scene with the matched filter: full apertures, magnitudes added over the planes.

    A planar scan needs no box: the depth at which its image is sharpest is found, anywhere or
    between those of --depth-m.
    """

    scene: Positional[Annotated[Path, Arg(metavar="SCENE")]]
    """Scene folder."""
    out: Positional[Annotated[Path, Arg(metavar="OUT")]]
    """Run folder; gets image.npz, image.json and figures/projections.png."""
    options: Annotated[ImageOptions, Arg(name="")] = field(default_factory=ImageOptions)
    """What is imaged, and where."""
    overwrite: bool = False
    """Replace an image of other options, or the run of another scene."""


def main(config: Config) -> int:
    """Run the command."""
    made = image_scene(
        config.scene,
        config.out,
        config.options,
        overwrite=config.overwrite,
        num_threads=threads(),
        listener=CONSOLE,
    )
    keep({"method": made.method, "strongest_m": made.strongest_m, "searched_m": made.searched_m})
    keep({"depths_m": made.depths_m.tolist(), "sharpness": made.sharpness.tolist()})
    keep({"files": [str(made.path / name) for name in made.files]})
    say(f"{'method':<14} {made.method}")
    say(f"largest at     ({', '.join(f'{x:z.3f}' for x in made.strongest_m)}) m")
    if made.searched_m is not None:
        say(f"searched       {made.searched_m:.3g} m before the plane it is sharpest")
    if len(made.sharpness):
        best = int(made.sharpness.argmax())
        say(f"sharpest depth {made.depths_m[best]:.4f} m, sharpness {made.sharpness[best]:.3g}")
    for name in made.files:
        say(f"{_LABELS[name]:<14} {made.path / name}")
    return 0
