"""Drawing of a planned scan: from above, from the side, and its visible normals."""

from typing import TYPE_CHECKING

import numpy as np

from geraf2._types import AnyPath, Floats
from geraf2.freespace.specular import received_normals, seen_share
from geraf2.report import canvas
from geraf2.report.canvas import BLUE, BOX_COLOUR
from geraf2.scene.aperture import Aperture
from geraf2.scene.plan import ScanPlan

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_N_AZIMUTHS, _N_HEIGHTS = 181, 91


def plan_figure(plan: ScanPlan, path: AnyPath) -> None:
    """Draw a plan."""
    figure = canvas.new_figure(13.0, 4.6)
    above, side, normals = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 1.35))
    _draw_box(above, plan, (0, 1), "from above")
    _draw_box(side, plan, (0, 2), "from the side")
    for middle, axes in plan.planes():
        half = 0.5e3 * np.asarray(plan.aperture_m)
        ends = 1e3 * middle + np.outer([-half[0], half[0]], axes[1])
        above.plot(ends[:, 0], ends[:, 1], color=BLUE, linewidth=1.2)
    for elevation in np.deg2rad(plan.elevations_deg):
        for side_sign in (-1.0, 1.0):
            outward = np.array([side_sign * np.cos(elevation), np.sin(elevation)])
            across = np.array([-side_sign * np.sin(elevation), np.cos(elevation)])
            half_height = 0.5e3 * plan.aperture_m[1]
            ends = 1e3 * plan.standoff_m * outward + np.outer([-half_height, half_height], across)
            side.plot(ends[:, 0], ends[:, 1], color=BLUE, linewidth=2.0)
    share = seen_share(plan.apertures, np.zeros(3), np.asarray(plan.box_m))
    draw_normals(figure, normals, plan.apertures, np.zeros(3), share)
    canvas.save(figure, path)


def _draw_box(panel: "Axes", plan: ScanPlan, axes: tuple[int, int], title: str) -> None:
    half = [0.5e3 * plan.box_m[axis] for axis in axes]
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * half
    panel.plot(corners[:, 0], corners[:, 1], color=BOX_COLOUR, linewidth=1.8)
    panel.set_aspect("equal")
    canvas.label_millimetres(panel, *axes, title)


def draw_normals(
    figure: "Figure", panel: "Axes", planes: list[Aperture], point: Floats, share: float
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
    bar = figure.colorbar(image, ax=panel, shrink=0.85)
    bar.locator = MaxNLocator(integer=True)
    bar.set_label("planes that see it")
