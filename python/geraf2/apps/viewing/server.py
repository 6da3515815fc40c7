"""Server of the interactive view, based on viser."""

import os
import socket
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from http import HTTPStatus
from io import StringIO
from pathlib import Path
from threading import Lock
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from geraf2.apps.viewing.layers import Layer, Source, source_of
from geraf2.errors import UserError

_APART = 1.3
"""Distance between two sources, in units of their size."""
_OFF = "off"
_LOOPBACK = ("localhost", "127.0.0.1", "::1")
_POINT_M, _LINE_M = 0.0012, 0.0006


class LiveView:
    """A server that shows up to two runs or scenes until it is stopped.

    paths: run folders or scenes. port: of the page. host: addresses that may connect; this machine
    alone by default.

    Raises UserError where viser is not installed, the port is in use, or there is nothing to show.
    """

    def __init__(
        self, paths: Sequence[Path | str], *, port: int = 8080, host: str = "127.0.0.1"
    ) -> None:
        viser = _viser()
        sources = [source_of(path) for path in paths]
        require_free(host, port)
        with redirect_stdout(StringIO()), _same_origin_only(host):  # hides its banner
            self._server: Any = viser.ViserServer(host=host, port=port, verbose=False)
        self.host, self.port = host, int(self._server.get_port())
        self._drawing = Lock()
        self.layers: dict[str, Any] = {}
        """Handles of the layers and current slices, by name."""
        self.controls: dict[str, Any] = {}
        """Handles of the controls, by name."""
        self._server.scene.set_up_direction("+z")
        size = max(source.size_m for source in sources)
        for number, source in enumerate(sources):
            placed = source.shifted(np.array([_APART * size * number, 0.0, 0.0]))
            self._add(f"{number + 1} {source.name}" if len(sources) > 1 else source.name, placed)
        middle = 0.5 * _APART * size * (len(sources) - 1)
        self._server.initial_camera.look_at = (middle, 0.0, 0.0)
        reach = 0.9 * size * len(sources)
        self._server.initial_camera.position = (middle + reach, -reach, 0.7 * reach)

    @property
    def url(self) -> str:
        """Address of the page on this machine."""
        return f"http://{'localhost' if self.host == '127.0.0.1' else self.host}:{self.port}"

    @property
    def ssh_line(self) -> str:
        """Command that forwards the page to another machine."""
        connection = os.environ.get("SSH_CONNECTION", "").split()
        address = connection[2] if len(connection) == 4 else socket.gethostname()
        user = os.environ.get("USER") or os.environ.get("LOGNAME")
        target = f"{user}@{address}" if user else address
        return f"ssh -N -L {self.port}:localhost:{self.port} {target}"

    def stop(self) -> None:
        """End the server."""
        with redirect_stdout(StringIO()):
            self._server.stop()

    def _add(self, name: str, source: Source) -> None:
        """Add the layers of a source with a switch each, its planes and its slices."""
        with self._server.gui.add_folder(name):
            for layer in source.layers:
                key = f"/{name}/{layer.name}"
                self.layers[key] = self._draw(key, layer)
                self._switch(key, layer)
            if source.planes:
                self._add_planes(name, source)
            if source.volumes:
                self._add_slices(name, source)

    def _switch(self, key: str, layer: Layer) -> None:
        box = self._server.gui.add_checkbox(layer.name, layer.visible)
        handle = self.layers[key]

        def show(_: Any) -> None:
            handle.visible = box.value

        box.on_update(show)
        self.controls[key] = box

    def _add_planes(self, name: str, source: Source) -> None:
        """Add a slider for one plane at a time; 0 shows all, -1 none."""
        keys = [f"/{name}/planes/{plane.name}" for plane in source.planes]
        for key, plane in zip(keys, source.planes, strict=True):
            self.layers[key] = self._draw(key, plane, visible=False)
        hint = "-1: none, 0: all, else this one"
        slider = self._server.gui.add_slider("plane", -1, len(keys), 1, -1, hint=hint)

        def show(_: Any) -> None:
            for number, key in enumerate(keys, 1):
                self.layers[key].visible = slider.value in (0, number)

        slider.on_update(show)
        self.controls[f"/{name}/planes"] = slider

    def _add_slices(self, name: str, source: Source) -> None:
        """Add controls of a slice: volume, axis, position."""
        gui, volumes = self._server.gui, {volume.name: volume for volume in source.volumes}
        which = gui.add_dropdown("slice through", list(volumes))
        axis = gui.add_dropdown("across", [_OFF, "x", "y", "z"])
        position = gui.add_slider("at", 0.0, 1.0, 0.005, 0.5, hint="share of the extent")
        key = f"/{name}/slice"

        def draw(_: Any) -> None:
            with self._drawing:  # callbacks run in separate threads
                if axis.value == _OFF:
                    if key in self.layers:
                        self.layers.pop(key).remove()
                    return
                volume, across = volumes[which.value], "xyz".index(axis.value)
                index = round(position.value * (volume.grid.shape[across] - 1))
                self.layers[key] = self._draw(key, volume.slice(across, index))

        for handle in (which, axis, position):
            handle.on_update(draw)
        self.controls |= {f"{key} through": which, f"{key} across": axis, f"{key} at": position}

    def _draw(self, key: str, layer: Layer, *, visible: bool | None = None) -> Any:
        scene, shown = self._server.scene, layer.visible if visible is None else visible
        points = layer.points.astype(np.float32)
        if layer.kind == "points":
            colours = layer.colour if layer.colours is None else layer.colours
            return scene.add_point_cloud(key, points, colours, point_size=_POINT_M, visible=shown)
        if layer.kind == "lines":
            ends = points.reshape(-1, 2, 3)
            return scene.add_line_segments(
                key, ends, layer.colour, thickness=_LINE_M, visible=shown
            )
        if layer.colours is None:
            return scene.add_mesh_simple(
                key,
                points,
                layer.faces,
                color=layer.colour,
                opacity=layer.opacity if layer.opacity < 1.0 else None,
                side="double",
                visible=shown,
            )
        import trimesh  # noqa: PLC0415 - takes 0.3 s

        alpha = np.full((len(points), 1), 255, dtype=np.uint8)
        mesh = trimesh.Trimesh(
            points, layer.faces, vertex_colors=np.hstack([layer.colours, alpha]), process=False
        )
        return scene.add_mesh_trimesh(key, mesh, visible=shown)


