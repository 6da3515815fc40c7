"""Files in object stores: s3://, gs://, az://, file:// and memory:// (of this process), by obstore.

An address is a Path: pathlib writes s3://bucket/scan as s3:/bucket/scan, which is accepted here.
The functions also accept paths on a disk. An object appears whole or not at all. Credentials,
region and endpoint come from the environment alone (AWS_ACCESS_KEY_ID, AWS_ENDPOINT_URL,
GOOGLE_APPLICATION_CREDENTIALS, ...). Requests are repeated for up to three minutes after 503 or no
answer. obstore serves the three clouds with one package; fsspec needs a package for each.
"""

import errno
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any

from geraf2.errors import UserError
from geraf2.io.regular import read_regular

_ADDRESS = re.compile(r"(s3|gs|az|file|memory):/+([^/]*)/?(.*)", re.DOTALL)
_RETRY: Any = {
    "max_retries": 12,
    "retry_timeout": timedelta(minutes=3),
    "backoff": {
        "init_backoff": timedelta(milliseconds=100),
        "max_backoff": timedelta(seconds=15),
        "base": 2,
    },
}


def is_remote(path: Path | str) -> bool:
    """Whether a path is the address of an object store."""
    return _ADDRESS.fullmatch(str(path)) is not None


def absolute_path(path: Path) -> Path:
    """Absolute path in a folder without links, its own name kept; an address stays as it is."""
    if is_remote(path):
        return path
    return path.parent.resolve() / path.name if path.name.strip(".") else path.resolve()


def read_bytes(path: Path, most: int | None = None) -> bytes:
    """Content of a file; OSError where it cannot be had, UserError as of `open_regular`."""
    if not is_remote(path):
        return read_regular(path, most)
    store, key = _address(path)
    with _as_os_errors(path):
        return bytes(store.get(key).bytes())


def write_bytes(path: Path, data: "bytes | memoryview") -> None:
    """Write an object, whole or not at all; OSError."""
    store, key = _address(path)
    with _as_os_errors(path):
        store.put(key, bytes(data) if len(data) == 0 else data)


def is_file(path: Path) -> bool:
    """Whether there is such a file; OSError where the store does not answer."""
    if not is_remote(path):
        return path.is_file()
    store, key = _address(path)
    if not key:
        return False
    try:
        with _as_os_errors(path):
            store.head(key)
    except FileNotFoundError:
        return False
    return True


def exists(path: Path) -> bool:
    """Whether there is a file, or a folder with files."""
    return (is_file(path) or bool(list_files(path, most=1))) if is_remote(path) else path.exists()


def list_files(folder: Path, most: int | None = None) -> dict[str, tuple[int, str]]:
    """Size and version tag of each file below a remote folder, by its path."""
    store, key = _address(folder)
    found: dict[str, tuple[int, str]] = {}
    with _as_os_errors(folder):
        for some in store.list(f"{key}/" if key else None, chunk_size=most or 1000):
            for entry in some:
                name = str(entry["path"])[len(key) + 1 if key else 0 :]
                found[name] = int(entry["size"]), str(entry["e_tag"] or entry["last_modified"])
            if most is not None and len(found) >= most:
                break
    return dict(sorted(found.items()))


def fetch(source: Path, folder: Path) -> None:
    """Copy all files below a remote folder to one on the disk."""
    for name in list_files(source):
        if ".." in PurePosixPath(name).parts or name.startswith("/"):
            raise UserError(what="holds a name that leads out of it", where=source, got=repr(name))
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(read_bytes(source / name))


def push(folder: Path, target: Path) -> None:
    """Copy all files below a folder to a remote one; others that lie there stay."""
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        write_bytes(target / path.relative_to(folder), path.read_bytes())


@contextmanager
def local_copy(path: Path) -> Iterator[Path]:
    """Lend a file as one on the disk, with its sidecar, if there is one (`<name>.json`)."""
    if not is_remote(path):
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="geraf2-") as name:
        for one in (path, path.with_name(path.name + ".json")):
            if one == path or is_file(one):
                (Path(name) / one.name).write_bytes(read_bytes(one))
        yield Path(name) / path.name


@contextmanager
def local_folder(path: Path) -> Iterator[Path]:
    """Lend a folder to work in: itself, or a copy on the disk that is sent when the body ends."""
    if not is_remote(path):
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="geraf2-", ignore_cleanup_errors=True) as name:
        folder = Path(name) / path.name
        folder.mkdir()
        fetch(path, folder)
        yield folder
        push(folder, path)


def zarr_store(path: Path) -> tuple[Any, str]:
    """Store from which zarr reads a group, and the group's path in it."""
    if not is_remote(path):
        return str(path), ""
    from zarr.storage import ObjectStore  # noqa: PLC0415 - as in geraf2.io.container

    store, key = _address(path)
    return ObjectStore(store, read_only=True), key


def _address(path: Path) -> tuple[Any, str]:
    """Store of a bucket, and the key of a path in it."""
    match = _ADDRESS.fullmatch(str(path))
    assert match is not None
    scheme, bucket, key = match.groups()
    if {".", ".."} & {bucket, *key.split("/")}:
        raise UserError(what="an address goes down only, without '.' and '..'", where=_url(path))
    if scheme == "file":
        return _store("file:///"), f"{bucket}/{key}".strip("/")
    return _store(f"{scheme}://{bucket}"), key.strip("/")


def _url(path: Path) -> str:
    scheme, _, rest = str(path).partition(":")
    return f"{scheme}:{'///' if scheme == 'file' else '//'}{rest.lstrip('/')}"


@cache
def _store(url: str) -> Any:
    """Store of an address; one object for each, as one in memory is gone with it."""
    try:
        from obstore.store import MemoryStore, from_url  # noqa: PLC0415 - an extra
    except ImportError:
        raise UserError(
            what="object stores need the package obstore",
            where=url,
            hint="pip install 'geraf2[cluster]'",
        ) from None
    if "@" in url:
        raise UserError(
            what="credentials come from the environment, not from the address",
            where=url.partition("@")[2],
        )
    if url.startswith("memory://"):
        return MemoryStore()
    options: Any = {} if url.startswith("file:") else {"retry_config": _RETRY}
    if os.environ.get("AWS_ENDPOINT_URL", "").startswith("http://"):
        options["client_options"] = {"allow_http": True}  # of this machine, or of tests
    try:
        return from_url(url, **options)
    except Exception as error:  # obstore raises one of a dozen types
        line = " ".join(str(error).split())
        raise UserError(
            what=f"no object store answers to this address: {line}", where=url
        ) from None


@contextmanager
def _as_os_errors(path: Path) -> Iterator[None]:
    from obstore import exceptions as raised  # noqa: PLC0415 - an extra

    try:
        yield
    except (FileNotFoundError, raised.NotFoundError):
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), _url(path)) from None
    except (raised.PermissionDeniedError, raised.UnauthenticatedError) as error:
        raise PermissionError(errno.EACCES, _first_line(error), _url(path)) from None
    except raised.BaseError as error:
        raise OSError(errno.EIO, _first_line(error), _url(path)) from None


def _first_line(error: BaseException) -> str:
    lines = str(error).strip().splitlines() or [type(error).__name__]
    return lines[0][:200]
