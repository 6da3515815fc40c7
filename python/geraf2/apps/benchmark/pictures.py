"""Pictures of a benchmark: surfaces, and scores over a setting."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geraf2.apps.benchmark.rows import Row, RowResult
from geraf2.apps.benchmark.suite import Experiment
from geraf2.geometry.transforms import triple
from geraf2.io.container import TRUTH_NAME
from geraf2.io.mesh import TriangleMesh, read_mesh
from geraf2.io.run_folder import CONTENT_NAME
from geraf2.report.canvas import new_figure, save
from geraf2.report.render import MeshPainter, View

_GREY, _BLUE = (0.72, 0.72, 0.72), (0.45, 0.62, 0.85)
_MAX_COLUMNS, _MAX_ROWS = 8, 9
_N_PIXELS = 220

Results = Sequence[tuple[Row, RowResult]]


def draw_gallery(
    path: Path, out: Path, results: Results, *, num_threads: int | None = None
) -> bool:
    """Draw truth and meshes, a line of pictures for each scene; False where there is none.

    path: PNG to write. out: folder of the benchmark. results: rows of one experiment.
    num_threads: of the ray tracer; all when None.
    """
    lines = _lines(results, out)
    if not lines:
        return False
    n_columns = 1 + max(map(len, lines.values()))
    figure = new_figure(1.9 * n_columns, 2.1 * len(lines))
    panels = figure.subplots(len(lines), n_columns, squeeze=False)
    for panel in panels.ravel():
        panel.axis("off")
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


def _lines(results: Results, out: Path) -> dict[str, list[tuple[Row, RowResult]]]:
    """Rows with a mesh, by scene."""
    lines: dict[str, list[tuple[Row, RowResult]]] = {}
    for row, result in results:
        if result.folder is not None and (out / result.folder / CONTENT_NAME).is_file():
            line = lines.setdefault(row.scene, [])
            if len(line) < _MAX_COLUMNS:
                line.append((row, result))
    return dict(list(lines.items())[:_MAX_ROWS])


def _title(row: Row, result: RowResult) -> str:
    name = f"{row.how.title}, {row.case.label}" if row.case.label else row.how.title
    return f"{name[:38]}\nF1 5 mm {result.f1_5mm:.3f}" if result.f1_5mm is not None else name[:38]


def _picture(
    mesh: TriangleMesh, view: View, colour: tuple[float, float, float], num_threads: int | None
) -> NDArray[np.float32]:
    painter = MeshPainter(mesh, num_threads=num_threads)
    image = painter.render(view, np.tile(colour, (mesh.vertices.shape[0], 1)))
    return np.asarray(image[..., :3] * image[..., 3:] + 1.0 - image[..., 3:])
