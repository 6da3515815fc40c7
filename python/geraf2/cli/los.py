"""`geraf2 los`: the line-of-sight prior from photos, a mesh or box sides."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np

from geraf2.cli._console import Positional, Threads, progress_bar, require_threads, rows, warn
from geraf2.cli._fields import Arg
from geraf2.cli._prior import Triple
from geraf2.errors import UserError
from geraf2.fields.mesh_distance import cut_by_box, largest_body
from geraf2.geometry.transforms import apply_rigid
from geraf2.io.mesh import TriangleMesh, read_mesh
from geraf2.io.photos import open_photos
from geraf2.io.run_folder import stage_key
from geraf2.pipeline.los import (
    FIELD_NAME,
    MESH_NAME,
    RECORD_NAME,
    VIEWS_NAME,
    LosRecord,
    is_photo_set,
    mesh_field,
    read_photos,
    train_los,
    write_los,
)
from geraf2.pipeline.los_options import PhotoFlags, parse_box
from geraf2.scene import LosPrior


@dataclass(frozen=True, kw_only=True)
class Config:
    """Make the line-of-sight prior: closed mesh and signed distance of the outside of the box."""

    source: Positional[Annotated[str, Arg(metavar="PHOTOS|MESH|XxYxZ")]]
    """Photos with poses (transforms.json, COLMAP, NeuS, Middlebury), a mesh (closed, or a scan with
    holes), or three outer side lengths in metres, as 0.22x0.22x0.22."""
    out: Positional[Annotated[Path, Arg(metavar="OUT")]]
    """Folder for los.ply, los.npz, los.json and pictures; --los OUT then uses it."""
    box_center: Annotated[Triple, Arg(metavar="X Y Z")] = (0.0, 0.0, 0.0)
    """Where the middle of a box of given sides lies [m]."""
    threads: Threads = None
    """Threads to use; all when not given."""
    photos: Annotated[PhotoFlags, Arg(name="")] = field(default_factory=PhotoFlags)
    """How the source is meant; --unit, --to-radar and --bounds are for meshes, too."""


def main(config: Config) -> int:
    """Run the command."""
    num_threads = require_threads(config.threads)
    _require_own(config.out)
    source = Path(config.source)
    box = parse_box(config.source)
    if box is not None and not source.exists():
        _from_box(config, box)
    elif source.is_dir() or (source.exists() and is_photo_set(source)):
        if not is_photo_set(source):
            open_photos(source)  # says what is missing
        _set_threads(num_threads)
        train_los(read_photos(source, config.photos), config.out)
    else:
        _from_mesh(config, source, num_threads)
    _print_outcome(config.out)
    return 0


def _require_own(out: Path) -> None:
    """Refuse a folder that holds something else."""
    if out.exists() and not out.is_dir():
        raise UserError(what="is a file", where=out, expected="a folder for the prior")
    if out.is_dir() and any(out.iterdir()):
        ours = (out / RECORD_NAME).is_file() or any(out.glob("training-*.safetensors"))
        if not ours:
            raise UserError(
                what="holds files but no prior of geraf2",
                where=out,
                hint="choose another output folder",
            )


def _set_threads(num_threads: int | None) -> None:
    if num_threads is not None:
        import torch  # noqa: PLC0415 - takes 2 s, and only photos need it

        torch.set_num_threads(num_threads)


def _from_box(config: Config, box: Triple) -> None:
    if not (np.isfinite(box).all() and min(box) > 0.0):
        raise UserError(what="box sides must be positive lengths in metres", got=config.source)
    prior = LosPrior.from_box(box, config.box_center)
    _write(config, TriangleMesh(vertices=prior.vertices, faces=prior.faces), "box", None)


def _from_mesh(config: Config, source: Path, num_threads: int | None) -> None:
    mesh = read_mesh(source)
    unit_m = config.photos.unit_m()
    rigid, scale = config.photos.transform()
    vertices = mesh.vertices * (scale * (1.0 if unit_m is None else unit_m))
    if rigid is not None:
        vertices = apply_rigid(rigid, vertices)
    _write(config, TriangleMesh(vertices=vertices, faces=mesh.faces), "mesh", num_threads)


def _write(config: Config, mesh: TriangleMesh, kind: str, num_threads: int | None) -> None:
    with progress_bar("distance grid"):
        sdf, closed = mesh_field(mesh, num_threads)
        limits = config.photos.limits()
        changed = not closed or limits is not None
        if changed:
            sdf = largest_body(sdf if limits is None else cut_by_box(sdf, limits))
        if not closed:
            voxel_mm = 1e3 * sdf.grid.spacing_m
            warn(f"{config.source}: the mesh has holes; a grid of {voxel_mm:.2g} mm closed them")
        write_los(
            config.out,
            sdf,
            LosRecord(
                kind=kind,
                source=config.source,
                key=stage_key(vertices=mesh.vertices, faces=mesh.faces, bounds=limits),
            ),
            mesh=None if changed else mesh,
        )


def _print_outcome(out: Path) -> None:
    record = json.loads((out / RECORD_NAME).read_text(encoding="utf-8"))
    size = " x ".join(f"{1e3 * side:.1f}" for side in record["size_m"])
    center = ", ".join(f"{1e3 * value:.1f}" for value in record["center_m"])
    pairs = [
        ("outside", f"{size} mm around ({center}) mm, {record['n_faces']} triangles"),
        *[(name, _number(value)) for name, value in record["numbers"].items()],
        ("mesh", str(out / MESH_NAME)),
        ("distance", str(out / FIELD_NAME)),
    ]
    if (out / VIEWS_NAME).is_file():
        pairs.append(("pictures", str(out / VIEWS_NAME)))
    pairs.append(("next", f"geraf2 reconstruct SCENE RUN --los {out}"))
    rows(pairs)


def _number(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
