"""Photo sets with known camera poses, one file a format; plain arrays."""

from pathlib import Path

from geraf2.errors import UserError
from geraf2.io.photos.middlebury import find_middlebury, read_middlebury
from geraf2.io.photos.records import PhotoRecord, PhotoSource
from geraf2.io.photos.transforms import find_transforms, read_transforms

__all__ = ["PhotoRecord", "PhotoSource", "open_photos"]

_READERS = (
    (find_transforms, read_transforms),
    (find_middlebury, read_middlebury),
)


def open_photos(source: Path) -> PhotoSource:
    """Read names, cameras and poses of a photo set; the images are read later.

    Parameters
    ----------
    source
        Folder with the photos and the file of their poses, or that file. Which format it is
        is found out from the names of the files.
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
        expected="transforms.json or NAME_par.txt (Middlebury)",
        hint="photos alone are not enough: run COLMAP on them first",
    )
