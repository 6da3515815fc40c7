"""Draw the picture of the README: a closed carton, what is found in it, what was in it.

geraf2 reconstruct out/demo/scene out/best --los out/demo/scene/los.ply --preset best
python tools/draw_hero.py out/best out/demo/scene/truth.ply docs/hero.png
"""

import sys
from itertools import product

import matplotlib as mpl
import numpy as np

mpl.use("agg")
from matplotlib import pyplot as plt

import geraf2
from geraf2.io.mesh import TriangleMesh, read_mesh
from geraf2.report import MeshPainter, View

CARDBOARD, EDGE, TAPE = "#c8a273", "#8a6a42", "#dcc39a"
STEEL, GREY = (0.42, 0.62, 0.86), (0.80, 0.80, 0.78)
AZIMUTH_DEG, ELEVATION_DEG = 128.0, 14.0


def faces(low: np.ndarray, high: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Outward normal and corners (4, 3) of each side of a box."""
    sides = []
    for axis, end in product(range(3), (0, 1)):
        normal = np.zeros(3)
        normal[axis] = 2 * end - 1
        others = [a for a in range(3) if a != axis]
        corners = np.empty((4, 3))
        for row, (i, j) in enumerate(((0, 0), (0, 1), (1, 1), (1, 0))):
            corners[row, axis] = (low, high)[end][axis]
            corners[row, others] = (low, high)[i][others[0]], (low, high)[j][others[1]]
        sides.append((normal, corners))
    return sides


def draw_box(panel: plt.Axes, view: View, box: TriangleMesh, *, front: bool, alpha: float) -> None:
    """Sides that face the camera, or the others, darker the more they lean away."""
    for normal, corners in faces(box.vertices.min(axis=0), box.vertices.max(axis=0)):
        toward = float(normal @ view.axes[2])
        if (toward > 0) != front:
            continue
        shade = 0.72 + 0.28 * abs(toward) + 0.12 * float(normal[2] > 0.5)
        colour = np.clip(np.array(mpl.colors.to_rgb(CARDBOARD)) * shade, 0, 1)
        panel.fill(*(corners @ view.axes[:2].T).T, fc=(*colour, alpha), ec=EDGE, lw=0.8)
        if alpha == 1.0 and normal[2] > 0.5:  # a strip of tape over the lid
            middle, half = corners.mean(axis=0), np.ptp(corners, axis=0) / 2
            ends = np.array([[1, 0.12], [1, -0.12], [-1, -0.12], [-1, 0.12]])
            strip = middle + np.column_stack([ends * half[:2], np.zeros(4)])
            panel.fill(*(strip @ view.axes[:2].T).T, fc=TAPE, ec="none")


def draw_mesh(panel: plt.Axes, view: View, mesh: TriangleMesh, colour: tuple[float, ...]) -> None:
    picture = MeshPainter(mesh).render(view, np.tile(colour, (len(mesh.vertices), 1)))
    extent = [-view.half_width_m, view.half_width_m] * 2
    panel.imshow(picture, extent=extent, zorder=2, interpolation="bilinear")


def main() -> None:
    run, truth = geraf2.load_run(sys.argv[1]), read_mesh(sys.argv[2])
    content, box = run.content_mesh, run.prior.mesh
    view, near = (
        View(
            azimuth_deg=AZIMUTH_DEG,
            elevation_deg=ELEVATION_DEG,
            center_m=(0.0, 0.0, 0.0),
            half_width_m=half_width_m,
            n_pixels=480,
        )
        for half_width_m in (0.17, 0.1)
    )
    figure, panels = plt.subplots(1, 4, figsize=(9.6, 3.0), width_ratios=(3.2, 3.2, 2.4, 2.4))
    draw_box(panels[0], view, box, front=True, alpha=1.0)
    draw_box(panels[1], view, box, front=False, alpha=0.18)
    draw_mesh(panels[1], view, content, STEEL)
    draw_box(panels[1], view, box, front=True, alpha=0.10)
    draw_mesh(panels[2], near, content, STEEL)
    draw_mesh(panels[3], near, truth, GREY)
    titles = ("a closed carton", "what the radar found in it", "the same", "what was in it")
    sizes = ((0.165, 0.15),) * 2 + ((0.075, 0.0909),) * 2
    for panel, title, (across, up) in zip(panels, titles, sizes, strict=True):
        panel.set_title(title, fontsize=11)
        panel.set(xlim=(-across, across), ylim=(-up, up), aspect="equal")
        panel.axis("off")
    figure.tight_layout(pad=0.3)
    figure.savefig(sys.argv[3], dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    main()
