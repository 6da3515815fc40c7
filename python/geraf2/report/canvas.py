"""Common parts of the pictures: sheets, images of grids, axes in millimetres, colours."""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from geraf2._types import AnyPath, Array, Floats
from geraf2.io.atomic import atomic_path
from geraf2.io.mesh import TriangleMesh
from geraf2.scene import Grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colorbar import Colorbar
    from matplotlib.figure import Figure

# Okabe and Ito's palette, safe for the colour-blind; black is the zero level.
GLINT_COLOUR, TRUTH_COLOUR, BOX_COLOUR = "#E69F00", "#009E73", "#7F7F7F"
BLUE, RED, SKY = "#0072B2", "#D55E00", "#56B4E9"
HEAT_MAP = "inferno"
AXIS_NAMES = ("x", "y", "z")
_DPI = 130
_MIN_POINTS = 13.0  # of letters: 11 px and more where a panel is as wide as a phone
_MARGINS = (0.95, 0.65, 0.2, 0.45)  # of a panel, for numbers, names and title [inch]
_LINE = 0.7  # height of a title or legend [inch]
_MAX_INTERVALS = 5  # between the numbers of an axis
BAR = 1.25
"""Width of a colour bar with its numbers and name [inch]."""
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


@dataclass(frozen=True)
class Sheet:
    """A picture with rows of panels, of sizes that are given: no pass over its texts finds them."""

    figure: "Figure"
    rows: list[list["Axes"]]
    """Panels of each row."""
    cuts: list[list[list[int]]]
    """Boxes of the panels with their labels, by row: left, top, right, bottom [px]."""

    @classmethod
    def of(
        cls,
        *rows: tuple[float, Sequence[float]],
        margins: tuple[float, float, float, float] = _MARGINS,
        title: str | None = None,
        with_legend: bool = False,
    ) -> "Sheet":
        """Empty sheet.

        rows: height, and widths of the panels with their labels [inch], from above.
        margins: of each panel around its axes, left, bottom, right, top [inch].
        title: over all panels.
        with_legend: leave room for `legend` below.
        """
        load_matplotlib()
        # Figures made without pyplot hold no global state and need no display.
        from matplotlib.figure import Figure  # noqa: PLC0415 - takes 0.3 s to import

        width = max(sum(widths) for _, widths in rows)
        end = _LINE * bool(title)
        height = end + sum(tall for tall, _ in rows) + _LINE * with_legend
        figure = Figure(figsize=(width, height), dpi=_DPI, facecolor="white")
        cuts = [[(0.0, 0.0, width, end)]] * bool(title)
        panels: list[list[Axes]] = []
        left, bottom, right, top = margins
        for tall, widths in rows:
            edges, end = np.cumsum([0.0, *widths]), end + tall
            cuts.append([(x0, end - tall, x1, end) for x0, x1 in pairwise(edges.tolist())])
            low, inner = (height - end + bottom) / height, (tall - bottom - top) / height
            spans = [((x0 + left) / width, (x1 - right) / width) for x0, _, x1, _ in cuts[-1]]
            panels.append([figure.add_axes((x0, low, x1 - x0, inner)) for x0, x1 in spans])
            for panel in panels[-1]:
                panel.locator_params(nbins=_MAX_INTERVALS)  # numbers take half of the time
        if title:
            figure.suptitle(title)
        if with_legend:
            cuts.append([(0.0, end, width, height)])
        return cls(figure, panels, [[[round(_DPI * v) for v in box] for box in r] for r in cuts])

    def colour_bar(self, panel: "Axes", image: Any, name: str) -> "Colorbar":
        """Draw the scale of an image right of a panel, inside of its width."""
        x, y, width, height = panel.get_position(original=True).bounds
        inch = 1.0 / self.figure.get_figwidth()
        panel.set_position((x, y, width - BAR * inch, height))
        beside = (x + width - (BAR - 0.15) * inch, y + 0.05 * height, 0.2 * inch, 0.9 * height)
        bar = self.figure.colorbar(image, cax=self.figure.add_axes(beside))
        bar.set_label(name)
        return bar

    def legend(self, handles: Sequence[Any]) -> None:
        """Explain lines and points below the panels."""
        self.figure.legend(handles=handles, ncols=2, loc="lower center", frameon=False)

    def save(self, path: AnyPath) -> None:
        """Write PNG, with the boxes of its panels, which pages show one above the other."""
        mpl = load_matplotlib()
        from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 - as above
        from matplotlib.text import Text  # noqa: PLC0415 - as above

        for panel in self.figure.axes:
            panel.tick_params(labelsize=_MIN_POINTS)
        for text in self.figure.findobj(Text):
            if isinstance(text, Text):
                text.set_fontsize(max(text.get_fontsize(), _MIN_POINTS))
        sheet = FigureCanvasAgg(self.figure)
        sheet.draw()
        for legend in self.figure.legends:
            sides = legend.get_window_extent()
            self.cuts[-1][0][::2] = int(sides.x0), int(sides.x1) + 1
        about = {"rows": self.cuts, "letters": _MIN_POINTS * _DPI / 72.0}
        with atomic_path(path) as temporary:
            mpl.image.imsave(
                temporary,
                sheet.buffer_rgba(),
                format="png",
                dpi=_DPI,
                metadata={PANELS_KEY: json.dumps(about)},
                pil_kwargs={"compress_level": 1},  # a fifth larger, in a third of the time
            )


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
    mesh: TriangleMesh | None,
    plane: tuple[int, int, int],
    style: tuple[str, float],
    center: Floats | None = None,
) -> None:
    """Draw the cut of a mesh, if there is one, by a plane through a point, or through its middle.

    style: colour and width of its lines.
    """
    if mesh is None or not mesh.faces.shape[0]:
        return
    center = mesh.vertices.mean(axis=0) if center is None else center
    import trimesh  # noqa: PLC0415 - takes 0.3 s to import
    from matplotlib.collections import LineCollection  # noqa: PLC0415 - as above

    across, up, cut = plane
    surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    cuts = trimesh.intersections.mesh_plane(surface, np.eye(3)[cut], center)
    segments = 1e3 * np.asarray(cuts)[:, :, [across, up]]
    lines = LineCollection(list(segments), colors=style[0], linewidths=style[1])
    panel.add_collection(lines, autolim=False)
