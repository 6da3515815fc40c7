"""`geraf2 export`: surface or glints of a run as one file for other programs."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from geraf2._bounds import Arg
from geraf2.cli._console import keep, rows
from geraf2.cli._fields import Positional
from geraf2.errors import UserError
from geraf2.io.atomic import write_bytes_atomic
from geraf2.io.mesh import WRITABLE_SUFFIXES, Evidence, write_mesh
from geraf2.io.outputs import require_file
from geraf2.pipeline.reconstruction import load_run


@dataclass(frozen=True, kw_only=True)
class Config:
    """Write the surface of a run, or its glints, into one file in metres.

    Example: geraf2 export out seen.ply --only-seen
    """

    run: Positional[Annotated[Path, Arg(metavar="OUT")]]
    """Run folder of `geraf2 reconstruct`."""
    file: Positional[Annotated[Path, Arg(metavar="FILE")]]
    """File to write: .ply, .glb or .stl; .ply of glints."""
    only_seen: bool = False
    """Only triangles whose corners were all seen: an echo came from there."""
    glints: bool = False
    """The glints instead: points with normals, strengths and probabilities."""
    overwrite: bool = False
    """Replace the file."""


def main(config: Config) -> int:
    """Run the command."""
    result = load_run(config.run)
    require_file(config.file, (".ply",) if config.glints else WRITABLE_SUFFIXES)
    if config.file.exists() and not config.overwrite:
        raise UserError(
            what="is there already", where=config.file, hint="pass --overwrite to replace it"
        )
    if config.glints:
        if result.glints is None:
            raise UserError(what="the run has no glints", where=config.run)
        write_bytes_atomic(config.file, result.glints.cloud_bytes())
        found = {"n_points": len(result.glints)}
    else:
        mesh = result.content_mesh
        if config.only_seen:
            if mesh.evidence is None:
                raise UserError(what="the preset of the run does not know what was seen")
            mesh = mesh.with_faces(mesh.faces[(mesh.evidence == Evidence.SEEN)[mesh.faces].all(1)])
        write_mesh(mesh, config.file, made_from={"command": "geraf2 export"})
        found = {"n_vertices": len(mesh.vertices), "n_faces": len(mesh.faces)}
    rows([*((name, str(n)) for name, n in found.items()), ("file", str(config.file))])
    keep(found | {"file": str(config.file)})
    return 0
