"""Common parts of the pictures: sheets, images of grids, axes in millimetres, colours."""

import json
import sys
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from geraf2._types import AnyPath, Array, Floats
from geraf2.io.atomic import atomic_path
from geraf2.io.mesh import TriangleMesh
from geraf2.scene import Grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's palette, safe for the colour-blind; black is the zero level.
GLINT_COLOUR, TRUTH_COLOUR, BOX_COLOUR = "#E69F00", "#009E73", "#7F7F7F"
BLUE, RED, SKY = "#0072B2", "#D55E00", "#56B4E9"
HEAT_MAP = "inferno"
AXIS_NAMES = ("x", "y", "z")
_DPI = 130
_MIN_POINTS = 13.0  # of letters: 11 px and more where a panel is as wide as a phone
PANELS_KEY = "geraf2-panels"
"""Text of a PNG: rows of panels (left, top, right, bottom), and height of letters [px], in JSON."""


def load_matplotlib() -> Any:
    """Matplotlib, with its built-in settings unless the caller imported it before.

    A `matplotlibrc` of the working directory may be a stranger's, and starts LaTeX.
    """
    is_new = "matplotlib" not in sys.modules
    import matplotlib as mpl  # noqa: PLC0415 - takes 0.5 s to import

    if is_new:
        mpl.rcdefaults()
    return mpl


def new_figure(width: float, height: float) -> "Figure":
    """Empty sheet of a size [inch]."""
    load_matplotlib()
    # Figures made without pyplot hold no global state and need no display.
    from matplotlib.figure import Figure  # noqa: PLC0415 - takes 0.5 s to import

    return Figure(figsize=(width, height), layout="constrained")


def save(figure: "Figure", path: AnyPath) -> None:
    """Write a sheet as PNG, with the boxes of its panels, which pages show one above the other."""
    mpl = load_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 - as above
    from matplotlib.text import Text  # noqa: PLC0415 - as above

    figure.set_dpi(_DPI)
    figure.set_facecolor("white")
    for panel in figure.axes:
        panel.tick_params(labelsize=_MIN_POINTS)
    for text in figure.findobj(Text):
        if isinstance(text, Text):
            text.set_fontsize(max(text.get_fontsize(), _MIN_POINTS))
    sheet = FigureCanvasAgg(figure)
    sheet.draw()
    about = {"rows": _panel_rows(figure), "letters": _MIN_POINTS * _DPI / 72.0}
    with atomic_path(path) as temporary:
        mpl.image.imsave(
            temporary,
            sheet.buffer_rgba(),
            format="png",
            dpi=_DPI,
            metadata={PANELS_KEY: json.dumps(about)},
            pil_kwargs={"compress_level": 1},  # a fifth larger, in a third of the time
        )


def _panel_rows(figure: "Figure") -> list[list[list[int]]]:
    """Boxes of the panels with their colour bars, by row; legends below are a row of their own."""
    width, height = (int(side) for side in figure.canvas.get_width_height())
    is_bar = {a: a.get_label() == "<colorbar>" for a in figure.axes}
    found = {a: a.get_tightbbox() for a in figure.axes}
    boxes = {a: list(box.extents) for a, box in found.items() if box is not None and not is_bar[a]}
    for bar in (a for a in found if is_bar[a]):
        x0, y0, x1, y1 = found[bar].extents  # type: ignore[union-attr]
        beside = [b for b in boxes.values() if min(b[3], y1) > max(b[1], y0) and b[0] < x0]
        nearest = max(beside or boxes.values(), key=lambda b: b[0])
        nearest[:] = [
            min(nearest[0], x0),
            min(nearest[1], y0),
            max(nearest[2], x1),
            max(nearest[3], y1),
        ]
    rows: list[list[list[float]]] = []
    for box in sorted(boxes.values(), key=lambda b: -b[3]):
        if rows and 0.5 * (box[1] + box[3]) > min(b[1] for b in rows[-1]):
            rows[-1].append(box)
        else:
            rows.append([box])
    rows += [[list(legend.get_window_extent().extents)] for legend in figure.legends]
    cut = []
    for row in rows:  # of one height, with the space between neighbours shared
        row.sort()
        low, high = min(b[1] for b in row) - 4, max(b[3] for b in row) + 4
        between = [0.5 * (a[2] + b[0]) for a, b in pairwise(row)]
        edges = [max(0, row[0][0] - 4), *between, min(width, row[-1][2] + 4)]
        top, bottom = max(0, int(height - high)), min(height, int(height - low))
        cut.append([[int(left), top, int(right), bottom] for left, right in pairwise(edges)])
    return cut


def label(panel: "Axes", x: str, y: str, title: str | None = None) -> None:
    """Label the axes of a panel, and set its title."""
    panel.set_xlabel(x)
    panel.set_ylabel(y)
    if title is not None:
        panel.set_title(title)


def label_millimetres(panel: "Axes", across: int, up: int, title: str | None = None) -> None:
    """Label two axes of the frame."""
    label(panel, f"{AXIS_NAMES[across]} [mm]", f"{AXIS_NAMES[up]} [mm]", title)


def show(panel: "Axes", values: Array, extent: Any, **style: Any) -> Any:
    """Draw values (across, up) as an image, by default to scale and without smoothing."""
    style = {"interpolation": "nearest", "aspect": "equal", "cmap": HEAT_MAP} | style
    return panel.imshow(values.T, origin="lower", extent=extent, **style)


def extent_mm(grid: Grid, across: int, up: int) -> tuple[float, float, float, float]:
    """Edges of a picture of a grid: left, right, bottom, top [mm]."""
    # Pixels are centred on voxels: the picture extends by half a voxel beyond the outer centres.
    low = np.asarray(grid.origin_m) - 0.5 * grid.spacing_m
    high = low + grid.spacing_m * np.asarray(grid.shape)
    edges = 1e3 * np.array([low[across], high[across], low[up], high[up]])
    return float(edges[0]), float(edges[1]), float(edges[2]), float(edges[3])


def draw_section(
    panel: "Axes",
    mesh: TriangleMesh,
    center: Floats,
    plane: tuple[int, int, int],
    style: tuple[str, float],
) -> None:
    """Draw the cut of a mesh by a plane through a point; style: colour and width of its lines."""
    import trimesh  # noqa: PLC0415 - takes 0.3 s to import
    from matplotlib.collections import LineCollection  # noqa: PLC0415 - as above

    across, up, cut = plane
    surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    cuts = trimesh.intersections.mesh_plane(surface, np.eye(3)[cut], center)
    segments = 1e3 * np.asarray(cuts)[:, :, [across, up]]
    lines = LineCollection(list(segments), colors=style[0], linewidths=style[1])
    panel.add_collection(lines, autolim=False)
