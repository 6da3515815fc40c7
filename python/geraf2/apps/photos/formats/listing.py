"""Images of a folder in the order of their names, for formats whose poses carry no names."""

from pathlib import Path

from geraf2.errors import UserError

_SUFFIXES = (".png", ".jpg", ".jpeg")


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