def require_free(host: str, port: int) -> None:
    """Raise UserError for a used port; viser would silently choose the next one."""
    if not host.strip():
        raise UserError(
            what="--host is empty, which is every address of this machine",
            hint="name 0.0.0.0 if other machines may connect",
        )
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise UserError(
                what=f"the port {port} cannot be used: {error.strerror}",
                where=host,
                hint=f"choose another one, as --port {port + 1}",
            ) from None


@contextmanager
def _same_origin_only(host: str) -> Iterator[None]:
    """Make servers that refuse pages of other sites, which viser lets open its socket.

    A page sends its own address as `Origin`. On a server of this machine alone `Host` must be a
    name of this machine, too: a site may give its own name this machine's address.
    """
    from websockets.asyncio import server  # noqa: PLC0415 - comes with viser

    serve = server.serve

    def guarded(*arguments: Any, process_request: Any = None, **options: Any) -> Any:
        def check(connection: Any, request: Any) -> Any:
            if not is_same_origin(request.headers, host):
                return connection.respond(HTTPStatus.FORBIDDEN, "a page of another site\n")
            return process_request and process_request(connection, request)

        return serve(*arguments, process_request=check, **options)

    server.serve = guarded  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]


def is_same_origin(headers: Mapping[str, str], host: str) -> bool:
    """Whether a request comes from the server's own page, or from no page.

    host: address on which the server listens.
    """
    asked, origin = headers.get("Host", ""), headers.get("Origin")
    if host in _LOOPBACK and urlsplit(f"//{asked}").hostname not in _LOOPBACK:
        return False
    return origin is None or urlsplit(origin).netloc == asked


def _viser() -> Any:
    try:
        import viser  # noqa: PLC0415 - an extra
    except ImportError:
        raise UserError(
            what="geraf2 view needs viser", hint="pip install 'geraf2[view]', or open report.html"
        ) from None
    return viser
