"""batch.html and batch.csv: a row for each scene, failed ones first."""

from collections.abc import Mapping
from typing import Any

from geraf2.apps.batch.folder import (
    DONE,
    PAGE_NAME,
    TABLE_NAME,
    BatchFolder,
    JobPaths,
    JobResult,
)
from geraf2.io.atomic import write_text_atomic
from geraf2.io.objects import is_file
from geraf2.io.run_folder import REPORT_NAME
from geraf2.io.text import csv_text
from geraf2.report import html

TO_DO = "to do"
# Field of a record or score, title, digits.
_NUMBERS = (
    ("f1_5mm", "F1 5 mm", 3),
    ("f1_3mm", "F1 3 mm", 3),
    ("f1_2mm", "F1 2 mm", 3),
    ("chamfer_1e3_m2", "CD [1e-3 m²]", 4),
    ("volume_ratio", "volume / true", 3),
    ("extent_x_mm", "extent x [mm]", 1),
    ("extent_y_mm", "extent y [mm]", 1),
    ("extent_z_mm", "extent z [mm]", 1),
    ("offset_mm", "offset [mm]", 2),
    ("seconds", "time [s]", 1),
    ("cpu_seconds", "CPU [s]", 1),
    ("peak_memory_mib", "memory [MiB]", 0),
    ("attempts", "attempts", 0),
)


def write_pages(folder: BatchFolder, known: Mapping[str, JobResult]) -> None:
    """Write both files for all jobs of a batch; known: results by key."""
    pairs = [(paths, known.get(paths.key) or paths.read()) for paths in folder.all_paths()]
    pairs.sort(key=lambda pair: (_rank(pair[1]), pair[0].scene))
    write_text_atomic(folder.out / TABLE_NAME, _as_csv(pairs))
    write_text_atomic(folder.out / PAGE_NAME, _as_html(folder, pairs))


def _rank(result: JobResult | None) -> int:
    if result is None:
        return 1
    return 2 if result.state == DONE else 0


def _number(result: JobResult | None, name: str, digits: int) -> str:
    if result is None:
        return ""
    value = result.scores.get(name, getattr(result, name, None))
    return "" if value is None else f"{value:.{digits}f}"


def _as_csv(pairs: list[tuple[JobPaths, JobResult | None]]) -> str:
    names = [name for name, _, _ in _NUMBERS]
    lines: list[list[object]] = []
    for paths, result in pairs:
        numbers = [_number(result, name, digits + 2) for name, _, digits in _NUMBERS]
        run = str(paths.run.relative_to(paths.out))
        if result is None:
            lines.append([paths.scene, TO_DO, "", *numbers, "", "", "", run])
            continue
        end = [len(result.warnings), result.error, result.worker, run]
        lines.append([paths.scene, result.state, result.preset, *numbers, *end])
    head = ["scene", "state", "preset", *names, "warnings", "error", "worker", "run"]
    return csv_text(head, lines)


def _as_html(folder: BatchFolder, pairs: list[tuple[JobPaths, JobResult | None]]) -> str:
    ranks = [_rank(result) for _, result in pairs]
    used = [e for e in _NUMBERS if any(_number(result, e[0], e[2]) for _, result in pairs)]
    counts = {
        "scenes": len(pairs),
        "done": ranks.count(2),
        "failed": ranks.count(0),
        TO_DO: ranks.count(1),
    }
    return html.rendered(
        "batch.html",
        title=f"geraf2 batch {folder.out.name}",
        facts=counts.items(),
        heads=["", "scene", "state", *(title for _, title, _ in used), "warnings", "error"],
        jobs=[_job(paths, result, used) for paths, result in pairs],
    )


def _job(
    paths: JobPaths, result: JobResult | None, used: list[tuple[str, str, int]]
) -> dict[str, Any]:
    page = paths.run / REPORT_NAME
    return {
        "scene": paths.scene,
        "result": result,
        "failed": _rank(result) == 0,
        "page": str((page if is_file(page) else paths.run).relative_to(paths.out)),
        "picture": str(paths.picture.relative_to(paths.out)) if is_file(paths.picture) else "",
        "numbers": [_number(result, name, digits) for name, _, digits in used],
    }
