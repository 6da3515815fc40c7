"""Arrays of numbers in MATLAB files: version 4 to 7.2 by SciPy, version 7.3 (HDF5) by h5py.

HDF5 of other programs is read as well; its axes stand as they are, while MATLAB reverses them.

Shapes are known before any data are read. Nothing but numbers is used: no object, cell or function
of the file, and no link to another one.
"""

import math
import re
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from geraf2._memory import require_memory
from geraf2._types import Array, Floats
from geraf2.errors import UserError
from geraf2.io.file_kinds import refuse_other_kind
from geraf2.io.regular import open_regular, require_unpacked

_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
_HDF5_OFFSETS = (0, 512)
_KIND_NAMES = {"c": "complex", "f": "real", "i": "real", "u": "real"}
# Letters of a list of what a file holds.
_LONGEST_LIST = 250
# Version 5, from "MAT-File Format", The MathWorks: types of elements, and classes of arrays.
_HEADER_BYTES = 128
_MATRIX, _COMPRESSED = 14, 15
_NUMBERS, _TEXTS = {1, 2, 3, 4, 5, 6, 7, 9, 12, 13}, {1, 2, 4, 16, 17, 18}
_TEXT, _SPARSE, _FUNCTION, _IS_COMPLEX = 4, 5, 16, 0x800
_N_PARTS = {_TEXT: 1, _SPARSE: 3, **dict.fromkeys(range(6, 16), 1)}
# Arrays within cells and structs; SciPy calls itself for each.
_DEEPEST = 20


@dataclass(frozen=True, kw_only=True)
class MatArray:
    """One array, in the order of MATLAB; parts along the first axes are read on demand."""

    shape: tuple[int, ...]
    kind: str
    """Letter of NumPy's kind, "c" of complex numbers, "O" of what are no numbers."""
    read: Callable[[tuple[Any, ...]], Array]

    def numbers(self) -> Floats:
        """Whole array of real numbers."""
        require_memory(16.0 * math.prod(self.shape), "save fewer antennas in a file")
        return np.asarray(self.read((slice(None),) * len(self.shape)), dtype=np.float64)


def open_arrays(path: Path, names: Mapping[str, str]) -> tuple[dict[str, MatArray], str]:
    """Find arrays in a MATLAB file.

    path: the file.
    names: the names in the file by our names; a name is that of an array, of a field as
        `struct.field`, or of a field alone where only one struct has it.

    Returns the arrays that are there by our names, and a list of all that the file holds.
    UserError for a file that cannot be read.
    """
    if not path.is_file():
        raise UserError(what="no such file", where=path)
    refuse_other_kind(path, ("mat", "hdf5"))
    with open_regular(path) as handle:
        head = handle.read(max(_HDF5_OFFSETS) + len(_HDF5_MAGIC))
    is_hdf5 = any(head[at : at + len(_HDF5_MAGIC)] == _HDF5_MAGIC for at in _HDF5_OFFSETS)
    known, others = (_open_hdf5 if is_hdf5 else _open_by_scipy)(path, names)
    found = {}
    for ours, theirs in names.items():
        fields = [name for name in known if name.endswith(f".{theirs}")]
        if theirs in known:
            found[ours] = known[theirs]
        elif len(fields) == 1:
            found[ours] = known[fields[0]]
    listed = [_line(n, a.shape, _KIND_NAMES.get(a.kind, "other")) for n, a in known.items()]
    text = ", ".join(listed + others)
    return found, text if len(text) <= _LONGEST_LIST else f"{text[:_LONGEST_LIST]} ..."


def _line(name: str, shape: tuple[int, ...], kind: str) -> str:
    return f"{name} {' x '.join(map(str, shape))} {kind}"


