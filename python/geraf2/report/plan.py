"""Drawing of a planned scan: from above, from the side, and its visible normals."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from geraf2._types import AnyPath, Floats
from geraf2.freespace.specular import received_normals, seen_share
from geraf2.report import canvas
from geraf2.report.canvas import BLUE, BOX_COLOUR
from geraf2.scene.aperture import Aperture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_N_AZIMUTHS, _N_HEIGHTS = 181, 91


def plan_figure(
    planes: Sequence[Aperture], box_m: tuple[float, float, float], center_m: Floats, path: AnyPath
) -> None:
    """Draw planes around a box, and the normals that they see at a point, (3,) [m]."""
    sheet = canvas.Sheet.of((4.6, (4.3, 4.3, 5.3 + canvas.BAR)))
    ((above, side, normals),) = sheet.rows
    _draw_box(above, box_m, (0, 1), "from above")
    _draw_box(side, box_m, (0, 2), "from the side, planes turned into the picture")
    for plane in planes:
        ends = 1e3 * plane.points_at(np.array([(-1.0, 0.0), (1.0, 0.0)]))
        above.plot(ends[:, 0], ends[:, 1], color=BLUE, linewidth=1.2)
        ends = 1e3 * plane.points_at(np.array([(0.0, -1.0), (0.0, 1.0)]))
        azimuth = np.arctan2(plane.axes[1][0], -plane.axes[1][1])
        away = ends[:, :2] @ [np.cos(azimuth), np.sin(azimuth)]
        for sign in (-1.0, 1.0):
            side.plot(sign * away, ends[:, 2], color=BLUE, linewidth=2.0)
    share = seen_share(planes, center_m, np.asarray(box_m))
    draw_normals(sheet, normals, planes, center_m, share)
    sheet.save(path)


def _draw_box(
    panel: "Axes", box_m: tuple[float, float, float], axes: tuple[int, int], title: str
) -> None:
    half = [0.5e3 * box_m[axis] for axis in axes]
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * half
    panel.plot(corners[:, 0], corners[:, 1], color=BOX_COLOUR, linewidth=1.8)
    panel.set_aspect("equal")
    canvas.label_millimetres(panel, *axes, title)


def draw_normals(
    sheet: canvas.Sheet, panel: "Axes", planes: Sequence[Aperture], point: Floats, share: float
) -> None:
    """Draw the visible normals of a surface, in an equal-area map.

    planes: of the antennas of each pose. point: position of the surface, (3,) [m].
    share: of `seen_share`, for the title.
    """
    from matplotlib.ticker import MaxNLocator  # noqa: PLC0415 - takes 0.5 s to import

    azimuth = np.linspace(-180.0, 180.0, _N_AZIMUTHS)
    height = np.linspace(-1.0, 1.0, _N_HEIGHTS)
    a, h = np.meshgrid(np.deg2rad(azimuth), height)
    ring = np.sqrt(1.0 - h**2)
    directions = np.stack([ring * np.cos(a), ring * np.sin(a), h], axis=-1).reshape(-1, 3)
    count = received_normals(planes, directions, point).sum(axis=1).reshape(a.shape).astype(float)
    seen, extent = np.where(count > 0, count, np.nan).T, (-180.0, 180.0, -1.0, 1.0)
    image = canvas.show(panel, seen, extent, aspect="auto", cmap="viridis", vmin=0.0)
    ticks = np.array([-90, -60, -30, 0, 30, 60, 90])
    panel.set_yticks(np.sin(np.deg2rad(ticks)), [str(tick) for tick in ticks])
    panel.set_facecolor("#DDDDDD")
    title = f"{100.0 * share:.0f} % of all normals seen; grey: never"
    canvas.label(
        panel, "azimuth of the normal [degrees]", "elevation of the normal [degrees]", title
    )
    bar = sheet.colour_bar(panel, image, "planes that see it")
    bar.locator = MaxNLocator(integer=True)
