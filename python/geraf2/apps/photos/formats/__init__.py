"""Photo sets with known camera poses, one file a format; plain arrays."""

from pathlib import Path

from geraf2.apps.photos.formats.colmap import find_colmap, read_colmap
from geraf2.apps.photos.formats.records import PhotoSource
from geraf2.apps.photos.formats.transforms import find_transforms, read_transforms
from geraf2.errors import UserError
from geraf2.io.photo_files import PhotoRecord

__all__ = ["PhotoRecord", "PhotoSource", "find_photos", "open_photos"]

# The first that finds its file reads the folder: some hold both.
_READERS = ((find_transforms, read_transforms), (find_colmap, read_colmap))


def find_photos(source: Path) -> Path | None:
    """File or folder of the poses in `source`; None where it is no photo set."""
    return next((found for find, _ in _READERS if (found := find(source)) is not None), None)


def open_photos(source: Path) -> PhotoSource:
    """Read names, cameras and poses of a photo set; the images are read later.

    source: folder with the photos and the file of their poses, or that file. The names of the
        files decide the format.
    """
    if not source.exists():
        raise UserError(what="no such photo set", where=source)
    for find, read in _READERS:
        found = find(source)
        if found is not None:
            return read(found)
    raise UserError(
        what="holds no camera poses",
        where=source,
        expected="transforms.json or a COLMAP model (sparse/0)",
        hint="photos alone are not enough: run COLMAP on them first",
    )
