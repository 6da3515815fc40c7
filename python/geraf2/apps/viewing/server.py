"""Server of the interactive view of runs and scenes: a page that follows the files."""

import os
import socket
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from geraf2.errors import UserError
from geraf2.io.container import RADAR_NAME, is_scene
from geraf2.io.mesh import TriangleMesh
from geraf2.io.run_folder import CONTENT_NAME, METRICS_NAME, RunFolder
from geraf2.io.verdict import Verdict
from geraf2.report import html
from geraf2.report.run_report import run_scene
from geraf2.report.view3d import (
    NO_WEBGL,
    NOTHING,
    Around,
    Other,
    scene_json,
    view_scene,
)
from geraf2.scene import LosPrior, Pose
from geraf2.scene.aperture import Aperture
from geraf2.scene.store import open_capture

_LOOPBACK = ("localhost", "127.0.0.1", "::1")

# Files whose change an open page shows.
_FOLLOWED = (CONTENT_NAME, METRICS_NAME, RADAR_NAME)

_MAX_ANTENNAS = 24_000
"""Most antennas shown of a scene."""
_ANTENNA_M = 0.0008
_ANTENNA_COLOUR = "#56B4E9"


class LiveView:
    """A server that shows up to two runs or scenes until it is stopped.

    Two are shown side by side, with linked cameras. An open page shows new files within a second.

    paths: run folders or scenes. port: of the page. host: addresses that may connect; this machine
    alone by default. waits: for the surface of a run that is made meanwhile.

    Raises UserError where the port is in use, or there is nothing to show.
    """

    def __init__(
        self,
        paths: Sequence[Path | str],
        *,
        port: int = 8080,
        host: str = "127.0.0.1",
        waits: bool = False,
    ) -> None:
        self._paths, self.host, self._waits = tuple(paths), host, waits
        if not waits:
            page(self._paths)
        require_free(host, port)
        self._server = ThreadingHTTPServer((host, port), self._handler())
        self.port = int(self._server.server_address[1])
        Thread(target=self._server.serve_forever, daemon=True).start()

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
        self._server.shutdown()
        self._server.server_close()

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        paths, host, waits = self._paths, self.host, self._waits

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                headers = {name.title(): value for name, value in self.headers.items()}
                status, text, kind = HTTPStatus.OK, "", "text/plain"
                if not is_same_origin(headers, host):
                    status, text = HTTPStatus.FORBIDDEN, "a page of another site\n"
                elif self.path == "/version":
                    text = version(paths)
                elif self.path != "/":
                    status, text = HTTPStatus.NOT_FOUND, "no such page\n"
                else:
                    try:
                        text = page(paths, needs_surface=waits)
                        kind = "text/html"
                    except (UserError, OSError) as error:  # as one that is being written
                        status, text = HTTPStatus.SERVICE_UNAVAILABLE, f"{error}\n"
                content = text.encode()
                self.send_response(status)
                self.send_header("Content-Type", f"{kind}; charset=utf-8")
                self.send_header("Content-Length", str(len(content)))
                self.send_header("Cache-Control", "no-store")
                if status is HTTPStatus.SERVICE_UNAVAILABLE:
                    self.send_header("Refresh", "1")
                self.end_headers()
                self.wfile.write(content)

            def log_message(self, *_: Any) -> None:
                """Print nothing."""

        return Handler


def version(paths: Sequence[Path | str]) -> str:
    """Text that changes with the surfaces and scores of runs, and with the planes of scenes."""
    return " ".join(_changed(Path(path) / name) for path in paths for name in _FOLLOWED)


def _changed(file: Path) -> str:
    """Time of the last change of a file, "-" without one: a run that is made replaces its files."""
    try:
        return str(file.stat().st_mtime_ns)
    except OSError:
        return "-"


def page(paths: Sequence[Path | str], *, needs_surface: bool = False) -> str:
    """HTML page of runs or scenes side by side, which follows their files.

    needs_surface: of a scan in progress, whose planes are shown; raise UserError for a run without
    a surface, as between two updates.
    """
    files = version(paths)
    scenes = [scene_of(path) for path in paths]
    if needs_surface and not scenes[0]["meshes"][0]["indices"]["data"]:
        raise UserError(what="has no surface yet", where=paths[0])
    if needs_surface:
        scenes[0].get("planes", {})["visible"] = True
    return html.render_template(
        "view_page.html",
        files=files,
        title=" and ".join(scene["name"] for scene in scenes),
        views=[
            (scene["name"], scene_json(scene), verdict_of(path))
            for scene, path in zip(scenes, paths, strict=True)
        ],
        fallback=NO_WEBGL,
        is_tall=True,
    )


def scene_of(path: Path | str) -> dict[str, Any]:
    """View of a run folder or a scene; UserError for anything else, and where nothing is shown."""
    folder = Path(path)
    view = _of_scene(folder) if is_scene(folder) else run_scene(folder)
    if view is None:
        raise UserError(what="holds nothing to show yet", where=folder)
    return view | {"name": folder.resolve().name}


def verdict_of(path: Path | str) -> Verdict | None:
    """How far a run can be trusted; None for a scene, and where it was not judged."""
    return None if is_scene(Path(path)) else RunFolder.read(Path(path)).verdict


def _of_scene(folder: Path) -> dict[str, Any] | None:
    """Box, planes and antennas of a scan."""
    capture = open_capture(folder)
    n_poses = max(1, len(capture.poses))
    planes, antennas = [], []
    for pose in capture.poses:  # which are read one at a time
        planes.append(Aperture.from_pose(pose).corners_m)
        antennas.append(_triangles(pose, _MAX_ANTENNAS // n_poses))
    if not planes and not capture.walls:
        return None
    walls = [LosPrior.from_box(wall.size_m, wall.center_m).mesh for wall in capture.walls]
    others = []
    if antennas:
        mesh = TriangleMesh.joined(antennas)
        others.append(Other(label="antennas", colour=_ANTENNA_COLOUR, opacity=1.0, mesh=mesh))
    around = Around(
        box=TriangleMesh.joined(walls) if walls else None,
        planes_m=np.array(planes).reshape(-1, 4, 3),
        others=others,
    )
    return view_scene(NOTHING, (), around)


def _triangles(pose: Pose, most: int) -> TriangleMesh:
    """Return a small triangle in the plane of a pose at each of its antennas."""
    points = np.asarray(pose.phase_centers[:: max(1, -(-pose.n_antennas // max(1, most)))])
    axes = Aperture.from_pose(pose).axes
    angles = 2.0 * np.pi * np.arange(3) / 3.0
    corners = _ANTENNA_M * (np.outer(np.cos(angles), axes[1]) + np.outer(np.sin(angles), axes[2]))
    vertices = (points[:, None] + corners).reshape(-1, 3)
    return TriangleMesh(vertices=vertices, faces=np.arange(len(vertices)).reshape(-1, 3))


def require_free(host: str, port: int) -> None:
    """Raise UserError for a used port."""
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


def is_same_origin(headers: Mapping[str, str], host: str) -> bool:
    """Whether a request comes from the server's own page, or from no page.

    host: address on which the server listens.
    """
    asked, origin = headers.get("Host", ""), headers.get("Origin")
    if host in _LOOPBACK and urlsplit(f"//{asked}").hostname not in _LOOPBACK:
        return False
    return origin is None or urlsplit(origin).netloc == asked
