"""ROS 2 bags without ROS, by the package rosbags."""

import importlib
import os
import sqlite3
import struct
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO
from urllib.parse import quote

from geraf2.errors import UserError
from geraf2.io.regular import most_unpacked, require_unpacked

# Records of an MCAP file begin with kind and size; the last one has 20 bytes, zeros: no summary.
_MAGIC, _RECORD = b"\x89MCAP0\r\n", struct.Struct("<BQ")
_FOOTER, _CHUNK, _DATA_END = _RECORD.pack(2, 20), 6, 15
_MCAP_END = len(_FOOTER) + 20 + len(_MAGIC)
_ZSTD = b"\x28\xb5\x2f\xfd"
_COPIED_BYTES = 1 << 20


def ros_module(name: str) -> Any:
    """Return a module of rosbags, an extra; UserError where it is not installed."""
    try:
        return importlib.import_module(f"rosbags.{name}")
    except ImportError:
        what = "ROS 2 bags and MCAP files need rosbags"
        raise UserError(what=what, hint="pip install 'geraf2[ros]'") from None


def is_bag(path: Path) -> bool:
    """Whether a path has the name of a bag, or is the folder of one."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return path.suffix in (".mcap", ".db3", ".bag") and path.is_file()


def is_finished_bag(path: Path) -> bool:
    """Whether a bag's end was written; of a .db3 without metadata nobody knows."""
    if path.is_dir():
        return is_bag(path)
    if path.suffix != ".mcap" or path.stat().st_size < _MCAP_END:
        return False
    with path.open("rb") as file:
        file.seek(-_MCAP_END, os.SEEK_END)
        end = file.read()
    return end.startswith(_FOOTER) and end.endswith(_MAGIC)


def bag_files(path: Path) -> list[Path]:
    """Files of a bag that grows: of a folder its .mcap or .db3 files."""
    if not path.is_dir():
        return [path]
    return sorted(one for one in path.iterdir() if one.suffix in (".mcap", ".db3"))


@contextmanager
def open_bag(path: Path, *, is_cut: bool = False) -> Iterator[Any]:
    """Reader of a rosbag2 folder, .mcap or .db3; UserError for what cannot be read.

    is_cut: read what is there of a bag whose end is missing, as one that is being recorded.
    """
    highlevel, typesys = ros_module("highlevel"), ros_module("typesys")
    if path.suffix == ".bag":
        raise UserError(
            what="is a ROS 1 bag",
            where=path,
            expected="a rosbag2 folder, .mcap or .db3",
            hint=f"rosbags-convert --src {path.name} --dst {path.stem}",
        )
    # Bags of sqlite3 before ROS 2 Iron carry no definitions.
    store = typesys.get_typestore(typesys.Stores.LATEST)
    try:
        with ExitStack() as stack:
            paths = [path]
            if is_cut and not is_finished_bag(path):
                folder = Path(stack.enter_context(TemporaryDirectory()))
                paths = [_snapshot(one, folder / one.name) for one in bag_files(path)]
            for one in paths:
                _require_sizes(one)
            reader = stack.enter_context(highlevel.AnyReader(paths, default_typestore=store))
            _require_messages(reader, path)
            yield reader
    except UserError:
        raise
    except Exception as error:  # a broken file raises errors of many kinds
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise UserError(
            what=f"cannot be read: {reason}",
            where=path,
            expected="a whole rosbag2 folder, .mcap or .db3",
            hint="'mcap recover' or 'ros2 bag reindex' mends a recording that was cut short",
        ) from None


def _records(file: BinaryIO) -> Iterator[tuple[int, int]]:
    """Kind and size of each record of an MCAP file, which then stands at the record's content."""
    end = file.seek(len(_MAGIC))
    while len(head := file.read(_RECORD.size)) == _RECORD.size:
        kind, size = _RECORD.unpack(head)
        end += _RECORD.size + size
        yield kind, size
        file.seek(end)


def _require_sizes(path: Path) -> None:
    """Refuse a bag whose packed files and chunks unpack to far more than samples do."""
    n_bytes = n_packed = 0
    for one in sorted(path.iterdir()) if path.is_dir() else [path]:
        with one.open("rb") as file:
            if file.read(len(_ZSTD)) == _ZSTD:
                file.seek(0)
                n_bytes += _unpacked("zstd", file, most_unpacked(one.stat().st_size))
                n_packed += one.stat().st_size
            elif one.suffix == ".mcap":
                for kind, size in _records(file):
                    if kind == _CHUNK:
                        n_bytes += _chunk_bytes(file.read(size), path)
                        n_packed += size
    require_unpacked(n_bytes, n_packed, path)


def _chunk_bytes(content: bytes, where: Path) -> int:
    """Bytes that a chunk states to unpack to; UserError where these are more."""
    n_bytes = int.from_bytes(content[16:24], "little")
    begin = 32 + int.from_bytes(content[28:32], "little")  # of the size of its records
    name = content[32:begin].decode("ascii", "replace")
    if name in ("zstd", "lz4") and n_bytes <= most_unpacked(len(content)):
        found = _unpacked(name, BytesIO(content[begin + 8 :]), n_bytes)
        if found > n_bytes:
            what = "a chunk unpacks to more bytes than it states"
            raise UserError(what=what, where=where, expected=n_bytes)
    return n_bytes


def _require_messages(reader: Any, where: Path) -> None:
    """Refuse a bag whose packed messages unpack to far more than samples do."""
    n_bytes = n_packed = 0
    packed = (one for one in reader.readers if one.compression_mode == "message")
    for storage in (storage for one in packed for storage in one.storage.storages):
        for _, _, data in storage.messages(storage.connections):
            n_packed += len(data)
            n_bytes += _unpacked("zstd", BytesIO(data), most_unpacked(len(data)))
    require_unpacked(n_bytes, n_packed, where)


def _unpacked(name: str, file: BinaryIO, most: float) -> int:
    """Bytes that a file unpacks to, counted and not kept, until they are more than `most`."""
    lz4 = importlib.import_module("lz4.frame")  # which rosbags needs
    n_bytes, module = 0, ros_module("rosbag2.reader").zstd if name == "zstd" else lz4
    with module.open(file) as whole:
        while n_bytes <= most and (part := whole.read(_COPIED_BYTES)):
            n_bytes += len(part)
    return n_bytes


def _snapshot(path: Path, target: Path) -> Path:
    """Consistent copy of a file that is being written, with what is whole of it."""
    if path.suffix == ".db3":
        with (
            closing(sqlite3.connect(f"file:{quote(str(path))}?mode=ro", uri=True)) as source,
            closing(sqlite3.connect(target)) as copy,
        ):
            source.backup(copy)
        return target
    with path.open("rb") as source, target.open("wb") as copy:
        n_bytes, end = path.stat().st_size, len(_MAGIC)
        for kind, size in _records(source):
            if kind in (_DATA_END, _FOOTER[0]) or source.tell() + size > n_bytes:
                break
            end = source.tell() + size
        source.seek(0)
        while end > 0 and (data := source.read(min(end, _COPIED_BYTES))):
            end -= copy.write(data)
        copy.write(_FOOTER + bytes(20) + _MAGIC)
    return target
