"""Opener of files that others made: regular files, of a size that their kind may have.

A name may be that of a pipe, which never ends, of a device, or of a file with terabytes of holes. A
link inside a folder of geraf2 may lead anywhere, so such folders hold none.
"""

import errno
import os
import stat
from io import BufferedReader
from pathlib import Path

from geraf2._memory import require_memory
from geraf2._types import AnyPath
from geraf2.errors import UserError

RECORD_BYTES = 64 << 20
"""Limit of TOML and JSON."""
TEXT_BYTES = 512 << 20
"""Limit of tables, logs and configurations."""
BINARY_BYTES = 4 << 30
"""Limit of pictures, meshes and others that are read whole."""
_MAX_TIMES = 100
"""Packed samples of a radar unpack to some times their size, one value to a thousand times."""
_NAMES = {
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFLNK: "a link",
}


def open_regular(path: AnyPath, most: int | None = None) -> BufferedReader:
    """Open a file to read; OSError as of `open`, UserError beyond `most` bytes or for no file."""
    require_regular(path, most)  # to open a device may change it
    handle = open(  # noqa: SIM115 - the caller closes it
        path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)
    )
    try:
        _require_regular(path, os.fstat(handle.fileno()), most)
    except BaseException:
        handle.close()
        raise
    return handle


def require_regular(path: AnyPath, most: int | None = None) -> None:
    """Errors of :func:`open_regular`, for readers that open files by name."""
    _require_regular(path, Path(path).stat(), most)


def read_regular(path: AnyPath, most: int | None = None) -> bytes:
    """Content of a file; arguments and errors as of :func:`open_regular`."""
    with open_regular(path, most) as handle:
        size = os.fstat(handle.fileno()).st_size
        if size > RECORD_BYTES:
            require_memory(size, "the file is too large", where=path)
        return handle.read()


def most_unpacked(n_packed: float) -> float:
    """Bytes that data of this size may unpack to: as many times as samples do, or RECORD_BYTES."""
    return max(RECORD_BYTES, _MAX_TIMES * n_packed)


def require_unpacked(n_bytes: float, n_packed: float, where: object) -> None:
    """Raise UserError, before they are unpacked, for data that unpack to far more than samples do.

    n_bytes, n_packed: unpacked, and as stored.
    """
    if n_bytes <= most_unpacked(n_packed):
        return
    raise UserError(
        what=f"{n_packed / 2**20:.3g} MiB unpack to {n_bytes / 2**30:.3g} GiB",
        where=where,
        expected=f"at most {_MAX_TIMES} times as much",
        hint="if the file is sound, save it without compression",
    )


def require_no_links(folder: Path) -> list[Path]:
    """Files below a folder; UserError for links, pipes, sockets and devices."""
    found, folders = list[Path](), [str(folder)]
    while folders:
        try:
            entries = list(os.scandir(folders.pop()))
        except FileNotFoundError:  # removed meanwhile, by its writer
            continue
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                folders.append(entry.path)
            elif entry.is_file(follow_symlinks=False):
                found.append(Path(entry.path))
            elif os.path.lexists(entry.path):
                kind = _kind(os.lstat(entry.path))
                hint = "put the file or the folder itself there"
                raise UserError(what=f"is {kind}", where=entry.path, hint=hint)
    return found


def _require_regular(path: AnyPath, found: os.stat_result, most: int | None) -> None:
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(found.st_mode):
        raise UserError(what="is no regular file", where=path, got=_kind(found))
    if most is not None and found.st_size > most:
        raise UserError(
            what="the file is too large",
            where=path,
            expected=f"at most {most / 2**20:.0f} MiB",
            got=f"{found.st_size / 2**20:.0f} MiB",
        )


def _kind(found: os.stat_result) -> str:
    return _NAMES.get(stat.S_IFMT(found.st_mode), "no file")
