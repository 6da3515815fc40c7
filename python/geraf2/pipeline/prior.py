"""The line-of-sight prior of a run: from a mesh, a folder of `geraf2 los`, or a box."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from geraf2._bounds import Arg, Sides, Triple
from geraf2.errors import UserError
from geraf2.geometry.transforms import triple
from geraf2.io.array_layouts import read_arrays
from geraf2.io.atomic import write_npz_atomic
from geraf2.io.container import LOS_NAME
from geraf2.io.mesh import read_mesh
from geraf2.pipeline.events import Listener
from geraf2.scene import LosPrior, Wall

# Largest difference between box and prior that the accuracy of a tape measure explains [m].
_WALL_MISMATCH_M = 0.02


@dataclass(frozen=True, kw_only=True)
class PriorSource:
    """Source of the outside of the box."""

    los: Annotated[Path | None, Arg(metavar="MESH|PHOTOS")] = None
    """Outside of the box: a closed mesh (metres, the scene's frame), a folder of `geraf2 los`, or
    photos with poses, from which a surface is trained first."""
    box: Annotated[Sides | None, Arg(metavar="X Y Z")] = None
    """Or the outer side lengths of the box, axes along the frame's [m]. Neither: the
    box that the scene states, else by radar."""
    box_center: Annotated[Triple, Arg(metavar="X Y Z")] = (0.0, 0.0, 0.0)
    """Centre of the box with these sides [m]."""

    @classmethod
    def from_argument(
        cls, prior: "LosPrior | PriorSource | Path | str | Triple | None"
    ) -> "PriorSource":
        """Source from a user's argument; empty for a prior in memory, and for none."""
        if isinstance(prior, PriorSource):
            return prior
        if prior is None or isinstance(prior, LosPrior):
            return cls()
        return cls(los=Path(prior)) if isinstance(prior, str | Path) else cls(box=prior)

    @property
    def is_given(self) -> bool:
        """Whether there is a source; UserError if there are two."""
        if self.los is not None and self.box is not None:
            raise UserError(
                what="give the outside of the box once",
                expected="either --los MESH or --box X Y Z",
                got="both",
            )
        return self.los is not None or self.box is not None

    def load(
        self, walls: tuple[Wall, ...] = (), listener: Listener | None = None
    ) -> tuple[LosPrior, str]:
        """Prior, and its name in errors; arguments as those of :func:`load_prior`."""
        if not self.is_given:
            raise UserError(
                what="give the outside of the box",
                expected="either --los MESH or --box X Y Z",
                got="neither",
            )
        source = self.los or self.box or ""
        prior = load_prior(source, center_m=self.box_center, walls=walls, listener=listener)
        return prior, str(self.los) if self.box is None else f"--box {format_lengths(self.box)}"


def load_prior(
    source: Path | str | Sequence[float],
    *,
    center_m: Sequence[float] = (0.0, 0.0, 0.0),
    walls: tuple[Wall, ...] = (),
    listener: Listener | None = None,
) -> LosPrior:
    """Outside of the box, in the capture frame.

    Parameters
    ----------
    source
        File of a closed mesh in metres, a folder with los.ply, or the three outer side lengths of a
        box whose axes are those of the frame [m].
    center_m
        Centre of the box if `source` is side lengths, (3,) [m].
    walls
        Known walls, outermost first; see :func:`add_walls`.
    listener
        Receives a warning if walls and prior differ in size.

    Returns
    -------
    LosPrior
        Prior with a closed mesh [m].

    Raises
    ------
    UserError
        If there is no such mesh, it is not closed, or the lengths are not three positive numbers.

    Examples
    --------
    >>> geraf2.load_prior((0.22, 0.22, 0.22), center_m=(0.0, 0.0, 0.1)).center_m
    (0.0, 0.0, 0.1)
    """
    heard = listener or Listener()
    if isinstance(source, Path | str):
        path = Path(source)
        if path.is_dir() and not (path / LOS_NAME).is_file():
            raise UserError(
                what="is no line-of-sight prior",
                where=path,
                expected=f"a mesh file or a folder with {LOS_NAME}",
                hint="make one of photos, a scan or a box with 'geraf2 los'",
            )
        mesh = read_mesh(path / LOS_NAME if path.is_dir() else path)
        return add_walls(LosPrior.from_mesh(mesh, where=path), walls, heard)
    size, center = np.asarray(source, dtype=np.float64), np.asarray(center_m, dtype=np.float64)
    if size.shape != (3,) or not (np.isfinite(size).all() and size.min() > 0):
        raise UserError(
            what="a box must have three positive side lengths [m]", got=format_lengths(source)
        )
    if center.shape != (3,) or not np.isfinite(center).all():
        raise UserError(what="the centre of the box must be finite", got=format_lengths(center_m))
    return add_walls(LosPrior.from_box(triple(size), triple(center)), walls, heard)


def add_walls(
    prior: LosPrior, walls: tuple[Wall, ...], listener: Listener | None = None
) -> LosPrior:
    """Prior with the walls of a capture, the outermost with the measured size of the prior.

    Inner walls larger than the prior are left out. A rotated cuboid has its own sides.

    listener: warned if the scene states another size; None for a box by radar.
    """
    if not walls:
        return prior
    outer, size_m = walls[0], prior.size_m
    if prior.cuboid is not None:
        size_m = triple(prior.cuboid[1])
    off_m = float(np.abs(np.asarray(outer.size_m) - size_m).max())
    if listener is not None and off_m > _WALL_MISMATCH_M:
        listener.warning(
            f"by the scene the box is {format_lengths(outer.size_m)} m, the prior is "
            f"{format_lengths(size_m)} m; the prior is used"
        )
    if 2.0 * outer.thickness_m >= min(size_m):
        raise UserError(
            what=f"the box is {format_lengths(size_m)} m, no larger than its walls are thick",
            expected=f"more than {2.0 * outer.thickness_m:g} m",
            hint="is it in metres?",
        )
    fitted = replace(outer, size_m=size_m, center_m=prior.center_m)
    inner = (wall for wall in walls[1:] if np.less(wall.size_m, size_m).all())
    return replace(prior, walls=(fitted, *inner))


def format_lengths(values: Sequence[float]) -> str:
    """Format lengths as on a command line."""
    return " ".join(f"{value:g}" for value in values)


def save_prior(prior: LosPrior, path: Path) -> None:
    """Write the surface of a prior and its walls without loss."""
    rows = [[*w.size_m, w.thickness_m, w.permittivity, *w.center_m] for w in prior.walls]
    walls = np.asarray(rows, dtype=np.float64).reshape(-1, 8)
    write_npz_atomic(path, {"vertices": prior.vertices, "faces": prior.faces, "walls": walls})


def read_prior(path: Path) -> LosPrior:
    """Read a file written by :func:`save_prior`."""
    layouts = {"vertices": "float n 3", "faces": "index:n m 3", "walls": "float k 8"}
    arrays = read_arrays(path, layouts)
    try:
        walls = tuple(
            Wall(size_m=(x, y, z), thickness_m=thickness, permittivity=eps, center_m=(mx, my, mz))
            for x, y, z, thickness, eps, mx, my, mz in arrays["walls"].tolist()
        )
    except ValueError as error:
        raise UserError(what=f"no walls of a box: {error}", where=path) from None
    if not len(arrays["faces"]):
        raise UserError(what="holds no triangles", where=path)
    return LosPrior(vertices=arrays["vertices"], faces=arrays["faces"], walls=walls)