def _open_by_scipy(path: Path, names: Mapping[str, str]) -> tuple[dict[str, MatArray], list[str]]:
    """Arrays of structs and of those that are named; lines that describe all others."""
    from scipy.io import loadmat, whosmat  # noqa: PLC0415 - other formats do without
    from scipy.io.matlab import matfile_version  # noqa: PLC0415

    roots = {name.split(".")[0] for name in names.values()}
    with open_regular(path) as handle:
        try:
            is_version_4 = matfile_version(handle, appendmat=False)[0] == 0
            if not is_version_4:
                _require_sizes(handle, path)
            handle.seek(0)
            listed = whosmat(handle, appendmat=False)
            wanted = [name in roots or kind == "struct" for name, _, kind in listed]
            handle.seek(0)
            file = handle if is_version_4 else _unpack(handle, wanted, path)
            loaded = loadmat(file, appendmat=False)
        except UserError:
            raise
        except Exception as error:  # SciPy raises anything on broken files
            reason = " ".join(str(error).split()) or type(error).__name__
            raise UserError(what=f"cannot be read as a MATLAB file: {reason}", where=path) from None
    known: dict[str, MatArray] = {}
    for name, _, _ in listed:
        _add(known, name, loaded.get(name))
    shown = {name.split(".")[0] for name in known}
    return known, [_line(*entry) for entry in listed if entry[0] not in shown]


def _add(known: dict[str, MatArray], name: str, value: Any) -> None:
    """Add an array of numbers, or those in a struct of one element."""
    if type(value) is not np.ndarray:  # none, or an object or function
        return
    if value.dtype.names and value.size == 1:
        for field in value.dtype.names:
            _add(known, f"{name}.{field}", value[field].item())
    elif value.dtype.kind in "fiuc":
        known[name] = MatArray(
            shape=value.shape, kind=value.dtype.kind, read=lambda index: value[index]
        )


def _require_sizes(handle: BinaryIO, path: Path) -> None:
    """Refuse variables of version 5 that unpack to far more than they are in the file."""
    handle.seek(0)
    order = "<" if handle.read(_HEADER_BYTES).endswith(b"IM") else ">"
    while len(tag := handle.read(8)) == 8:
        kind, n_bytes = struct.unpack(f"{order}II", tag)
        if kind == _COMPRESSED:
            tag = zlib.decompressobj().decompress(handle.read(n_bytes), 8)
            require_unpacked(struct.unpack(f"{order}II", tag)[1], n_bytes, path)
        else:
            handle.seek(n_bytes, 1)


def _unpack(handle: BinaryIO, wanted: list[bool], path: Path) -> BytesIO:
    """File of version 5 with those of the variables that are wanted, unpacked and checked."""
    # SciPy indexes a table by the number type of an element without a check, so that one broken
    # byte may end the process, and it states no size of a struct before it reads it.
    parts = [handle.read(_HEADER_BYTES)]
    order = "<" if parts[0].endswith(b"IM") else ">"
    hint = "save fewer antennas in a file, or without compression ('-v7.3')"
    n_unpacked = 0
    for is_wanted in wanted:
        tag = handle.read(8)
        kind, n_bytes = struct.unpack(f"{order}II", tag)
        if not is_wanted:
            handle.seek(n_bytes, 1)
            continue
        stream = zlib.decompressobj()
        if kind == _COMPRESSED:
            tag = stream.decompress(handle.read(n_bytes), 8)
            kind, n_bytes = struct.unpack(f"{order}II", tag)
        n_unpacked += n_bytes
        require_memory(3.0 * n_unpacked, hint, where=path)
        packed = stream.unconsumed_tail
        data = stream.decompress(packed, n_bytes) if packed else handle.read(n_bytes)
        if kind != _MATRIX or not 0 < n_bytes == len(data):
            raise _broken()
        _require_sound(memoryview(data), order)
        parts += [tag, data]
    return BytesIO(b"".join(parts))


