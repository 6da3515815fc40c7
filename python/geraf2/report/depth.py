"""Picture of a planar scan: the sharpest slice, and the sharpness over depth."""

from typing import TYPE_CHECKING

from geraf2._types import AnyPath, Floats, Floats32
from geraf2.report import canvas
from geraf2.report.canvas import AXIS_NAMES, GLINT_COLOUR
from geraf2.scene import Grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def sharpest_slice(
    values: Floats32, grid: Grid, axis: int, depths_m: Floats, sharpness: Floats, path: AnyPath
) -> None:
    """Draw the slice at the sharpest depth, and the sharpness over depth.

    values: magnitude of that slice of an image, the grid's shape without the axis.
    axis: axis of the grid along the viewing direction.
    depths_m, sharpness: distance from the antennas [m] and sharpness of each slice,
        (grid.shape[axis],).
    """
    best = int(sharpness.argmax())
    across, up = (other for other in range(3) if other != axis)
    sheet = canvas.Sheet.of((4.6, (4.6 + canvas.BAR, 4.6)))
    ((picture, curve),) = sheet.rows
    extent = canvas.extent_mm(grid, across, up)
    image = canvas.show(picture, values, extent)
    depth_mm = 1e3 * depths_m[best]
    title = f"depth {depth_mm:.1f} mm, across {AXIS_NAMES[axis]}"
    canvas.label_millimetres(picture, across, up, title)
    sheet.colour_bar(picture, image, "magnitude")
    draw_focus(curve, depths_m, sharpness)
    sheet.save(path)


def draw_focus(
    panel: "Axes", depths_m: Floats, sharpness: Floats, title: str | None = None
) -> None:
    """Draw sharpness over depth, (n,) each, with a line at its maximum."""
    panel.plot(1e3 * depths_m, sharpness, color="black")
    panel.axvline(1e3 * depths_m[sharpness.argmax()], color=GLINT_COLOUR)
    canvas.label(panel, "depth [mm]", "sharpness, n sum v^4 / (sum v^2)^2", title)
