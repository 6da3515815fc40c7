"""Hashes of files, and whether files are still what they were."""

import hashlib
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from geraf2._types import AnyPath
from geraf2.errors import UserError
from geraf2.io.objects import is_remote, read_bytes
from geraf2.io.regular import open_regular

_MAX_NAMED = 4


def bytes_digest(data: bytes) -> str:
    """Hash of bytes, as :func:`file_digest` has it of a file."""
    return hashlib.blake2b(data, digest_size=16).hexdigest()


def file_digest(path: AnyPath) -> str | None:
    """Hash of a file's bytes; None if there is no such file."""
    path = Path(path)
    try:
        if is_remote(path):
            return bytes_digest(read_bytes(path))
        with open_regular(path) as handle:
            return hashlib.file_digest(handle, lambda: hashlib.blake2b(digest_size=16)).hexdigest()
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
        return None


def require_inside(file: object) -> str:
    """Name of a file in a folder; ValueError for one that leads out of it."""
    parts = PurePosixPath(str(file)).parts
    if not parts or ".." in parts or str(file).startswith("/"):
        msg = f"not a file of the folder: {file!r}"
        raise ValueError(msg)
    return str(file)


def require_digests(folder: Path, digests: Mapping[str, str]) -> None:
    """Raise a UserError that names the files, by their hashes, that are missing or changed."""
    wrong = []
    for name, digest in digests.items():
        try:
            got = file_digest(folder / require_inside(name))
        except (OSError, ValueError) as error:
            wrong.append(f"{name} (cannot be read: {error})")
            continue
        if got != digest:
            wrong.append(f"{name} ({'missing' if got is None else 'changed'})")
    if wrong:
        rest = [f"and {len(wrong) - _MAX_NAMED} more"] if len(wrong) > _MAX_NAMED else []
        raise UserError(
            what=f"{len(wrong)} of {len(digests)} files are not what was written",
            where=folder,
            got=", ".join([*wrong[:_MAX_NAMED], *rest]),
        )
