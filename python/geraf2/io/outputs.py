"""One rule for every folder, and one for every file, that a user names as output.

A foreign folder is never touched. A finished result is replaced by another only with
`--overwrite`; the same again changes nothing. Looked at before the work, not after it.
"""

from fnmatch import fnmatchcase
from pathlib import Path
from tempfile import TemporaryDirectory

from geraf2.errors import UserError
from geraf2.io.objects import exists, is_remote
from geraf2.io.regular import require_no_links

PROBE_PREFIX = ".geraf2-"
"""Prefix of a temporary folder that tests whether one can be made."""
PICTURES = (".png", ".pdf", ".svg", ".jpg")
"""Endings of pictures that are drawn."""
# What other processes may have there for a while: probes, and files that are being written.
_PASSING = (f"{PROBE_PREFIX}*", ".*-????????.tmp*")


def require_folder(path: Path, kind: str, *, own: bool) -> None:
    """Refuse a path where no folder of this kind can be made; nothing in it changes.

    kind: what is made there, as "scene". own: whether what lies there is one. UserError for a file,
    for a folder with other files or with links, and where nothing can be written.
    """
    if is_remote(path):
        if not own and exists(path):
            raise UserError(
                what=f"holds files but no {kind} of geraf2", where=path, hint="choose another"
            )
        return
    if path.exists() and not path.is_dir():
        raise UserError(what="is a file", where=path, expected=f"a folder for the {kind}")
    left = path.iterdir() if path.is_dir() and not own else ()
    if any(not any(fnmatchcase(one.name, known) for known in _PASSING) for one in left):
        raise UserError(
            what=f"holds files but no {kind} of geraf2", where=path, hint="choose another folder"
        )
    if path.is_dir():
        require_no_links(path)
    # A scene is replaced as a whole, in the folder above; into the others files are written.
    folders = path.absolute().parents if kind == "scene" else (path, *path.absolute().parents)
    nearest = next(folder for folder in folders if folder.exists())
    # Permissions are not enough: a file system may be read-only or full, a user all-powerful.
    try:
        with TemporaryDirectory(prefix=PROBE_PREFIX, dir=nearest):
            pass
    except OSError as error:
        what = f"cannot be written to: {error.strerror}"
        raise UserError(what=what, where=nearest, hint="choose another folder") from None


def require_file(path: Path, kinds: tuple[str, ...]) -> None:
    """Refuse a path where no file with one of these endings can be made."""
    if path.suffix.lower() not in kinds:
        raise UserError(
            what="unknown kind of file",
            where=path,
            expected=f"a name ending in {' or '.join(kinds)}",
        )
    if path.is_dir():
        raise UserError(what="is a folder", where=path, expected="a file")
    if not is_remote(path) and not path.absolute().parent.is_dir():
        raise UserError(
            what="the folder of the file does not exist", where=path, hint="make the folder first"
        )


def require_consent(path: Path, what: str, *, overwrite: bool, got: str | None = None) -> None:
    """Refuse to replace a finished result, which `what` names, without `--overwrite`."""
    if not overwrite:
        hint = "choose another folder, or pass --overwrite to replace it"
        raise UserError(what=f"holds {what}", where=path, got=got, hint=hint)
