"""Named arrays from files, without pickle."""

import lzma
import struct
import zipfile
import zlib
from collections.abc import Iterable
from pathlib import Path
from tokenize import TokenError

import numpy as np

from geraf2._memory import require_memory
from geraf2._types import AnyPath, Array
from geraf2.errors import UserError
from geraf2.io.file_kinds import refuse_other_kind
from geraf2.io.regular import open_regular, require_unpacked

_HEADER = (TypeError, EOFError, SyntaxError, TokenError)
_ARCHIVE = (zlib.error, lzma.LZMAError, struct.error, zipfile.BadZipFile, RuntimeError)
NPY_MAGIC = b"\x93NUMPY"
BROKEN_ARRAY = (OSError, ValueError, *_HEADER, *_ARCHIVE)
"""What NumPy and zipfile raise where the bytes of an array are wrong (RuntimeError: encrypted)."""


def read_npy(path: AnyPath, *, header_only: bool = False) -> Array:
    """Array of an .npy file; UserError where it cannot be read. `header_only` maps its data."""
    source = Path(path)
    refuse_other_kind(source, ("npy",))
    try:
        with open_regular(source) as handle:
            if handle.read(len(NPY_MAGIC)) != NPY_MAGIC:  # numpy.load would ask for pickles
                raise UserError(
                    what="cannot be read as a NumPy array: it is no .npy file", where=source
                )
        if not header_only:
            require_memory(source.stat().st_size, "the array is too large", where=source)
        array: Array = np.load(source, mmap_mode="r" if header_only else None, allow_pickle=False)
    except (*BROKEN_ARRAY, MemoryError) as error:
        reason = " ".join(str(error).split()) or "the file is cut short"
        raise UserError(what=f"cannot be read as a NumPy array: {reason}", where=source) from None
    return array


def read_npz(path: AnyPath, names: Iterable[str]) -> dict[str, Array]:
    """Arrays of an .npz file by name; UserError if the file or one of them cannot be read."""
    source = Path(path)
    wanted = list(names)
    refuse_other_kind(source, ("zip",))
    try:
        # With a handle of our own, numpy leaves none open when the file turns out to be broken.
        with open_regular(source) as handle, np.load(handle, allow_pickle=False) as stored:
            missing = [name for name in wanted if name not in stored]
            if not missing:
                parts = [p for p in stored.zip.infolist() if p.filename[:-4] in wanted]
                for part in parts:
                    require_unpacked(part.file_size, part.compress_size, source)
                n_bytes = 2.0 * sum(part.file_size for part in parts)
                require_memory(n_bytes, "the arrays are too large", where=source)
                return {name: stored[name] for name in wanted}
    except MemoryError as error:
        raise UserError(what=f"the arrays do not fit into memory: {error}", where=source) from error
    except BROKEN_ARRAY as error:
        raise UserError(
            what=f"cannot read the arrays: {error}",
            where=source,
            hint="the file may be missing or cut off",
        ) from error
    raise UserError(
        what=f"the file lacks the array {', '.join(missing)}",
        where=source,
        expected=", ".join(wanted),
    )
