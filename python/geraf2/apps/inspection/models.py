"""CAD models: reading, conversion to metres, checks."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from geraf2._types import Floats
from geraf2.errors import UserError
from geraf2.geometry.transforms import triple
from geraf2.geometry.triangles import count_open_edges, enclosed_volume_m3
from geraf2.io.mesh import TriangleMesh, read_mesh

UNITS_M = {"mm": 1e-3, "m": 1.0, "in": 0.0254, "cm": 0.01}
"""Units of CAD files, the usual first [m]."""

# Largest ratio of the sizes of a model and of the content; inches and centimetres differ by 2.54.
_LIKELY = {"mm": 3.0, "m": 3.0, "in": 1.6, "cm": 1.6}


@dataclass(frozen=True, kw_only=True, eq=False)
class CadModel:
    """A model to be found."""

    name: str
    """Stem of its file; with its folder, or the whole path, where two have the same."""
    mesh: TriangleMesh
    """Closed surface, wound outward, in its own frame [m]."""
    unit: str
    """Unit of the file."""

    @cached_property
    def lengths_m(self) -> tuple[float, float, float]:
        """Sides of the smallest box around it, the longest first [m]."""
        import trimesh  # noqa: PLC0415 - takes 0.3 s

        sides = trimesh.bounds.oriented_bounds(self.mesh.vertices, ordered=True)[1]
        return triple(sorted(sides, reverse=True))


def read_models(
    paths: Sequence[Path | str], sizes_m: Sequence[float], unit: str | None = None
) -> list[CadModel]:
    """Read CAD files (STL, PLY, OBJ, GLB).

    sizes_m: diagonals of the bounding boxes of the content, from which the unit is inferred [m].
    unit: mm, cm, m or in, where it is known.

    Raises UserError where a file is no closed mesh or fits the content in no unit.
    """
    models = [_read(Path(path), sizes_m, unit) for path in paths]
    full = [Path(path) for path in paths]
    for names in ([f"{p.parent.name}/{p.stem}" for p in full], [str(p) for p in full]):
        counts = Counter(model.name for model in models)
        models = [
            replace(model, name=name) if counts[model.name] > 1 else model
            for model, name in zip(models, names, strict=True)
        ]
    return models


def model_of(mesh: TriangleMesh, name: str, unit: str = "m", where: object = None) -> CadModel:
    """Check a mesh in metres; UserError unless it is closed."""
    n_open = count_open_edges(mesh.faces)
    if len(mesh.faces) == 0 or n_open:
        raise UserError(
            what="the CAD model is not closed",
            where=where or name,
            expected="every edge shared by two faces",
            got=f"{n_open} open edges of {mesh.faces.size}",
            hint="export it as a solid",
        )
    if enclosed_volume_m3(mesh.vertices, mesh.faces) < 0:
        mesh = TriangleMesh(vertices=mesh.vertices, faces=np.ascontiguousarray(mesh.faces[:, ::-1]))
    return CadModel(name=name, mesh=mesh, unit=unit)


def diagonal_m(vertices: Floats) -> float:
    """Diagonal of the bounding box of vertices (n, 3) [m]."""
    return float(np.linalg.norm(np.ptp(vertices, axis=0)))


def _read(path: Path, sizes_m: Sequence[float], unit: str | None) -> CadModel:
    mesh = read_mesh(path, any_unit=True)
    known = unit or _likely_unit(path, diagonal_m(mesh.vertices), sizes_m)
    scaled = TriangleMesh(vertices=UNITS_M[known] * mesh.vertices, faces=mesh.faces)
    return model_of(scaled, path.stem, known, path)


def _likely_unit(path: Path, size: float, sizes_m: Sequence[float]) -> str:
    """Return the unit in which a model is about as large as a part of the content."""
    for unit, length_m in UNITS_M.items():
        ratios = [max(size * length_m / s, s / (size * length_m)) for s in sizes_m]
        if min(ratios) <= _LIKELY[unit]:
            return unit
    found = ", ".join(f"{1e3 * size_m:.0f}" for size_m in sizes_m)
    raise UserError(
        what="the CAD model is as large as nothing in the box in mm, m, inches or cm",
        where=path,
        expected=f"a diagonal of about {found} mm",
        got=f"{size:.4g} in the file",
        hint="give its unit with --unit, or another model",
    )
