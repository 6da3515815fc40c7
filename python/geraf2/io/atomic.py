"""Files and folders that appear whole or not at all.

Everything is written under a temporary name beside its target, flushed to the disk, and renamed.
A full disk or Ctrl-C leaves the former content, and nothing half-written under the real name.
A writer holds a lock on its temporary file. The system releases the lock of a killed process, and
the next writer to the same target removes the temporary file.
"""

import ctypes
import fcntl
import glob
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from geraf2._types import AnyPath, Array
from geraf2.errors import UserError
from geraf2.io.objects import is_remote, write_bytes

_EXCHANGE = 2
"""RENAME_EXCHANGE of renameat2(2)."""
_AT_CWD = -100
_written = 0


def n_written() -> int:
    """Return the number of files and folders that this process has renamed, or is about to."""
    return _written


@contextmanager
def atomic_path(path: AnyPath) -> Iterator[Path]:
    """Temporary sibling of `path`, renamed to it on success and removed on failure.

    It keeps the extension, by which writers choose their format. Missing parent folders are
    created. Failures of the file system are raised as UserError with the reason.
    """
    target = Path(path)
    temporary, descriptor = _temporary(target, target.stem, f".tmp{target.suffix}", folder=False)
    try:
        yield temporary
        _flush(temporary)
        # mkstemp makes files that only the owner may read; a result should obey the umask.
        temporary.chmod(0o666 & ~_umask())
        _count()
        temporary.replace(target)
    except OSError as error:
        raise _cannot_write(target, error) from error
    finally:
        temporary.unlink(missing_ok=True)
        os.close(descriptor)


def write_bytes_atomic(path: AnyPath, data: bytes | memoryview) -> None:
    """Write `data` to `path` whole or not at all; the path may be that of an object store."""
    if is_remote(Path(path)):
        _count()
        try:
            write_bytes(Path(path), data)
        except OSError as error:
            raise _cannot_write(Path(path), error) from error
        return
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def write_text_atomic(path: AnyPath, text: str) -> None:
    """Write UTF-8 `text` to `path` whole or not at all."""
    write_bytes_atomic(path, text.encode())


def write_json_atomic(path: AnyPath, value: Mapping[str, Any]) -> None:
    """Write a JSON object, indented, keys in the order given; NaN is a ValueError."""
    write_text_atomic(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


def write_npz_atomic(path: AnyPath, arrays: Mapping[str, Array]) -> None:
    """Write named arrays, uncompressed; reading them back needs no pickle."""
    for name, array in arrays.items():
        if np.asarray(array).dtype.hasobject:
            msg = f"array {name!r} has dtype object, which only pickle could write"
            raise TypeError(msg)
    with atomic_path(path) as temporary, temporary.open("wb") as handle:
        # A handle, not the name: savez would append .npz to a name without it.
        np.savez(handle, **arrays)  # type: ignore[arg-type]


@contextmanager
def atomic_folder(path: AnyPath) -> Iterator[Path]:
    """Temporary sibling folder of `path` that takes its place at the end.

    On failure the temporary folder is removed and `path` is as it was.
    """
    target = Path(path)
    with temporary_sibling(target) as temporary:
        try:
            yield temporary
        except OSError as error:
            raise _cannot_write(target, error) from error
        take_place(temporary, target)


@contextmanager
def temporary_sibling(target: Path) -> Iterator[Path]:
    """Temporary folder beside `target`, removed at the end, and so are parents made for it."""
    made = [folder for folder in target.parents if not folder.exists()]
    try:
        temporary, descriptor = _temporary(target, target.name, ".tmp", folder=True)
        try:
            yield temporary
        finally:
            shutil.rmtree(temporary, ignore_errors=True)  # by now it may be what was there before
            os.close(descriptor)
    finally:
        with suppress(OSError):  # one that is not empty stays
            for folder in made:
                folder.rmdir()


def take_place(new: Path, target: Path) -> None:
    """Put a folder in the place of `target`; what was there has the name of `new` afterwards."""
    try:
        new.chmod(0o777 & ~_umask())
        _count()
        _take_position(new, target)
    except OSError as error:
        raise _cannot_write(target, error) from error


def sweep_folder(folder: Path) -> None:
    """Remove what killed processes were writing anywhere in a folder."""
    _sweep(folder, "**/.*-????????.tmp*")


def _take_position(new: Path, target: Path) -> None:
    """Exchange two folders, or rename the new one where that is not possible."""
    if not target.exists():
        new.replace(target)
        return
    libc = ctypes.CDLL(None, use_errno=True)
    if hasattr(libc, "renameat2"):  # in one step, so that even a kill leaves one of the two there
        names = os.fsencode(new), os.fsencode(target)
        if libc.renameat2(_AT_CWD, names[0], _AT_CWD, names[1], _EXCHANGE) == 0:
            return
    aside = Path(tempfile.mkdtemp(prefix=f".{target.name}-", suffix=".old", dir=target.parent))
    target.replace(aside)  # an empty folder may be replaced by another one
    try:
        new.replace(target)
    except BaseException:
        with suppress(OSError):
            aside.replace(target)
        raise
    shutil.rmtree(aside, ignore_errors=True)


def _count() -> None:
    global _written  # noqa: PLW0603 - of the process, as what it left is
    _written += 1


def _temporary(target: Path, stem: str, suffix: str, *, folder: bool) -> tuple[Path, int]:
    """Make a locked temporary sibling of `target`; its path, and a descriptor that has the lock."""
    prefix = f".{stem}-"
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        _sweep(target.parent, f"{glob.escape(prefix)}????????{glob.escape(suffix)}")
        while True:
            if folder:
                name = tempfile.mkdtemp(prefix=prefix, suffix=suffix, dir=target.parent)
                descriptor = os.open(name, os.O_RDONLY)
            else:
                descriptor, name = tempfile.mkstemp(prefix=prefix, suffix=suffix, dir=target.parent)
            with suppress(OSError):  # a network folder without locks: nothing is swept there
                fcntl.flock(descriptor, fcntl.LOCK_EX)
            if Path(name).exists():  # or another process swept it before it was locked
                return Path(name), descriptor
            os.close(descriptor)
    except OSError as error:
        raise _cannot_write(target, error) from error


def _sweep(folder: Path, pattern: str) -> None:
    """Remove temporary files and folders that no process has locked."""
    for path in folder.glob(pattern):
        descriptor = None
        with suppress(OSError):  # gone meanwhile, locked, or no file of ours
            descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink()
        if descriptor is not None:
            os.close(descriptor)


def _flush(path: Path) -> None:
    """Wait until the bytes are on the disk, so that a full disk is known before the rename."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _umask() -> int:
    # The process's umask can only be read by setting it.
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def _cannot_write(target: Path, error: OSError) -> UserError:
    reason = error.strerror or type(error).__name__
    return UserError(
        f"cannot write the file: {reason}",
        where=target,
        hint="check the folder's permissions and the free disk space",
    )
