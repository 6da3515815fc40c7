"""Photo sets with known camera poses, one file a format; plain arrays."""

from pathlib import Path

from geraf2.apps.photos.formats.colmap import find_colmap, read_colmap
from geraf2.apps.photos.formats.llff import find_llff, read_llff
from geraf2.apps.photos.formats.middlebury import find_middlebury, read_middlebury
from geraf2.apps.photos.formats.neus import find_neus, read_neus
from geraf2.apps.photos.formats.records import PhotoSource
from geraf2.apps.photos.formats.transforms import find_transforms, read_transforms
from geraf2.errors import UserError
from geraf2.io.photo_files import PhotoRecord

__all__ = ["PhotoRecord", "PhotoSource", "find_photos", "open_photos"]

# The first that finds its file reads the folder: transforms.json lies beside COLMAP models, too,
# and these beside LLFF poses, without the lens.
_READERS = (
    (find_transforms, read_transforms),
    (find_colmap, read_colmap),
    (find_llff, read_llff),
    (find_neus, read_neus),
    (find_middlebury, read_middlebury),
)
_EXPECTED = (
    "transforms.json, a COLMAP model (sparse/0), poses_bounds.npy (LLFF), cameras_sphere.npz "
    "(NeuS) or NAME_par.txt (Middlebury)"
)


def find_photos(source: Path) -> Path | None:
    """File or folder of the poses in `source`; None where it is no photo set."""
    for find, _ in _READERS:
        found = find(source)
        if found is not None:
            return found
    return None


def open_photos(source: Path) -> PhotoSource:
    """Read names, cameras and poses of a photo set; the images are read later.

    source: folder with the photos and the file of their poses, or that file. Which format it is is
        found out from the names of the files.
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
        expected=_EXPECTED,
        hint="photos alone are not enough: run COLMAP on them first",
    )
