"""Picture of the shadows on the far walls."""

import os

import numpy as np

from geraf2.evaluation import sample_surface
from geraf2.glints.silhouettes import Silhouettes
from geraf2.io.mesh import TriangleMesh
from geraf2.report.figures import (
    _AXIS_NAMES,
    GLINT_COLOUR,
    TRUTH_COLOUR,
    _label_millimetres,
    new_figure,
    save_figure,
)

_SHADOW_MAP = "gray"
_SAMPLES = 100_000


def shadow_pictures(
    silhouettes: Silhouettes,
    content: TriangleMesh | None,
    path: str | os.PathLike[str],
    *,
    truth: TriangleMesh | None = None,
) -> None:
    """Draw how much of each wall's flash is left, and the outlines of surfaces before it.

    Parameters
    ----------
    silhouettes
        At least one.
    content
        Reconstructed surface [m]; only the shadow when None.
    path
        PNG to write.
    truth
        True surface [m], drawn in another colour.
    """
    from matplotlib.lines import Line2D  # noqa: PLC0415 - takes 0.5 s to import

    figure = new_figure(4.6 * len(silhouettes) + 0.8, 4.8)
    panels = np.atleast_1d(figure.subplots(1, len(silhouettes)))
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
        extent = tuple(1e3 * e for pair in edges for e in pair)
        image = panel.imshow(
            seen.T, _SHADOW_MAP, origin="lower", extent=extent, interpolation="nearest"
        )
        image.set_clim(0.0, 1.0)
        for surface, colour in surfaces.values():
            if surface is None:
                continue
            points = sample_surface(surface, _SAMPLES, np.random.default_rng(0))
            bins = [np.arange(low, high + spacing_m, spacing_m) for low, high in edges]
            hits, *_ = np.histogram2d(points[:, across], points[:, up], bins=bins)
            middles = [1e3 * 0.5 * (b[1:] + b[:-1]) for b in bins]
            panel.contour(*middles, (hits > 0).T, levels=[0.5], colors=colour, linewidths=1.2)
        panel.set_title(f"along {_AXIS_NAMES[int(silhouettes.axes[number])]}")
        _label_millimetres(panel, across, up)
    figure.colorbar(image, ax=list(panels), shrink=0.85).set_label("share of the wall's flash")
    handles = [
        Line2D([], [], color=colour, label=name)
        for name, (surface, colour) in surfaces.items()
        if surface is not None
    ]
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)
    save_figure(figure, path)
