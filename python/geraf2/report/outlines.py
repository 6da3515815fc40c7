"""Picture of the shadows on the far walls."""

import numpy as np

from geraf2._types import AnyPath
from geraf2.evaluation import sample_surface
from geraf2.freespace.silhouettes import Silhouettes
from geraf2.io.mesh import TriangleMesh
from geraf2.report import canvas
from geraf2.report.canvas import AXIS_NAMES, GLINT_COLOUR, TRUTH_COLOUR

_SHADOW_MAP = "gray"
_SAMPLES = 100_000


def shadow_pictures(
    silhouettes: Silhouettes,
    content: TriangleMesh | None,
    path: AnyPath,
    *,
    truth: TriangleMesh | None = None,
) -> None:
    """Draw the remaining echo of each far wall, and the outlines of surfaces before it.

    silhouettes: at least one. content, truth: surfaces [m], or None.
    """
    from matplotlib.lines import Line2D  # noqa: PLC0415 - takes 0.5 s to import

    widths = [4.0] * len(silhouettes)
    widths[-1] += canvas.BAR
    sheet = canvas.Sheet.of((4.1, widths), with_legend=content is not None or truth is not None)
    (panels,) = sheet.rows
    spacing_m = float(silhouettes.spacing_m)
    surfaces = {"content": (content, GLINT_COLOUR), "truth": (truth, TRUTH_COLOUR)}
    for number, panel in enumerate(panels):
        across, up = (k for k in range(3) if k != silhouettes.axes[number])
        known = silhouettes.known[number]
        seen = np.where(known, np.clip(silhouettes.transmission[number], 0.0, 1.0), np.nan)
        first = silhouettes.origins_m[number]
        edges = [
            (first[k] - 0.5 * spacing_m, first[k] + (known.shape[k] - 0.5) * spacing_m)
            for k in range(2)
        ]
        extent = [1e3 * e for pair in edges for e in pair]
        image = canvas.show(panel, seen, extent, cmap=_SHADOW_MAP, vmin=0.0, vmax=1.0)
        for surface, colour in surfaces.values():
            if surface is None:
                continue
            points = sample_surface(surface, _SAMPLES, np.random.default_rng(0))
            bins = [np.arange(low, high + spacing_m, spacing_m) for low, high in edges]
            hits, *_ = np.histogram2d(points[:, across], points[:, up], bins=bins)
            middles = [1e3 * 0.5 * (b[1:] + b[:-1]) for b in bins]
            panel.contour(*middles, (hits > 0).T, levels=[0.5], colors=colour, linewidths=1.2)
        title = f"along {AXIS_NAMES[int(silhouettes.axes[number])]}"
        canvas.label_millimetres(panel, across, up, title)
    sheet.colour_bar(panels[-1], image, "share of the wall's echo")
    handles = [
        Line2D([], [], color=colour, label=name)
        for name, (surface, colour) in surfaces.items()
        if surface is not None
    ]
    if handles:
        sheet.legend(handles)
    sheet.save(path)
