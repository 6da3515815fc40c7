"""Planes as a stream of bytes, as over a socket: bounded frames of numbers.

A frame is `GRF2`, the size of its header (uint32, little endian), and the header, a JSON object:

    {"scan": {...}}                         the contents of scene.toml, first of all
    {"name": "3", "n_antennas": 2961, "n_samples": 32, "angle_deg": 60.0}
    {"end": true}                           no more planes come

After the header of a plane come its arrays, little endian: signal (n_antennas, n_samples) of
complex64, tx_positions and rx_positions (n_antennas, 3) of float64 [m], axes (3, 3) of float64.
"""

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval

from geraf2._bounds import Bounded
from geraf2.errors import UserError
from geraf2.io.manifest import SceneManifest
from geraf2.io.text import parse_json
from geraf2.io.toml import from_table, to_table
from geraf2.records import Pose

MAGIC = b"GRF2"
_START = struct.Struct("<4sI")
_HEADER_BYTES = 1 << 16
PLANE_BYTES = 1 << 30
"""Largest plane [bytes]."""


@dataclass(frozen=True, kw_only=True)
class _PlaneHeader(Bounded):
    name: str = ""
    n_antennas: Annotated[int, Interval(ge=1, le=1 << 24)]
    n_samples: Annotated[int, Interval(ge=1, le=1 << 16)]
    angle_deg: Annotated[float, Interval(ge=-3600.0, le=3600.0)] | None = None

    @property
    def shapes(self) -> dict[str, tuple[tuple[int, int], str]]:
        """Shape and type of each array, in their order."""
        return {
            "signal": ((self.n_antennas, self.n_samples), "<c8"),
            "tx_positions": ((self.n_antennas, 3), "<f8"),
            "rx_positions": ((self.n_antennas, 3), "<f8"),
            "axes": ((3, 3), "<f8"),
        }

    @property
    def n_bytes(self) -> int:
        """Size of the arrays [bytes]."""
        return 8 * (self.n_antennas * (self.n_samples + 6) + 9)


def scan_frame(manifest: SceneManifest) -> bytes:
    """Frame that begins a scan."""
    return _frame({"scan": to_table(manifest)})


def plane_frame(pose: Pose) -> bytes:
    """Frame of a plane."""
    header = _PlaneHeader(
        name=pose.name,
        n_antennas=pose.n_antennas,
        n_samples=pose.signal.shape[1],
        angle_deg=pose.angle_deg,
    )
    arrays = (
        np.asarray(getattr(pose, k), dtype=t).tobytes() for k, (_, t) in header.shapes.items()
    )
    return b"".join([_frame(to_table(header)), *arrays])


def end_frame() -> bytes:
    """Frame that ends a scan."""
    return _frame({"end": True})


def _frame(header: dict[str, Any]) -> bytes:
    text = json.dumps(header).encode()
    return _START.pack(MAGIC, len(text)) + text


class FrameReader:
    """Frames of bytes that come in any portions; at most one frame is kept.

    where: source in errors.

    >>> from geraf2.io.plane_stream import FrameReader, end_frame, plane_frame
    >>> reader = FrameReader("example")
    >>> sent = plane_frame(geraf2.examples.small_capture()[0].poses[0]) + end_frame()
    >>> [type(one).__name__ for half in (sent[:99], sent[99:]) for one in reader.feed(half)]
    ['Pose', 'NoneType']
    """

    def __init__(self, where: object) -> None:
        self._where = where
        self._bytes = bytearray()
        self._plane: _PlaneHeader | None = None

    @property
    def is_within(self) -> bool:
        """Whether a frame has begun and is not whole."""
        return bool(self._bytes) or self._plane is not None

    def feed(self, more: bytes) -> Iterator[SceneManifest | Pose | None]:
        """Yield what is whole: a scan's begin, a plane, or None for its end.

        Raises UserError where a frame is none, or too large: what follows cannot be read.
        """
        self._bytes += more
        while True:
            if self._plane is not None:
                if len(self._bytes) < self._plane.n_bytes:
                    return
                yield self._pose(self._plane)
                continue
            if not MAGIC.startswith(self._bytes[:4]) and not self._bytes.startswith(MAGIC):
                raise self._bad(what="does not begin with GRF2", got=bytes(self._bytes[:4]))
            if len(self._bytes) < _START.size:
                return
            _, size = _START.unpack_from(self._bytes)
            if size > _HEADER_BYTES:
                raise self._bad(what="has a header that is too large", got=f"{size} bytes")
            if len(self._bytes) < _START.size + size:
                return
            header = self._header(bytes(self._bytes[_START.size : _START.size + size]))
            del self._bytes[: _START.size + size]
            if isinstance(header, _PlaneHeader):
                self._plane = header
            else:
                yield header

    def _bad(self, *, what: str, **more: Any) -> UserError:
        return UserError(what=f"a frame {what}", where=self._where, **more)

    def _header(self, text: bytes) -> SceneManifest | _PlaneHeader | None:
        try:
            table = parse_json(text)
        except ValueError as error:
            raise self._bad(what=f"has a header that is no JSON: {error}") from None
        if not isinstance(table, dict):
            raise self._bad(what="has a header that is no object", got=type(table).__name__)
        if table == {"end": True}:
            return None
        if set(table) == {"scan"}:
            return from_table(table["scan"], SceneManifest, self._where)
        header = from_table(table, _PlaneHeader, self._where)
        if header.n_bytes > PLANE_BYTES:
            raise self._bad(
                what="is too large", expected=PLANE_BYTES, got=f"{header.n_bytes} bytes"
            )
        return header

    def _pose(self, header: _PlaneHeader) -> Pose:
        at, arrays = 0, dict[str, Any]()
        for name, (shape, kind) in header.shapes.items():
            found = np.frombuffer(self._bytes, kind, shape[0] * shape[1], at).reshape(shape)
            at += found.nbytes
            arrays[name] = found.astype(found.dtype.newbyteorder("="))
            del found  # or the buffer could not be shortened
        del self._bytes[:at]
        self._plane = None
        return Pose(name=header.name, angle_deg=header.angle_deg, **arrays)
