"""Whether a folder still holds what geraf2 wrote into it."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geraf2.errors import UserError
from geraf2.io.container import LOS_RECORD_NAME, is_scene, verify_scene
from geraf2.io.digests import file_digest, require_digests
from geraf2.io.run_folder import (
    CONTENT_NAME,
    LOCK_NAME,
    LOG_NAME,
    METRICS_NAME,
    PSNR_NAME,
    RUN_NAME,
    VIEWS_FOLDER,
    RunFolder,
)


@dataclass(frozen=True, kw_only=True)
class Verified:
    """A folder in which nothing is missing or changed."""

    kind: str
    """run, prior or scene."""
    n_files: int
    """Files that were compared with the hashes of their bytes; of a scene its planes."""
    notes: tuple[str, ...] = ()
    """What else should be known: what is not finished, or of nobody."""


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
        files = _json(folder / LOS_RECORD_NAME).get("files")
        if not isinstance(files, dict):
            raise UserError(what="cannot be read as the record of a prior", where=folder)
        require_digests(folder, files)
        return Verified(kind="prior", n_files=len(files))
    run = RunFolder.read(folder)
    require_digests(folder, run.digests)
    mesh = file_digest(folder / CONTENT_NAME)
    for name in (METRICS_NAME, f"{VIEWS_FOLDER}/{PSNR_NAME}"):
        if _json(folder / name).get("mesh_digest", mesh) != mesh:
            raise UserError(what=f"is not of the {CONTENT_NAME} beside it", where=folder / name)
    return Verified(kind="run", n_files=len(run.digests), notes=tuple(_notes(run)))


def _notes(run: RunFolder) -> list[str]:
    notes = []
    if not {"mesh", "image"} & set(run.stages):
        done = ", ".join(run.stages) or "nothing"
        notes.append(f"the run is not finished; done: {done}")
    known = {*run.digests, RUN_NAME, LOG_NAME, LOCK_NAME}
    found = (path for path in sorted(run.path.rglob("*")) if path.is_file())
    others = [name for p in found if (name := p.relative_to(run.path).as_posix()) not in known]
    if others:
        more = f" and {len(others) - 4} more" if len(others) > 4 else ""
        notes.append(f"of no finished stage: {', '.join(others[:4])}{more}")
    return notes


def _json(path: Path) -> dict[str, Any]:
    """Object of a file; an empty one where there is none."""
    if not path.is_file():
        return {}
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        values = None
    if not isinstance(values, dict):
        raise UserError(what="cannot be read", where=path, expected="a JSON object")
    return values
