"""Glints: oriented points from specular returns."""

from dataclasses import dataclass

import numpy as np

from geraf2._short import Short
from geraf2._types import AnyPath, Bools, Floats, Ints
from geraf2._validation import require_shape
from geraf2.io.array_layouts import read_arrays
from geraf2.io.atomic import write_npz_atomic
from geraf2.io.points import cloud_bytes

_LAYOUTS = {
    "positions": "float n 3",
    "normals": "float n 3",
    "strengths": "float n",
    "position_sigma_m": "float n",
    "normal_sigma_rad": "float n",
    "poses": "int n",
    "probability": "float n",
}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Glints(Short):
    """Specular returns: positions and normals of the surface."""

    positions: Floats
    """(n_glints, 3) [m]."""
    normals: Floats
    """Outward unit normals, (n_glints, 3)."""
    strengths: Floats
    """Echo amplitude on one scale for the whole capture, (n_glints,)."""
    position_sigma_m: Floats
    """Standard uncertainty of the position along the normal, (n_glints,) [m]."""
    normal_sigma_rad: Floats
    """Standard uncertainty of the normal's direction, (n_glints,) [rad]."""
    poses: Ints
    """Index of the plane that saw each glint, (n_glints,)."""
    probability: Floats
    """Probability that the glint is a direct return of the content, (n_glints,)."""

    def __post_init__(self) -> None:
        n = self.positions.shape[0]
        require_shape("positions", self.positions, (n, 3))
        require_shape("normals", self.normals, (n, 3))
        for name in ("strengths", "position_sigma_m", "normal_sigma_rad", "poses", "probability"):
            require_shape(name, getattr(self, name), (n,))

    def __len__(self) -> int:
        return int(self.positions.shape[0])

    def select(self, keep: Bools | Ints) -> "Glints":
        """Subset by mask or index."""
        return Glints(**{name: getattr(self, name)[keep] for name in self.__dataclass_fields__})

    def join(self, others: "Glints") -> "Glints":
        """Append other glints."""
        names = self.__dataclass_fields__
        return Glints(**{n: np.concatenate([getattr(self, n), getattr(others, n)]) for n in names})

    def save(self, path: AnyPath) -> None:
        """Write `glints.npz`: one array per field, in the units given above."""
        write_npz_atomic(path, {name: getattr(self, name) for name in self.__dataclass_fields__})

    def cloud_bytes(self) -> bytes:
        """PLY file of the points with their normals; the other fields are columns."""
        names = [n for n in self.__dataclass_fields__ if n not in ("positions", "normals")]
        columns = {name: getattr(self, name) for name in names}
        return cloud_bytes(self.positions, self.normals, columns)

    @classmethod
    def load(cls, path: AnyPath) -> "Glints":
        """Read a file written by `save`; UserError for any other file."""
        return cls(**read_arrays(path, _LAYOUTS))


def relative_strengths(strengths: Floats) -> Floats:
    """Strengths relative to a strong glint's, their 98 % quantile, at most 1, (n,)."""
    return np.asarray(np.minimum(1.0, strengths / float(np.quantile(strengths, 0.98))))
