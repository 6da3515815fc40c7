"""Drawing of a planned scan: from above, from the side, and which normals it will see."""

import os
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from geraf2.report.figures import BOX_COLOUR, new_figure, save_figure
from geraf2.scene.plan import Plane, ScanPlan, count_planes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_RADAR_COLOUR = "#0072B2"
_N_AZIMUTHS, _N_HEIGHTS = 181, 91


def plan_figure(plan: ScanPlan, path: str | os.PathLike[str]) -> None:
    """Draw a plan.

    Parameters
    ----------
    plan
        The scan.
    path
        PNG to write.
    """
    figure = new_figure(13.0, 4.6)
    above, side, normals = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 1.35))
    _draw_box(above, plan, (0, 1), "from above")
    _draw_box(side, plan, (0, 2), "from the side")
    for middle, axes in plan.planes():
        half = 0.5e3 * np.asarray(plan.aperture_m)
        ends = 1e3 * middle + np.outer([-half[0], half[0]], axes[1])
        above.plot(ends[:, 0], ends[:, 1], color=_RADAR_COLOUR, linewidth=1.2)
    for elevation in np.deg2rad(plan.elevations_deg):
        for side_sign in (-1.0, 1.0):
            outward = np.array([side_sign * np.cos(elevation), np.sin(elevation)])
            across = np.array([-side_sign * np.sin(elevation), np.cos(elevation)])
            half_height = 0.5e3 * plan.aperture_m[1]
            ends = 1e3 * plan.standoff_m * outward + np.outer([-half_height, half_height], across)
            side.plot(ends[:, 0], ends[:, 1], color=_RADAR_COLOUR, linewidth=2.0)
    planes = [
        Plane(middle=middle, axes=axes, half_m=0.5 * np.asarray(plan.aperture_m))
        for middle, axes in plan.planes()
    ]
    draw_normals(figure, normals, planes, np.zeros(3), plan.seen_share())
    save_figure(figure, path)


def _draw_box(panel: "Axes", plan: ScanPlan, axes: tuple[int, int], title: str) -> None:
    half = [0.5e3 * plan.box_m[axis] for axis in axes]
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * half
    panel.plot(corners[:, 0], corners[:, 1], color=BOX_COLOUR, linewidth=1.8)
    panel.set_aspect("equal")
    panel.set_title(title)
    panel.set_xlabel(f"{'xyz'[axes[0]]} [mm]")
    panel.set_ylabel(f"{'xyz'[axes[1]]} [mm]")


def draw_normals(
    figure: "Figure", panel: "Axes", planes: list[Plane], point: NDArray[np.float64], share: float
) -> None:
    """Draw which normals of a surface are seen; the sine of the elevation makes equal areas equal.

    Parameters
    ----------
    figure, panel
        Where to draw.
    planes
        What the antennas of each pose cover.
    point
        Where the surface is, (3,) [m].
    share
        For the title, of `seen_share`.
    """
    from matplotlib.ticker import MaxNLocator  # noqa: PLC0415 - as late as the figure itself

    azimuth = np.linspace(-180.0, 180.0, _N_AZIMUTHS)
    height = np.linspace(-1.0, 1.0, _N_HEIGHTS)
    a, h = np.meshgrid(np.deg2rad(azimuth), height)
    ring = np.sqrt(1.0 - h**2)
    directions = np.stack([ring * np.cos(a), ring * np.sin(a), h], axis=-1).reshape(-1, 3)
    count = count_planes(planes, directions, point).reshape(a.shape).astype(float)
    image = panel.imshow(
        np.where(count > 0, count, np.nan),
        origin="lower",
        extent=(-180.0, 180.0, -1.0, 1.0),
        aspect="auto",
        cmap="viridis",
        vmin=0.0,
        interpolation="nearest",
    )
    ticks = np.array([-90, -60, -30, 0, 30, 60, 90])
    panel.set_yticks(np.sin(np.deg2rad(ticks)), [str(tick) for tick in ticks])
    panel.set_facecolor("#DDDDDD")
    panel.set_xlabel("azimuth of the normal [degrees]")
    panel.set_ylabel("elevation of the normal [degrees]")
    panel.set_title(f"{100.0 * share:.0f} % of all normals seen; grey: never")
    bar = figure.colorbar(image, ax=panel, shrink=0.85)
    bar.locator = MaxNLocator(integer=True)
    bar.set_label("planes that see it")
