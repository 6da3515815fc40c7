"""Files and folders that appear whole or not at all.

Everything is written under a temporary name beside its place, flushed to the disk, and renamed.
A full disk or Ctrl-C leaves what was there before, and nothing half-written under the real name.
"""

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


@contextmanager
def atomic_path(path: AnyPath) -> Iterator[Path]:
    """Temporary sibling of `path`, renamed to it on success and removed on failure.

    The sibling lies in the same folder, because a rename is atomic only within one file system,
    and keeps the extension, because writers choose their format by it. Missing parent folders
    are created. Failures of the file system are raised as UserError with the reason.
    """
    target = Path(path)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        descriptor, name = tempfile.mkstemp(
            prefix=f".{target.stem}-", suffix=f".tmp{target.suffix}", dir=target.parent
        )
    except OSError as error:
        raise _cannot_write(target, error) from error
    os.close(descriptor)
    temporary = Path(name)
    try:
        yield temporary
        _flush(temporary)
        # mkstemp makes files that only the owner may read; a result should obey the umask.
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(target)
    except OSError as error:
        raise _cannot_write(target, error) from error
    finally:
        temporary.unlink(missing_ok=True)


def write_bytes_atomic(path: AnyPath, data: bytes) -> None:
    """Write `data` to `path` whole or not at all."""
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

    What stood at `path` is moved aside first and removed last, so that one of the two is always
    there. On failure the temporary folder is removed and `path` is as it was.
    """
    target = Path(path)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(
            tempfile.mkdtemp(prefix=f".{target.name}-", suffix=".tmp", dir=target.parent)
        )
    except OSError as error:
        raise _cannot_write(target, error) from error
    try:
        yield temporary
        temporary.chmod(0o777 & ~_umask())
        _take_place(temporary, target)
    except OSError as error:
        raise _cannot_write(target, error) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _take_place(new: Path, target: Path) -> None:
    if not target.exists():
        new.replace(target)
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
