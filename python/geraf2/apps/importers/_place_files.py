"""Scans with one file for each position: folders of .bin files."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geraf2.apps.importers._raw_stream import bin_files
from geraf2.apps.importers._rows import left_out
from geraf2.apps.importers._stream_parts import ByteStream
from geraf2.errors import UserError

_MAX_NAMED = 4


def place_files(source: Path, names: Sequence[str] | None) -> list[Path]:
    """Files of the positions, in their order.

    source: folder of the files.
    names: file of each position; None: all *.bin, by the numbers in their names.
    """
    if not source.is_dir():
        raise UserError(what="is no folder with one file for each position", where=source)
    if names is None:
        return sorted(bin_files(source), key=_by_numbers)
    bad = [name for name in names if not name or Path(name).name != name or "\\" in name]
    if bad:
        raise UserError(
            what="a file of the positions is not named plainly",
            where=source,
            expected="names of files in this folder",
            got=repr(bad[0]),
        )
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise UserError(what="two positions name the same file", where=source, got=twice[0])
    missing = [name for name in names if not (source / name).is_file()]
    if missing:
        raise UserError(
            what=f"{len(missing)} of {len(names)} files that the positions name are not there",
            where=source,
            got=", ".join(missing[:_MAX_NAMED]),
        )
    return [source / name for name in names]


def _by_numbers(path: Path) -> tuple[tuple[int, int, str], ...]:
    """Sort key in which scan_2 comes before scan_10."""
    parts = re.findall(r"\d+|\D+", path.stem)
    return tuple((0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts)


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaceStream:
    """Concatenation of the first `bytes_per_place` bytes of each file."""

    files: tuple[ByteStream, ...]
    bytes_per_place: int

    @property
    def n_bytes(self) -> int:
        """Bytes of all positions."""
        return len(self.files) * self.bytes_per_place

    def read_into(self, start: int, out: NDArray[np.uint8]) -> None:
        """Fill `out` (n_bytes,) with the bytes from `start` on."""
        at = 0
        while at < len(out):
            place, begin = divmod(start + at, self.bytes_per_place)
            n = min(self.bytes_per_place - begin, len(out) - at)
            self.files[place].read_into(begin, out[at : at + n])
            at += n


def usual_bytes(files: Sequence[ByteStream]) -> int:
    """Most common size of the files [bytes]; the largest of several."""
    counts = Counter(stream.n_bytes for stream in files)
    return max(counts, key=lambda size: (counts[size], size))


def odd_places(
    files: Sequence[ByteStream],
    names: Sequence[str],
    frame_bytes: int,
    *,
    keep_good: bool,
    where: Path,
) -> tuple[tuple[int, ...], list[str]]:
    """Positions whose number of whole frames is not the usual one, and a note; see `left_out`."""
    n_frames = [stream.n_bytes // frame_bytes for stream in files]
    usual = usual_bytes(files) // frame_bytes
    odd = tuple(place for place, n in enumerate(n_frames) if n != usual)
    if not odd:
        return (), []
    named = ", ".join(f"{names[place]} ({n_frames[place]})" for place in odd[:_MAX_NAMED])
    text = f"{len(odd)} of {len(files)} files do not hold {usual} frames as the others do: {named}"
    note = left_out(text, keep_good, where, hint="--keep-good leaves these positions out")
    return odd, [f"{note}; left out"]
