"""HTML pages in one file, from the jinja2 templates of `templates/`, without network."""

import base64
import json
from collections.abc import Container, Iterable, Mapping, Sequence
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geraf2 import __version__
from geraf2._types import AnyPath

if TYPE_CHECKING:
    from jinja2 import Environment

_TEMPLATES = Path(__file__).parent / "templates"
_SCRIPTS = Path(__file__).parent / "viewer"
_SCRIPT_NAMES = ("geometry.js", "data.js", "draw.js", "controls.js", "viewer.js")
# Of pictures in pages: a third of the bytes of PNG, lines and letters still sharp.
_QUALITY = 88

Cell = str
"""Text of a table's cell, not yet escaped."""


@cache
def _environment() -> "Environment":
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # noqa: PLC0415 - takes 0.1 s

    return Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def rendered(template: str, **context: Any) -> str:
    """Render a template."""
    return _environment().get_template(template).render(version=__version__, **context)


def safe(text: str) -> str:
    """Mark a text as HTML, so that a template does not escape it."""
    from markupsafe import Markup  # noqa: PLC0415 - as above

    return Markup(text)


def _part(name: str, *arguments: Any) -> str:
    """HTML of a macro of `parts.html`."""
    return str(getattr(_environment().get_template("parts.html").module, name)(*arguments)).strip()


def page(title: str, body: Iterable[str]) -> str:
    """HTML document around HTML sections."""
    return rendered("page.html", title=title, body=safe("\n".join(body)))


def scripts() -> str:
    """JavaScript of the 3D view, for a script element."""
    texts = [(_SCRIPTS / name).read_text(encoding="utf-8") for name in _SCRIPT_NAMES]
    return safe('(() => {\n"use strict";\n' + "\n".join(texts) + "})();")


def facts(items: Sequence[tuple[str, str]]) -> str:
    """Row of headline numbers, (name, value)."""
    return _part("facts", items)


def table(
    caption: str, head: Sequence[Cell], rows: Iterable[Sequence[Cell]], *, text: bool = False
) -> str:
    """Table with a caption; numbers are aligned right unless `text`."""
    return _part("table", caption, list(head), list(rows), text)


def file_table(files: Sequence[tuple[str, str, str, str]]) -> str:
    """Table of links to files: (path, contents, size, digest)."""
    return _part("file_table", files)


def grouped_table(
    head: Sequence[Cell],
    rows: Sequence[Sequence[Cell]],
    *,
    n_names: int,
    n_group: int,
    best: Container[tuple[int, int]] = (),
) -> str:
    """Table with groups of rows whose first `n_group` cells are equal, and shown once.

    The first `n_names` columns are names, aligned left; cells (row, column) of `best` are bold.
    Scrolls sideways where the page is narrow.
    """
    lines = []
    for r, row in enumerate(rows):
        starts = r == 0 or tuple(row[:n_group]) != tuple(rows[r - 1][:n_group])
        shown = (cell if starts or c >= n_group else "" for c, cell in enumerate(row))
        lines.append((starts, [(cell, (r, c) in best) for c, cell in enumerate(shown)]))
    return _part("grouped_table", list(head), lines, n_names)


def contents(entries: Sequence[tuple[str, str]]) -> str:
    """Links to headings of the page, (id, text)."""
    return _part("contents", entries)


def picture(
    path: AnyPath, caption: str, *, max_width_px: int | None = None, alt: str | None = None
) -> str:
    """Embedded picture; `alt` describes it in words, the caption by default."""
    return _part("picture", _source(path), caption, max_width_px, alt or caption)


def _source(path: AnyPath) -> str:
    """Return the data URL of a picture, as WebP where Pillow supports it and it is smaller."""
    from PIL import Image, features  # noqa: PLC0415 - takes 0.1 s

    kind, data = "png", Path(path).read_bytes()
    if features.check("webp"):
        stream = BytesIO()
        with Image.open(path) as image:
            image.convert("RGB").save(stream, format="WEBP", quality=_QUALITY, method=2)
        if stream.tell() < len(data):
            kind, data = "webp", stream.getvalue()
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


def warning(text: str) -> str:
    """Paragraph of a warning."""
    return _part("warning", text)


def definitions(entries: Mapping[str, str]) -> str:
    """List of terms and their definitions."""
    return _part("definitions", entries)


def preformatted(text: str) -> str:
    """Preformatted text."""
    return _part("preformatted", text)


def millimetres(value_m: float | None) -> str:
    """Length in mm with two decimals; n/a for None."""
    return "n/a" if value_m is None else f"{1e3 * value_m:.2f}"


