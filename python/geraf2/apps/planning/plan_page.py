"""Page of a plan: its planes, the arm's path in time, and what it sees, for several scan times."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from geraf2._types import Floats, Ints
from geraf2.apps.planning.planning import PlanOptions, make_plan, make_timed_plan
from geraf2.apps.planning.scan_time import TimedPlan
from geraf2.errors import UserError
from geraf2.freespace.specular import received_normals, sphere_points
from geraf2.io.atomic import write_text_atomic
from geraf2.io.mesh import TriangleMesh
from geraf2.io.mesh_colours import ERROR_COLOURS
from geraf2.io.scan_file import ScanFile
from geraf2.io.text import csv_text
from geraf2.report import html
from geraf2.report.view3d import (
    NO_WEBGL,
    Around,
    Attribute,
    encode_integers,
    quantise,
    scene_json,
    view_scene,
)
from geraf2.scene import LosPrior
from geraf2.scene.aperture import Aperture

MINUTES, CHANNELS = (2.0, 5.0, 10.0, 20.0, 40.0), (1, 4, 8, 16)
"""Settings of the sliders, besides the given ones."""
_N_NORMALS = 1500
_SEEN_BY = ("no plane", "1 plane", "2 planes", "3 or more")
_COLOURS = (ERROR_COLOURS[5], ERROR_COLOURS[2], ERROR_COLOURS[0], "#5f93a8")
_BALL_SHARE = 0.4
"""Radius of the ball, over the shortest side of the box."""


def write_plan_page(
    path: Path,
    options: PlanOptions,
    *,
    minutes: Sequence[float] = MINUTES,
    channels: Sequence[int] = CHANNELS,
) -> list[Path]:
    """Write a page for scans of a box, with sliders for scan time and channels.

    options: box and scanner; its minutes and channels, if any, are shown first.
    minutes, channels: settings of the sliders.

    Returns the page, and the plan that it shows first as two lists of poses, `-ur.csv` and
    `-ros.csv`. Raises UserError where no setting gives a plan.
    """
    whole = make_plan(replace(options, planes=1))
    scanner, own = options.scanner, options.channels or 1
    board = scanner.array or ("of the radar's file" if scanner.own else None)
    times = sorted({*minutes, *([options.minutes] if options.minutes else [])})
    counts = [0] if board else sorted({*channels, own})
    cells = [[_try_plan(options, time, n) for n in counts] for time in times]
    first = _first_setting(cells, times, counts, options)
    shown = cells[first[0]][first[1]]
    assert shown is not None
    ball = _ball(_BALL_SHARE * min(whole.box_m))
    data = {
        "minutes": times,
        "channels": counts,
        "first": first,
        "cells": [[None if plan is None else _cell(plan, ball) for plan in row] for row in cells],
    }
    seen = Attribute(
        label="seen by",
        values=_counts(shown, ball).astype(np.float64),
        classes=_SEEN_BY,
        colours=_COLOURS,
        note="A surface is seen where its normal points at the antennas of a plane.",
    )
    around = Around(box=LosPrior.from_box(whole.box_m).mesh, planes_m=_corners(shown))
    scene = view_scene(ball, [seen], around, name=path.stem)
    scene["planes"] |= {"visible": True, "opacity": 0.4}
    scene["meshes"][0]["label"] = "directions"
    beside = {"ur": _ur_csv(shown.scan), "ros": _ros_csv(shown.scan)}
    files = {name: path.with_name(f"{path.stem}-{name}.csv") for name in beside}
    for name, text in beside.items():
        write_text_atomic(files[name], text)
    page = html.render_template(
        "plan.html",
        title=f"Plan of a scan: box of {' x '.join(f'{1e3 * s:.0f}' for s in whole.box_m)} mm",
        view=scene_json(scene),
        plan=scene_json(data),
        board=board,
        files={name: file.name for name, file in files.items()},
        fallback=NO_WEBGL,
    )
    write_text_atomic(path, page)
    return [path, *files.values()]


def _try_plan(options: PlanOptions, minutes: float, channels: int) -> TimedPlan | None:
    """Plan for a setting; None where none fits into the time."""
    try:
        return make_timed_plan(replace(options, minutes=minutes, channels=channels or None))
    except UserError:
        return None


def _first_setting(
    cells: list[list[TimedPlan | None]],
    times: list[float],
    counts: list[int],
    options: PlanOptions,
) -> tuple[int, int]:
    """Return the setting to show at first; of times that fit, the middle one if none is given."""
    column = 0 if counts == [0] else counts.index(options.channels or 1)
    shown = times if options.minutes is None else [options.minutes]
    found = [times.index(time) for time in shown if cells[times.index(time)][column]]
    if not found:
        make_timed_plan(replace(options, minutes=shown[-1]))  # raises
    return found[len(found) // 2], column


def _ball(radius_m: float) -> TriangleMesh:
    """Sphere whose vertices are the normals that are counted."""
    from scipy.spatial import ConvexHull  # noqa: PLC0415 - takes 0.1 s

    points = sphere_points(_N_NORMALS)
    faces = ConvexHull(points).simplices.astype(np.int64)
    a, b, c = (points[faces[:, k]] for k in range(3))
    inward = np.einsum("fk,fk->f", np.cross(b - a, c - a), a) < 0
    faces[inward] = faces[inward][:, ::-1]
    return TriangleMesh(vertices=radius_m * points, faces=faces)


def _planes(plan: TimedPlan) -> list[Aperture]:
    found = []
    for plane in plan.scan.planes:
        ends = np.array([end for line in plane.lines for end in (line.start_m, line.end_m)])
        axes, middle = np.asarray(plane.axes), 0.5 * (ends.min(axis=0) + ends.max(axis=0))
        half = 0.5 * np.ptp(ends @ axes.T, axis=0)[1:]
        array = np.asarray(plan.scan.array.rx_offsets_m)
        half[1] += 0.5 * float(np.ptp(array[:, 2]))
        found.append(Aperture.from_rectangle(middle, axes, half))
    return found


def _corners(plan: TimedPlan) -> Floats:
    return np.stack([plane.corners_m for plane in _planes(plan)])


def _counts(plan: TimedPlan, ball: TriangleMesh) -> Ints:
    """Return how many planes see each normal of the ball, as index of `_SEEN_BY`."""
    normals = ball.vertices / np.linalg.norm(ball.vertices, axis=1, keepdims=True)
    found = received_normals(_planes(plan), normals, np.zeros(3)).sum(axis=1)
    return np.asarray(np.minimum(found, len(_SEEN_BY) - 1))


def _cell(plan: TimedPlan, ball: TriangleMesh) -> dict[str, Any]:
    """Return what the page shows of a plan."""
    lines = [line for plane in plan.scan.planes for line in plane.lines]
    owners = [n for n, plane in enumerate(plan.scan.planes) for _ in plane.lines]
    ends = 1e3 * np.array([[line.start_m, line.end_m] for line in lines])
    expected = "unknown: the spacing is coarse" if plan.expected is None else str(plan.expected)
    minutes, seconds = divmod(round(plan.seconds), 60)
    return {
        "planes": f"{plan.design.n_planes} planes: {plan.design}",
        "spacing": f"{1e3 * plan.design.spacing_m:g} mm between antennas, {len(lines)} lines",
        "time": f"{minutes} min {seconds} s",
        "seen": f"{100 * plan.seen_share:.0f} % of all directions",
        "expected": expected,
        "corners": np.round(1e3 * _corners(plan), 1).tolist(),
        "path": quantise(ends.reshape(-1, 3), "<u2"),
        "times": [[round(line.start_s, 2), round(line.end_s, 2)] for line in lines],
        "owners": owners,
        "counts": encode_integers(_counts(plan, ball).astype("<u1")),
    }


def _ur_csv(scan: ScanFile) -> str:
    """Return ends of lines as poses of a UR: position [m], rotation vector [rad], speed [m/s]."""
    rows: list[list[object]] = []
    for plane in scan.planes:
        turn = Rotation.from_matrix(np.asarray(plane.axes).T).as_rotvec()
        for line in plane.lines:
            for end in (line.start_m, line.end_m):
                pose = [f"{value:z.6f}" for value in (*end, *turn)]
                rows.append([plane.name, *pose, f"{line.speed_m_per_s:.4g}"])
    return csv_text(["plane", "x", "y", "z", "rx", "ry", "rz", "speed"], rows)


def _ros_csv(scan: ScanFile) -> str:
    """Positions in the fields of a PoseStamped: seconds, position [m], quaternion x y z w."""
    log = scan.log_rows()[:, [0, 1, 2, 3, 5, 6, 7, 4]]
    rows = [[f"{value:z.6f}" for value in row] for row in log]
    names = [f"position.{axis}" for axis in "xyz"] + [f"orientation.{axis}" for axis in "xyzw"]
    return csv_text(["stamp", *names], rows)
