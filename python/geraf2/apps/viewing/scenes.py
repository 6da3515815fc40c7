"""Views of runs and scenes: what the page of `geraf2 view` shows."""

from pathlib import Path
from typing import Any

import numpy as np

from geraf2.errors import UserError
from geraf2.io.container import is_scene
from geraf2.io.mesh import TriangleMesh
from geraf2.report.run_report import run_scene
from geraf2.report.view3d import NOTHING, Around, Other, view_scene
from geraf2.scene import LosPrior, Pose
from geraf2.scene.aperture import Aperture
from geraf2.scene.store import open_capture

_MAX_ANTENNAS = 24_000
"""Most antennas shown of a scene."""
_ANTENNA_M = 0.0008
_ANTENNA_COLOUR = "#56B4E9"


def scene_of(path: Path | str) -> dict[str, Any]:
    """View of a run folder or a scene; UserError for anything else, and where nothing is shown."""
    folder = Path(path)
    view = _of_scene(folder) if is_scene(folder) else run_scene(folder)
    if view is None:
        raise UserError(what="holds nothing to show yet", where=folder)
    return view | {"name": folder.resolve().name}


def _of_scene(folder: Path) -> dict[str, Any] | None:
    """Box, planes and antennas of a scan."""
    capture = open_capture(folder)
    n_poses = max(1, len(capture.poses))
    planes, antennas = [], []
    for pose in capture.poses:  # which are read one at a time
        planes.append(Aperture.of_pose(pose).corners_m)
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
    axes = Aperture.of_pose(pose).axes
    angles = 2.0 * np.pi * np.arange(3) / 3.0
    corners = _ANTENNA_M * (np.outer(np.cos(angles), axes[1]) + np.outer(np.sin(angles), axes[2]))
    vertices = (points[:, None] + corners).reshape(-1, 3)
    return TriangleMesh(vertices=vertices, faces=np.arange(len(vertices)).reshape(-1, 3))
