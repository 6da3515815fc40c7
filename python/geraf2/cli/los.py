"""`geraf2 los`: the line-of-sight prior from photos, a mesh, box sides or a radar scan."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from geraf2._bounds import Arg, Triple
from geraf2.apps.photos.los import FIELD_NAME, MESH_NAME, VIEWS_NAME, make_los
from geraf2.cli._console import CONSOLE, keep, rows, threads
from geraf2.cli._fields import Positional
from geraf2.errors import UserError
from geraf2.pipeline.los_options import LosOptions


@dataclass(frozen=True, kw_only=True)
class Config:
    """Make the line-of-sight prior: closed mesh and signed distance of the outside of the box."""

    source: Positional[Annotated[tuple[str, ...], Arg(metavar="PHOTOS|MESH|X Y Z|SCENE")]]
    """Photos with poses (transforms.json or COLMAP), a mesh (closed, or a scan with holes), three
    outer side lengths in metres, as 0.22 0.22 0.22 or 0.22x0.22x0.22, or a scene, whose box is
    found from the echoes of its walls."""
    out: Positional[Annotated[Path, Arg(metavar="OUT")]]
    """Folder for los.ply, los.npz, los.json and pictures; --los OUT then uses it."""
    box_center: Annotated[Triple, Arg(metavar="X Y Z")] = (0.0, 0.0, 0.0)
    """Where the middle of a box of given sides lies [m]."""
    overwrite: bool = False
    """Replace a finished prior of something else in OUT."""
    options: Annotated[LosOptions, Arg(name="")] = field(default_factory=LosOptions)
    """Options of the source; --unit, --to-radar and --bounds are for meshes, too."""


def main(config: Config) -> int:
    """Run the command."""
    if len(config.source) not in (1, 3):
        got = f"{len(config.source)} words"
        raise UserError(what="a source is one path, or three sides", got=got)
    made = make_los(
        " ".join(config.source),
        config.out,
        config.options,
        box_center_m=config.box_center,
        overwrite=config.overwrite,
        num_threads=threads(),
        listener=CONSOLE,
    )
    prior = made.prior
    size = " x ".join(f"{1e3 * side:.1f}" for side in prior.size_m)
    center = ", ".join(f"{1e3 * value:z.1f}" for value in prior.center_m)
    pairs = [
        ("outside", f"{size} mm around ({center}) mm, {len(prior.faces)} triangles"),
        *[
            (name, _number(value))
            for name, value in made.record.numbers.items()
            if not isinstance(value, list | dict)
        ],
        ("mesh", str(made.path / MESH_NAME)),
        ("distance", str(made.path / FIELD_NAME)),
    ]
    keep({"out": str(made.path), "size_m": prior.size_m, "center_m": prior.center_m})
    keep(made.record.numbers)
    if VIEWS_NAME in made.files:
        pairs.append(("pictures", str(made.path / VIEWS_NAME)))
    rows([*pairs, ("next", f"geraf2 reconstruct SCENE RUN --los {made.path}")])
    return 0


def _number(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