def metrics_section(metrics: Mapping[str, Any]) -> list[str]:
    """Tables of the metrics of `geraf2.evaluation.write_metrics`."""
    scores = table(
        "Matched within a threshold",
        ("threshold [mm]", "F1", "precision", "recall"),
        [
            (
                f"{1e3 * score['threshold_m']:g}",
                *(f"{score[name]:.4f}" for name in ("f1", "precision", "recall")),
            )
            for score in metrics["scores"]
        ],
    )
    distances = _distance_table(metrics)
    overall = table(
        "Over all",
        ("", "this mesh", "truth against itself"),
        [
            (
                "Chamfer distance [1e-3 m²]",
                f"{metrics['chamfer_1e3_m2']:.4f}",
                f"{metrics['floor_chamfer_1e3_m2']:.4f}",
            ),
            (
                "median, both directions [mm]",
                millimetres(metrics["both_ways"]["median_m"]),
                millimetres(metrics["floor_median_m"]),
            ),
            (
                "offset along the normal, median, positive outside [mm]",
                millimetres(metrics["surface_bias_m"]),
                "",
            ),
            *_size_rows(metrics.get("size")),
        ],
    )
    parts = [scores, overall, distances, sight_table(metrics), forecast_table(metrics)]
    return [f'<div class="tables">{"".join(parts)}</div>']


def _size_rows(size: Mapping[str, Any] | None) -> list[tuple[str, str, str]]:
    """Rows of volume and extents; none for metrics of a version without them."""
    if size is None:
        return []
    ratio = size["volume_ratio"]
    errors = " / ".join(f"{1e3 * error:+.2f}" for error in size["extent_errors_m"])
    return [
        ("volume over the true one", "not closed" if ratio is None else f"{ratio:.3f}", ""),
        ("error of the extents x / y / z [mm]", errors, ""),
    ]


def forecast_table(metrics: Mapping[str, Any]) -> str:
    """Table of expected and true errors, over all and by evidence of the surface."""
    held = metrics.get("expected_error")
    if not held:
        return ""
    over_all = {"evidence": "all", "area_fraction": 1.0, **held}
    over_all["median_m"] = metrics["surface_mesh_to_truth"]["median_m"]
    return table(
        f"Expected error; rank correlation with the true one {held['rank_correlation']:.2f}",
        (
            "rests on",
            "of the area [%]",
            "expected, median [mm]",
            "true, median [mm]",
            "within one sigma [%]",
            "within two [%]",
        ),
        [
            (
                part["evidence"],
                f"{100 * part['area_fraction']:.0f}",
                millimetres(part["expected_m"]),
                millimetres(part["median_m"]),
                f"{100 * part['within_one']:.0f}",
                f"{100 * part['within_two']:.0f}",
            )
            for part in (over_all, *held["parts"])
        ],
    )


def sight_table(metrics: Mapping[str, Any]) -> str:
    """Table of the scores of the visible and the invisible parts of the truth."""
    parts = metrics.get("by_sight") or []
    if not parts:
        return ""
    rows = []
    for part in parts:
        distance = part["surface_truth_to_mesh"]
        rows.append(
            (
                part["part"],
                f"{100 * part['area_fraction']:.0f}",
                *(f"{score['f1']:.3f}" for score in part["scores"]),
                millimetres(distance and distance["median_m"]),
            )
        )
    names = [f"F1 {1e3 * score['threshold_m']:g} mm" for score in parts[0]["scores"]]
    head = ("part of the truth", "share of the area [%]", *names, "median [mm]")
    return table("What the scan could see, and the rest", head, rows)


def _distance_table(metrics: Mapping[str, Any]) -> str:
    names = {
        "mesh_to_truth": "mesh to truth, sampled",
        "truth_to_mesh": "truth to mesh, sampled",
        "both_ways": "both directions, sampled",
        "surface_mesh_to_truth": "mesh to truth, exact",
        "surface_truth_to_mesh": "truth to mesh, exact",
    }
    columns = ("median_m", "p95_m", "mean_m", "max_m")
    return table(
        "Distances [mm]",
        ("", "median", "95 %", "mean", "largest"),
        [
            (label, *(millimetres(metrics[key][column]) for column in columns))
            for key, label in names.items()
        ],
    )


def scalar_rows(values: Mapping[str, Any], skip: Container[str] = ()) -> list[tuple[str, str]]:
    """Plain values of a mapping as rows of text, nested ones by dotted name."""
    rows: list[tuple[str, str]] = []
    for key, value in values.items():
        if key in skip or value is None:
            continue
        if isinstance(value, Mapping):
            rows += [(f"{key}.{name}", text) for name, text in scalar_rows(value)]
        elif isinstance(value, float):
            rows.append((key, f"{value:.6g}"))
        elif isinstance(value, str | int | bool):
            rows.append((key, str(value)))
        else:
            rows.append((key, json.dumps(value)))
    return rows
