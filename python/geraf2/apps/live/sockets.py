"""Planes that a program on this machine sends over a socket."""

import socket
import stat
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit

from geraf2.apps.live.sources import NewPlane, Source
from geraf2.errors import UserError
from geraf2.io.manifest import SceneManifest
from geraf2.io.plane_stream import FrameReader
from geraf2.records import Pose
from geraf2.scene.store import capture_without_poses

_LOCAL = ("localhost", "127.0.0.1")
_BYTES = 1 << 20
_FORMS = "tcp://localhost:PORT or unix:PATH"


def is_address(source: str) -> bool:
    """Whether a source is named as a socket, not as a file."""
    return source.startswith(("tcp:", "unix:"))


def open_socket(address: str) -> socket.socket:
    """Socket that listens at an address of this machine; UserError where it cannot."""
    try:
        if address.startswith("unix:"):
            return _open_unix_socket(Path(address.removeprefix("unix:")))
        parts = urlsplit(address)
        if parts.hostname not in _LOCAL or not parts.port:
            raise ValueError
        found = socket.socket()
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        return _listen(found, ("127.0.0.1", parts.port))
    except ValueError:  # also for a port out of range
        raise UserError(
            what="is no socket of this machine", where=address, expected=_FORMS
        ) from None
    except OSError as error:
        reason = error.strerror or str(error)
        raise UserError(what=f"cannot be listened at: {reason}", where=address) from None


def _open_unix_socket(path: Path) -> socket.socket:
    """Socket file that its owner alone may use; one that nobody listens at is replaced."""
    if path.exists() and stat.S_ISSOCK(path.lstat().st_mode):
        with socket.socket(socket.AF_UNIX) as probe, suppress(ConnectionRefusedError):
            probe.connect(str(path))
            raise UserError(what="is in use", where=path, hint="choose another path")
        path.unlink()
    found = _listen(socket.socket(socket.AF_UNIX), str(path))
    path.chmod(0o600)
    return found


def _listen(found: socket.socket, address: str | tuple[str, int]) -> socket.socket:
    try:
        found.bind(address)
    except OSError:
        found.close()
        raise
    found.listen(1)
    found.setblocking(False)
    return found


class SocketSource(Source):
    """Planes of one program after the other, in the frames of `geraf2.io.plane_stream`."""

    def __init__(self, address: str) -> None:
        super().__init__()
        self._address, self._server = address, open_socket(address)
        self._peer: socket.socket | None = None
        self._reader = FrameReader(address)
        self._n_planes, self._has_ended = 0, False

    @property
    def ending(self) -> str:
        """Whether the end was sent."""
        return "the end of the scan was sent" if self._has_ended else ""

    def close(self) -> None:
        """Free the address."""
        if self._peer is not None:
            self._peer.close()
        self._server.close()
        if self._address.startswith("unix:"):
            Path(self._address.removeprefix("unix:")).unlink(missing_ok=True)

    def poll(self, *, is_last: bool = False) -> Iterator[NewPlane]:
        """Planes that came whole; what cannot be read ends the connection, and another may come."""
        del is_last  # what is half sent never counts
        while (data := self._receive()) is not None:
            try:
                if not data and self._reader.is_within:
                    raise UserError(what="ended within a plane", where=self._address)
                for item in self._reader.feed(data):
                    yield from self._read_item(item)
            except UserError as error:
                yield NewPlane(name=str(self._n_planes), problem=str(error))
                data = b""
            if not data:
                self._let_go()

    def _receive(self) -> bytes | None:
        """Bytes that came, none at the end of a connection; None: nothing came."""
        try:
            if self._peer is None:
                self._peer, _ = self._server.accept()
                self._peer.setblocking(False)
            data = self._peer.recv(_BYTES)
        except BlockingIOError:
            return None
        except OSError:  # reset by the other side
            data = b""
        self.last_s = time.monotonic()
        return data

    def _let_go(self) -> None:
        if self._peer is not None:
            self._peer.close()
        self._peer, self._reader = None, FrameReader(self._address)

    def _read_item(self, item: SceneManifest | Pose | None) -> Iterator[NewPlane]:
        if item is None:
            self._has_ended = True
        elif isinstance(item, SceneManifest):
            if self.about is not None and item.waveform != self.about.waveform:
                raise UserError(what="a scan is of another radar", where=self._address)
            self.about = self.about or capture_without_poses(item)
        elif self.about is None:
            raise UserError(what="a plane came before its scan", where=self._address)
        else:
            self._n_planes += 1
            yield NewPlane(name=str(self._n_planes - 1), pose=item)
