"""Common parts of the readers of photo sets: their result, and lists of images."""

from dataclasses import dataclass
from pathlib import Path

from geraf2.errors import UserError
from geraf2.io.photo_files import PhotoRecord

_SUFFIXES = (".png", ".jpg", ".jpeg")


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


def images_in(folder: Path) -> list[Path]:
    """PNG and JPEG files of a folder, sorted by name."""
    return sorted(entry for entry in folder.iterdir() if entry.suffix.lower() in _SUFFIXES)


def listed_images(folder: Path, names: tuple[str, ...]) -> list[Path]:
    """Images of the first of the folder's subfolders `names` that has any; an error if none has."""
    for name in names:
        if (folder / name).is_dir():
            found = images_in(folder / name)
            if found:
                return found
    raise UserError(
        what="no images beside the camera poses",
        where=folder,
        expected="a folder " + " or ".join(names) + " with PNG or JPEG files",
    )
