"""Check that a folder is unchanged since geraf2 wrote it."""

from dataclasses import dataclass
from pathlib import Path

from geraf2.errors import UserError
from geraf2.io.container import LOS_RECORD_NAME, is_scene, verify_scene
from geraf2.io.digests import file_digest, require_digests
from geraf2.io.regular import require_no_links
from geraf2.io.run_folder import (
    CONTENT_NAME,
    LOG_NAME,
    METRICS_NAME,
    PSNR_NAME,
    RUN_NAME,
    VIEWS_FOLDER,
    RunFolder,
)
from geraf2.io.text import read_object


@dataclass(frozen=True, kw_only=True)
class Verified:
    """A folder in which nothing is missing or changed."""

    kind: str
    """run, prior or scene."""
    n_files: int
    """Files that were compared with the hashes of their bytes; of a scene its planes."""
    notes: tuple[str, ...] = ()
    """Remarks, for example on files that are not of the run."""


def verify(path: Path | str) -> Verified:
    """Compare the files of a run, a prior or a scene with what was written; nothing is changed.

    path: folder of `geraf2 reconstruct`, `geraf2 image`, `geraf2 los`, or a scene.

    Returns how many files were compared. Raises UserError that names those which are missing or
    changed, scores of another mesh, and a folder that is none of these.
    """
    folder = Path(path)
    if is_scene(folder):
        n_files = verify_scene(folder)
        notes = () if n_files else ("it was written without checksums: nothing to compare with",)
        return Verified(kind="scene", n_files=n_files, notes=notes)
    if (folder / LOS_RECORD_NAME).is_file():
        require_no_links(folder)
        files = read_object(folder / LOS_RECORD_NAME).get("files")
        if not isinstance(files, dict):
            raise UserError(what="cannot be read as the record of a prior", where=folder)
        require_digests(folder, files)
        return Verified(kind="prior", n_files=len(files))
    run = RunFolder.read(folder)
    require_digests(folder, run.files)
    mesh = file_digest(folder / CONTENT_NAME)
    for name in (METRICS_NAME, f"{VIEWS_FOLDER}/{PSNR_NAME}"):
        scores = read_object(folder / name) if (folder / name).is_file() else {}
        if scores.get("mesh_digest", mesh) != mesh:
            raise UserError(what=f"is not of the {CONTENT_NAME} beside it", where=folder / name)
    return Verified(kind="run", n_files=len(run.files), notes=tuple(_notes(run)))


def _notes(run: RunFolder) -> list[str]:
    notes = []
    if not {"mesh", "image"} & run.stages.keys():
        notes.append("the folder holds neither a mesh nor an image")
    known = {*run.files, RUN_NAME, LOG_NAME}
    found = (path for path in sorted(run.path.rglob("*")) if path.is_file())
    others = [name for p in found if (name := p.relative_to(run.path).as_posix()) not in known]
    if others:
        more = f" and {len(others) - 4} more" if len(others) > 4 else ""
        notes.append(f"not of the run: {', '.join(others[:4])}{more}")
    return notes
