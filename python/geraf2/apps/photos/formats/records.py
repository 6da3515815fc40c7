"""Common parts of the readers of photo sets: their result, and files in any capitals."""

from dataclasses import dataclass
from pathlib import Path

from geraf2.io.photo_files import PhotoRecord


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotoSource:
    """Photo set with its cameras; images are not yet read."""

    format: str
    """Name of the format."""
    records: tuple[PhotoRecord, ...]
    """One a photo, in the source's order."""
    unit_m: float | None = None
    """Length of the source's unit, where stated [m]."""
    frame: str | None = None
    """Name of the frame of the poses, where stated."""
    notes: tuple[str, ...] = ()
    """Notes for the user."""


def find_path(folder: Path, name: str | Path) -> Path | None:
    """File or folder of this path below a folder, in capitals or not; None where there is none."""
    here = folder
    for part in Path(name).parts:
        there = here / part
        try:
            if not there.exists():
                entries = sorted(here.iterdir()) if here.is_dir() else []
                there = next(e for e in entries if e.name.casefold() == part.casefold())
        except (OSError, StopIteration):  # none, or the name is too long
            return None
        here = there
    return here
