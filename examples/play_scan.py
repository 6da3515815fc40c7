"""A stored scan, sent or written plane by plane at the speed of an arm, for `geraf2 live`.

python examples/play_scan.py SCENE TARGET [SECONDS A PLANE] &
geraf2 live TARGET OUT

TARGET is a folder, or the socket at which `geraf2 live` listens: tcp://localhost:PORT or unix:PATH.
"""

import socket
import sys
import time
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlsplit

from geraf2 import open_capture
from geraf2.io.growing_scene import GrowingScene
from geraf2.io.plane_stream import end_frame, plane_frame, scan_frame
from geraf2.scene.store import manifest_of


def connected(address: str) -> socket.socket:
    """Connection to a socket, once somebody listens there."""
    while True:
        try:
            if address.startswith("unix:"):
                found = socket.socket(socket.AF_UNIX)
                found.connect(address.removeprefix("unix:"))
                return found
            return socket.create_connection(("localhost", urlsplit(address).port))
        except (ConnectionRefusedError, FileNotFoundError):
            time.sleep(0.2)


if len(sys.argv) < 3:
    raise SystemExit(__doc__)
source, target = Path(sys.argv[1]), sys.argv[2]
seconds = float(sys.argv[3]) if len(sys.argv) > 3 else 10.0

capture = open_capture(source)  # reads a plane at a time
n_planes = len(capture.poses)
provenance = {**capture.provenance, "n_planes": str(n_planes)}
about = manifest_of(replace(capture, poses=(), provenance=provenance))
if target.startswith(("tcp:", "unix:")):
    connection = connected(target)
    connection.sendall(scan_frame(about))
else:
    connection, scene = None, GrowingScene(Path(target), about)
for number, pose in enumerate(capture.poses, start=1):
    time.sleep(seconds)
    if connection:
        connection.sendall(plane_frame(pose))
    else:
        scene.append(pose)
    print(f"plane {number} of {n_planes}", flush=True)
if connection:
    connection.sendall(end_frame())
    connection.close()
