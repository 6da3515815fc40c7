"""The line-of-sight prior: from side lengths, a mesh or a folder, and kept in a run."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from geraf2.errors import UserError
from geraf2.io.arrays import read_npz
from geraf2.io.atomic import write_npz_atomic
from geraf2.io.container import LOS_NAME
from geraf2.io.mesh import read_mesh
from geraf2.pipeline.events import Listener
from geraf2.scene import LosPrior, Wall

# Cartons are measured to a few millimetres; beyond this, one of the two sizes is wrong.
_WALL_MISMATCH_M = 0.02

Triple = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class PriorSource:
    """Where the outside of the box comes from."""

    los: Path | None = None
    """Closed mesh in metres in the frame of the scene, folder that `geraf2 los` made, or photos."""
    box: Triple | None = None
    """Outer side lengths of the box, axes along the frame's [m]."""
    box_center: Triple = (0.0, 0.0, 0.0)
    """Where the middle of `box` lies [m]."""

    @classmethod
    def of(cls, prior: "LosPrior | PriorSource | Path | str | Triple") -> "PriorSource":
        """Source of what a user gives; empty for a prior in memory."""
        if isinstance(prior, PriorSource):
            return prior
        if isinstance(prior, LosPrior):
            return cls()
        return cls(los=Path(prior)) if isinstance(prior, str | Path) else cls(box=prior)

    def resolved(self) -> "PriorSource":
        """Return the same with an absolute path."""
        return self if self.los is None else replace(self, los=self.los.resolve())


def load_prior(
    source: PriorSource | Path | str | Triple,
    walls: tuple[Wall, ...] = (),
    listener: Listener | None = None,
) -> tuple[LosPrior, str]:
    """Make the prior of a source, and what to call it in errors.

    Parameters
    ----------
    source
        Mesh, folder with `los.ply`, or three outer side lengths about the origin [m].
    walls
        Known walls, outermost first; the outermost gets the prior's size and place.
    listener
        Hears where the prior and the walls differ.
    """
    source = PriorSource.of(source)
    los, box, center = source.los, source.box, source.box_center
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
        if not np.isfinite(center).all():
            raise UserError(what="--box-center must be finite", got=_spaced(center))
        prior, where = LosPrior.from_box(box, center), "--box " + _spaced(box)
    else:
        assert los is not None  # one of the two is given
        prior, where = LosPrior.from_mesh(read_mesh(_mesh_of(los)), where=los), str(los)
    return replace(prior, walls=_fitted_walls(prior, walls, listener or Listener())), where


def save_prior(prior: LosPrior, path: Path) -> None:
    """Keep a prior and its walls, every bit."""
    rows = [[*w.size_m, w.thickness_m, w.permittivity, *w.center_m] for w in prior.walls]
    walls = np.asarray(rows, dtype=np.float64).reshape(-1, 8)
    write_npz_atomic(path, {"vertices": prior.vertices, "faces": prior.faces, "walls": walls})


def read_prior(path: Path) -> LosPrior:
    """Read what :func:`save_prior` wrote."""
    arrays = read_npz(path, ("vertices", "faces", "walls"))
    walls = tuple(
        Wall(
            size_m=(row[0], row[1], row[2]),
            thickness_m=row[3],
            permittivity=row[4],
            center_m=(row[5], row[6], row[7]),
        )
        for row in arrays["walls"].tolist()
    )
    return LosPrior(vertices=arrays["vertices"], faces=arrays["faces"], walls=walls)


def _mesh_of(los: Path) -> Path:
    """Mesh file of a prior, which may be a folder that `geraf2 los` made."""
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


def _fitted_walls(prior: LosPrior, walls: tuple[Wall, ...], listener: Listener) -> tuple[Wall, ...]:
    """Walls of the scene, the outermost as large as the prior; the prior was measured."""
    if not walls:
        return ()
    outer = walls[0]
    difference = float(np.abs(np.asarray(outer.size_m) - prior.size_m).max())
    if difference > _WALL_MISMATCH_M:
        listener.warning(
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
