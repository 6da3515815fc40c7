"""Draw the thumbnails of the gallery: run each script and draw its meshes small.

    python tools/draw_gallery.py                 # all of them: 15 minutes of one core
    python tools/draw_gallery.py plot_05_noise   # those named

The pictures go to docs/_static/gallery; the site shows them without running a script.
"""

import importlib
import io
import runpy
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from PIL import Image

mpl.use("agg")
from matplotlib import pyplot as plt

from geraf2.io.mesh import TriangleMesh
from geraf2.report import MeshPainter, View

ROOT = Path(__file__).resolve().parent.parent
GALLERY, OUT = ROOT / "docs" / "gallery", ROOT / "docs" / "_static" / "gallery"
WIDTH, HEIGHT = 400, 280
"""Pixels of a thumbnail, as sphinx-gallery scales them."""
DPI = 100
TITLE, LETTER, MARGIN = 26, 8.5, 8
"""Height of a title, width of a letter, free space around a mesh [pixels]."""
STEEL, GREY = (0.42, 0.62, 0.86), (0.80, 0.80, 0.78)
TRUTH = "true"

Panels = list[tuple[str, TriangleMesh]]


def panels_of(script: Path) -> Panels:
    """Meshes that a script draws side by side, with short titles; empty for another picture."""
    pictures = importlib.import_module("pictures")
    drawn: Panels = []

    def record(meshes: dict[str, TriangleMesh], **_: object) -> None:
        drawn.extend((title.partition(",")[0], mesh) for title, mesh in meshes.items())

    pictures.side_by_side = record
    runpy.run_path(str(script))
    return drawn


def extent_of(mesh: TriangleMesh) -> np.ndarray:
    """Width and height of the mesh in the picture [m]."""
    along = mesh.vertices @ camera(mesh, 1.0).axes[:2].T
    return np.ptp(along, axis=0)


def camera(mesh: TriangleMesh, half_width_m: float) -> View:
    """Camera at the azimuth of the gallery that looks at the middle of the drawn mesh."""
    turned = View(azimuth_deg=30.0, center_m=(0.0, 0.0, 0.0), half_width_m=1.0).axes
    along = mesh.vertices @ turned.T
    middle = (along.min(axis=0) + along.max(axis=0)) / 2 @ turned
    return View(
        azimuth_deg=30.0, center_m=tuple(middle), half_width_m=half_width_m, n_pixels=2 * HEIGHT
    )


def row_width(row: Panels, scale: float) -> float:
    """Width of a row at a scale in pixels per metre [pixels]."""
    return sum(cell_width(panel, scale) for panel in row)


def cell_width(panel: tuple[str, TriangleMesh], scale: float) -> float:
    title, mesh = panel
    return max(extent_of(mesh)[0] * scale, LETTER * len(title)) + 2 * MARGIN


def row_height(row: Panels, scale: float) -> float:
    return max(extent_of(mesh)[1] for _, mesh in row) * scale + TITLE + MARGIN


def largest_scale(rows: list[Panels]) -> float:
    """Pixels per metre at which the rows fill the thumbnail."""
    low, high = 0.0, 1e5
    for _ in range(40):
        scale = (low + high) / 2
        fits = max(row_width(row, scale) for row in rows) <= WIDTH
        fits = fits and sum(row_height(row, scale) for row in rows) <= HEIGHT
        low, high = (scale, high) if fits else (low, scale)
    return low


def draw(panels: Panels, path: Path) -> None:
    """Write the thumbnail of some meshes, at one scale, in one row or two."""
    half = -(-len(panels) // 2)
    rows = max([panels], [panels[:half], panels[half:]], key=largest_scale)
    scale = largest_scale(rows)
    figure = plt.figure(figsize=(WIDTH / DPI, HEIGHT / DPI))
    canvas = figure.add_axes((0, 0, 1, 1), xlim=(0, WIDTH), ylim=(HEIGHT, 0))
    canvas.axis("off")
    top = (HEIGHT - sum(row_height(row, scale) for row in rows)) / 2
    for row in rows:
        left = (WIDTH - row_width(row, scale)) / 2
        for title, mesh in row:
            x = left + cell_width((title, mesh), scale) / 2
            canvas.text(x, top + TITLE / 2, title, ha="center", va="center", fontsize=11)
            half_m = 0.52 * float(extent_of(mesh).max())
            y, r = top + TITLE + (row_height(row, scale) - TITLE - MARGIN) / 2, half_m * scale
            colours = np.tile(GREY if title == TRUTH else STEEL, (len(mesh.vertices), 1))
            picture = MeshPainter(mesh).render(camera(mesh, half_m), colours)
            canvas.imshow(picture, extent=(x - r, x + r, y + r, y - r), interpolation="antialiased")
            left += cell_width((title, mesh), scale)
        top += row_height(row, scale)
    canvas.set(xlim=(0, WIDTH), ylim=(HEIGHT, 0))
    save(figure, path)


def shrink(figure: plt.Figure) -> None:
    """Make a script's own picture a thumbnail: no axes, short titles."""
    figure.set_size_inches(WIDTH / DPI, HEIGHT / DPI)
    for panel in figure.axes:
        panel.set_title(panel.get_title().partition(",")[0], fontsize=11)
        panel.axis("off")
    figure.subplots_adjust(0.02, 0.02, 0.98, 0.9, wspace=0.05)


def save(figure: plt.Figure, path: Path) -> None:
    """Write a picture with a palette of 128 colours, a third of the size of true colour."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with io.BytesIO() as data:
        figure.savefig(data, dpi=DPI, format="png")
        Image.open(data).convert("RGB").quantize(128).save(path, optimize=True)  # noqa: TID251 - our own


def main(names: list[str]) -> int:
    sys.path.insert(0, str(GALLERY))
    for name in names or [path.stem for path in sorted(GALLERY.glob("plot_*.py"))]:
        plt.close("all")
        panels = panels_of(GALLERY / f"{name}.py")
        if panels:
            draw(panels, OUT / f"{name}.png")
        else:
            shrink(plt.gcf())
            save(plt.gcf(), OUT / f"{name}.png")
        print(OUT / f"{name}.png")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