def _require_sound(matrix: memoryview, order: str, depth: int = 0) -> None:
    """Raise ValueError for an array whose elements SciPy would read without a check."""
    elements = list(_elements(matrix, order))
    kinds = [kind for kind, _ in elements]
    if not elements:
        return  # an empty array within another
    if len(elements) < 3 or len(elements[0][1]) != 8 or depth > _DEEPEST:
        raise _broken()
    flags, shape = (struct.unpack(f"{order}{len(c) // 4}i", c) for _, c in elements[:2])
    number, is_complex = flags[0] & 0xFF, bool(flags[0] & _IS_COMPLEX)
    if number in _N_PARTS:
        known = _TEXTS if number == _TEXT else _NUMBERS
        if len(kinds) != 3 + _N_PARTS[number] + is_complex or not known.issuperset(kinds[3:]):
            raise _broken()
    has_shape = number < _FUNCTION and number != _SPARSE
    if has_shape and (min(shape, default=-1) < 0 or math.prod(shape) > len(matrix)):
        raise _broken()
    for kind, content in elements:
        if kind == _MATRIX:
            _require_sound(content, order, depth + 1)


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Types and contents of elements, one after the other."""
    at = 0
    while at < len(data):
        kind, n_bytes = struct.unpack_from(f"{order}II", data, at)
        begin = at + 8
        at = begin + n_bytes + -n_bytes % 8
        if kind >> 16:  # up to four bytes of data in the tag itself
            kind, n_bytes, begin, at = kind & 0xFFFF, kind >> 16, begin - 4, begin
        if begin + n_bytes > len(data) or (begin % 8 and n_bytes > 4):
            raise _broken()
        yield kind, data[begin : begin + n_bytes]


def _broken() -> ValueError:
    return ValueError("an array is damaged or cut short")


def _open_hdf5(path: Path, names: Mapping[str, str]) -> tuple[dict[str, MatArray], list[str]]:
    try:
        import h5py  # noqa: PLC0415 - an extra
    except ImportError:
        raise UserError(
            what="is a MATLAB file of version 7.3, which needs h5py",
            where=path,
            hint="pip install 'geraf2[matlab]', or save it with '-v7'",
        ) from None
    marked, plain = dict[str, Any](), dict[str, Any]()
    foreign = set()

    def add(location: str, data: Any) -> None:
        if not isinstance(data, h5py.Dataset) or location.startswith("#"):
            return
        name = location.replace("/", ".").removesuffix(".value")  # Octave's arrays are groups
        if data.external or data.is_virtual:
            foreign.add(name)
        else:
            octave = data.parent.attrs if name != location.replace("/", ".") else {}
            is_matlab = "MATLAB_class" in data.attrs or "OCTAVE_NEW_FORMAT" in octave
            (marked if is_matlab else plain)[name] = data

    try:
        file = h5py.File(path, "r")
        file.visititems(add)
    except (OSError, RuntimeError, KeyError, TypeError) as error:
        raise UserError(what=f"cannot be read as HDF5: {error}", where=path) from None
    for name in names.values():
        if name in foreign:
            raise UserError(what=f"{name} lies in another file", where=path)
        if name not in marked and name not in plain:
            _require_no_link(file, name, path)
    turned = _are_reversed(
        {ours: plain[name].shape for ours, name in names.items() if name in plain}
    )
    known = {name: _hdf5_array(data, path, is_reversed=True) for name, data in marked.items()}
    known |= {name: _hdf5_array(data, path, is_reversed=turned) for name, data in plain.items()}
    return known, []


def _are_reversed(shapes: Mapping[str, tuple[int, ...]]) -> bool:
    """Whether positions and samples belong together with their axes reversed alone.

    shapes: those of arrays by our names. MATLAB's h5write and Julia reverse axes without a mark.
    """
    signal = shapes.get("signal", shapes.get("signal_real", ()))
    positions = shapes.get("positions", shapes.get("tx_positions", ()))
    as_stored = (*signal[:-1], 3) == positions
    return len(positions) > 1 and not as_stored and (3, *signal[1:]) == positions


def _hdf5_array(data: Any, path: Path, *, is_reversed: bool) -> MatArray:
    """Array of HDF5; MATLAB, Octave and others reverse the axes."""
    parts = {name[:1].lower(): name for name in data.dtype.names or ()}  # real and imag, re and im
    is_complex = parts.keys() == {"r", "i"}
    kind = "c" if is_complex else "O" if parts else data.dtype.kind

    def read(index: tuple[Any, ...]) -> Array:
        n_bytes = data.dtype.itemsize * math.prod(data.shape)
        require_unpacked(n_bytes, data.id.get_storage_size(), path)
        stored = data[(..., *reversed(index))].T if is_reversed else data[index]
        return stored[parts["r"]] + 1j * stored[parts["i"]] if is_complex else np.asarray(stored)

    return MatArray(shape=data.shape[::-1] if is_reversed else data.shape, kind=kind, read=read)


def _require_no_link(file: Any, name: str, path: Path) -> None:
    """Raise UserError where an object of the file is a link, which may open another file."""
    import h5py  # noqa: PLC0415 - an extra

    node = file
    for part in filter(None, re.split(r"[./]", name)):
        if not isinstance(node, h5py.Group) or part not in node.keys():  # noqa: SIM118
            return
        if not isinstance(node.get(part, getlink=True), h5py.HardLink):
            raise UserError(what=f"{name} is a link to another object or file", where=path)
        node = node[part]
