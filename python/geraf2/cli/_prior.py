"""The line-of-sight prior from the flags --los and --box."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from geraf2.cli._console import warn
from geraf2.errors import UserError
from geraf2.io.container import LOS_NAME
from geraf2.io.mesh import read_mesh
from geraf2.scene import LosPrior, Wall

# Cartons are measured to a few millimetres; beyond this, one of the two sizes is wrong.
_WALL_MISMATCH_M = 0.02

Triple = tuple[float, float, float]


def load_prior(
    los: Path | None, box: Triple | None, box_center: Triple, walls: tuple[Wall, ...]
) -> tuple[LosPrior, object]:
    """Prior, and what to call it in errors. Known walls are fitted to its outside."""
    if (los is None) == (box is None):
        raise UserError(
            what="give the outside of the box",
            expected="either --los MESH or --box X Y Z",
            got="both" if los is not None else "neither",
        )
    if box is not None:
        if not (np.isfinite(box).all() and min(box) > 0):
            raise UserError(
                what="--box must be three positive side lengths in metres", got=_spaced(box)
            )
        if not np.isfinite(box_center).all():
            raise UserError(what="--box-center must be finite", got=_spaced(box_center))
        prior, where = LosPrior.from_box(box, box_center), "--box " + _spaced(box)
    else:
        assert los is not None  # one of the two is given
        mesh = read_mesh(_mesh_of(los))
        prior, where = LosPrior.from_mesh(mesh, where=los), str(los)
    return replace(prior, walls=_fitted_walls(prior, walls)), where


def _mesh_of(los: Path) -> Path:
    """Mesh file of --los, which may be a folder that `geraf2 los` made."""
    if not los.is_dir():
        return los
    if (los / LOS_NAME).is_file():
        return los / LOS_NAME
    raise UserError(
        what="is no line-of-sight prior",
        where=los,
        expected=f"a mesh file or a folder with {LOS_NAME}",
        hint="make one of photos, a scan or a box with 'geraf2 los'",
    )


def _fitted_walls(prior: LosPrior, walls: tuple[Wall, ...]) -> tuple[Wall, ...]:
    """Walls of the scene, the outermost as large as the prior; the prior was measured."""
    if not walls:
        return ()
    outer = walls[0]
    difference = float(np.abs(np.asarray(outer.size_m) - prior.size_m).max())
    if difference > _WALL_MISMATCH_M:
        warn(
            f"the scene says that the box is {_spaced(outer.size_m)} m, the prior is "
            f"{_spaced(prior.size_m)} m; the prior is used"
        )
    fitted = replace(outer, size_m=prior.size_m, center_m=prior.center_m)
    inner = tuple(
        wall
        for wall in walls[1:]
        if all(w < p for w, p in zip(wall.size_m, prior.size_m, strict=True))
    )
    return (fitted, *inner)


def _spaced(values: Triple) -> str:
    return " ".join(f"{value:g}" for value in values)
