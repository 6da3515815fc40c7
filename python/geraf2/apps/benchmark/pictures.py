"""Pictures of a benchmark: surfaces, cuts of the signed distance, scores over a setting."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geraf2.apps.benchmark.rows import Row, RowResult
from geraf2.apps.benchmark.suite import Experiment
from geraf2.fields import SdfGrid
from geraf2.geometry.transforms import triple
from geraf2.io.container import TRUTH_NAME
from geraf2.io.mesh import TriangleMesh, read_mesh
from geraf2.io.run_folder import CONTENT_NAME
from geraf2.report.canvas import new_figure, save
from geraf2.report.render import MeshPainter, View
from geraf2.report.sections import plane_section

_GREY, _BLUE = (0.72, 0.72, 0.72), (0.45, 0.62, 0.85)
_MAX_COLUMNS, _MAX_ROWS = 8, 9
_N_PIXELS = 220
# Margin around the truth on cuts [mm].
_CUT_MARGIN_MM = 25.0

Results = Sequence[tuple[Row, RowResult]]


def draw_gallery(
    path: Path, out: Path, results: Results, *, num_threads: int | None = None
) -> bool:
    """Draw truth and meshes, a line of pictures for each scene; False where there is none.

    path: PNG to write. out: folder of the benchmark. results: rows of one experiment.
    num_threads: of the ray tracer; all when None.
    """
    lines = _lines(results, CONTENT_NAME, out)
    if not lines:
        return False
    figure, panels = _panels(len(lines), 1 + max(map(len, lines.values())), (1.9, 2.1))
    for axes, (scene, line) in zip(panels, lines.items(), strict=True):
        truth = read_mesh(out / str(line[0][1].scene_folder) / TRUTH_NAME)
        low, high = truth.vertices.min(axis=0), truth.vertices.max(axis=0)
        center = 0.5 * (low + high)
        view = View(
            azimuth_deg=35.0,
            center_m=triple(center),
            half_width_m=0.52 * float(np.linalg.norm(high - low)),
            n_pixels=_N_PIXELS,
        )
        axes[0].imshow(_picture(truth, view, _GREY, num_threads))
        axes[0].set_title(scene, fontsize=8)
        for panel, (row, result) in zip(axes[1:], line, strict=False):
            mesh = read_mesh(out / str(result.folder) / CONTENT_NAME)
            panel.imshow(_picture(mesh, view, _BLUE, num_threads))
            panel.set_title(_title(row, result), fontsize=7)
    save(figure, path)
    return True


def draw_slices(path: Path, out: Path, results: Results) -> bool:
    """Draw a horizontal cut through the signed distance of each row; False where there is none."""
    lines = _lines(results, "sdf.npz", out)
    if not lines:
        return False
    figure, panels = _panels(len(lines), max(map(len, lines.values())), (2.1, 2.3))
    for axes, line in zip(panels, lines.values(), strict=True):
        truth = read_mesh(out / str(line[0][1].scene_folder) / TRUTH_NAME)
        height = float(np.median(truth.vertices[:, 2]))
        for panel, (row, result) in zip(axes, line, strict=False):
            _draw_cut(panel, SdfGrid.load(out / str(result.folder) / "sdf.npz"), truth, height)
            panel.set_title(f"{row.scene}\n{_title(row, result)}", fontsize=7)
    save(figure, path)
    return True


def draw_sweep(
    path: Path, experiment: Experiment, results: Results, titles: Mapping[str, str]
) -> bool:
    """Draw F1 over the settings, mean over scenes; False with values of fewer than three."""
    labels = [case.label for case in experiment.cases]
    known = {row.case.label for row, result in results if result.f1_5mm is not None}
    if len(known) < 3:
        return False
    figure = new_figure(7.2, 3.4)
    panel = figure.subplots()
    for number, method in enumerate(experiment.methods):
        for key, style in (("f1_15mm", "-"), ("f1_5mm", "--")):
            means = []
            for case in experiment.cases:
                own = [r for row, r in results if (row.method, row.case) == (method, case)]
                of = [getattr(r, key) for r in own]
                values = [value for value in of if value is not None]
                means.append(sum(values) / len(values) if values else np.nan)
            if not np.isfinite(means).any():
                continue
            label = titles[method] if style == "-" else None
            panel.plot(
                range(len(labels)), means, style, marker="o", color=f"C{number}", label=label
            )
    panel.set_xticks(range(len(labels)), labels, fontsize=7, rotation=20, ha="right")
    panel.set_ylim(0.0, 1.02)
    panel.set_ylabel("F1")
    panel.grid(alpha=0.3)
    panel.legend(fontsize=8)
    save(figure, path)
    return True


def _lines(results: Results, name: str, out: Path) -> dict[str, list[tuple[Row, RowResult]]]:
    """Rows with a file of this name, by scene."""
    lines: dict[str, list[tuple[Row, RowResult]]] = {}
    for row, result in results:
        if result.folder is not None and (out / result.folder / name).is_file():
            line = lines.setdefault(row.scene, [])
            if len(line) < _MAX_COLUMNS:
                line.append((row, result))
    return dict(list(lines.items())[:_MAX_ROWS])


def _panels(n_rows: int, n_columns: int, size: tuple[float, float]) -> tuple[Any, Any]:
    """Canvas of Matplotlib and its empty panels of a size [inch], (n_rows, n_columns)."""
    figure = new_figure(size[0] * n_columns, size[1] * n_rows)
    panels = figure.subplots(n_rows, n_columns, squeeze=False)
    for panel in panels.ravel():
        panel.axis("off")
    return figure, panels


def _title(row: Row, result: RowResult) -> str:
    name = f"{row.how.title}, {row.case.label}" if row.case.label else row.how.title
    return f"{name[:38]}\nF1 5 mm {result.f1_5mm:.3f}" if result.f1_5mm is not None else name[:38]


def _picture(
    mesh: TriangleMesh, view: View, colour: tuple[float, float, float], num_threads: int | None
) -> NDArray[np.float32]:
    painter = MeshPainter(mesh, num_threads=num_threads)
    image = painter.render(view, np.tile(colour, (mesh.vertices.shape[0], 1)))
    return np.asarray(image[..., :3] * image[..., 3:] + 1.0 - image[..., 3:])


def _draw_cut(panel: Any, sdf: SdfGrid, truth: TriangleMesh, height_m: float) -> None:
    x, y, z = sdf.grid.axes_m
    index = int(np.clip(np.searchsorted(z, height_m), 0, z.size - 1))
    cut = 1e3 * sdf.values[:, :, index].T
    extent = [1e3 * float(v) for v in (x[0], x[-1], y[0], y[-1])]
    style = {"cmap": "RdBu_r", "vmin": -25.0, "vmax": 25.0, "interpolation": "bilinear"}
    panel.imshow(cut, origin="lower", extent=extent, **style)
    if cut.min() < 0.0 < cut.max():
        panel.contour(1e3 * x, 1e3 * y, cut, levels=[0.0], colors="black", linewidths=1.0)
    outline = plane_section(truth, 2, float(z[index]))
    panel.plot(
        1e3 * outline[:, :, 0].T, 1e3 * outline[:, :, 1].T, "-", color="#00a53c", linewidth=1.0
    )
    panel.set_aspect("equal")
    low, high = 1e3 * truth.vertices.min(axis=0), 1e3 * truth.vertices.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * float((high - low)[:2].max()) + _CUT_MARGIN_MM
    panel.set_xlim(middle[0] - half, middle[0] + half)
    panel.set_ylim(middle[1] - half, middle[1] + half)
