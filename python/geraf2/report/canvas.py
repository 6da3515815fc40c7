"""Common parts of the pictures: sheets, images of grids, axes in millimetres, colours."""

import sys
from typing import TYPE_CHECKING, Any

import numpy as np

from geraf2._types import AnyPath, Array, Floats
from geraf2.io.atomic import atomic_path
from geraf2.io.mesh import TriangleMesh
from geraf2.report.sections import plane_section
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
    """Write a sheet as PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 - as above

    FigureCanvasAgg(figure)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=_DPI, format="png", facecolor="white")


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
    from matplotlib.collections import LineCollection  # noqa: PLC0415 - as above

    across, up, cut = plane
    segments = 1e3 * plane_section(mesh, cut, float(center[cut]))[:, :, [across, up]]
    lines = LineCollection(list(segments), colors=style[0], linewidths=style[1])
    panel.add_collection(lines, autolim=False)
