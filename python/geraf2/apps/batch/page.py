"""batch.html and batch.csv: a row for each scene, failed ones first."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
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
from geraf2.io.objects import is_file, read_bytes
from geraf2.io.regular import RECORD_BYTES
from geraf2.io.run_folder import CONTENT_NAME, INSPECTION_NAME, REPORT_NAME, RUN_NAME
from geraf2.io.text import csv_text, parse_json
from geraf2.report import html

TO_DO = "to do"
# Field of a record, of its numbers or scores; title on the page, where it has one; digits.
_NUMBERS = (
    ("typical_error_mm", "typical error [mm]", 2),
    ("not_seen_percent", "not seen [%]", 0),
    ("f1_5mm", "F1 5 mm", 3),
    ("f1_3mm", "", 3),
    ("f1_2mm", "F1 2 mm", 3),
    ("chamfer_1e3_m2", "CD [1e-3 m²]", 4),
    ("volume_ratio", "volume / true", 3),
    ("extent_x_mm", "", 1),
    ("extent_y_mm", "", 1),
    ("extent_z_mm", "", 1),
    ("offset_mm", "offset [mm]", 2),
    ("rms_deviation_mm", "rms from CAD [mm]", 2),
    ("seconds", "time [s]", 1),
    ("cpu_seconds", "", 1),
    ("peak_memory_mib", "memory [MiB]", 0),
    ("attempts", "", 0),
)


def write_pages(folder: BatchFolder, known: Mapping[str, JobResult]) -> None:
    """Write both files for all jobs of a batch; known: results by key."""
    rows = [_Row.read(paths, known.get(paths.key) or paths.read()) for paths in folder.all_paths()]
    rows.sort(key=lambda row: (row.rank, row.paths.scene))
    write_text_atomic(folder.out / TABLE_NAME, _as_csv(rows))
    title = f"geraf2 batch {folder.out.name}"
    page = _as_html(title, "Failed scenes come first", rows)
    write_text_atomic(folder.out / PAGE_NAME, page)


def write_last(out: Path, name: str, last: Sequence[JobPaths]) -> None:
    """Write the page of a belt with some of its parcels, the latest first."""
    paths = sorted(last, key=lambda own: own.scene, reverse=True)
    rows = [_Row.read(own, own.read()) for own in paths]
    page = _as_html(f"geraf2 belt {out.name}", f"The last {len(rows)}, the latest first", rows)
    write_text_atomic(out / name, page)


@dataclass(frozen=True, kw_only=True)
class _Row:
    paths: JobPaths
    result: JobResult | None
    verdict: str = ""
    """Of its inspection."""
    numbers: Mapping[str, float] = field(default_factory=dict)
    """Of the mesh, of its inspection, and against the truth."""

    @classmethod
    def read(cls, paths: JobPaths, result: JobResult | None) -> "_Row":
        if result is None:
            return cls(paths=paths, result=None)
        verdict, inspected = _inspection(paths)
        numbers = {**result.numbers, **result.scores, **inspected}
        return cls(paths=paths, result=result, verdict=verdict, numbers=numbers)

    @property
    def rank(self) -> int:
        """Failed ones first, then those to do."""
        if self.result is None:
            return 1
        return 2 if self.result.state == DONE else 0

    def number(self, name: str, digits: int) -> str:
        """Text of a number; empty where it is unknown."""
        value = self.numbers.get(name, getattr(self.result, name, None))
        return "" if value is None else f"{value:.{digits}f}"

    def link(self, name: str) -> str:
        """File of the run beside the page; empty where it does not exist."""
        path = self.paths.run / name
        return str(path.relative_to(self.paths.out)) if is_file(path) else ""


def _inspection(paths: JobPaths) -> tuple[str, dict[str, float]]:
    """Verdict and deviation of the inspection of a run; "" where there is none that can be read."""
    try:
        values = parse_json(read_bytes(paths.run / f"{INSPECTION_NAME}.json", RECORD_BYTES))
        deviations = [model.get("deviation") or {} for model in values["models"]]
        found = [1e3 * float(one["rms_m"]) for one in deviations if "rms_m" in one]
        return str(values["verdict"]), {"rms_deviation_mm": max(found)} if found else {}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return "", {}


def _as_csv(rows: Sequence[_Row]) -> str:
    names = [name for name, _, _ in _NUMBERS]
    lines: list[list[object]] = []
    for row in rows:
        result, paths = row.result, row.paths
        numbers = [row.number(name, digits + 2) for name, _, digits in _NUMBERS]
        run = str(paths.run.relative_to(paths.out))
        start, end = [paths.scene, TO_DO, ""], ["", "", ""]
        if result is not None:
            start = [paths.scene, result.state, result.preset]
            end = [str(len(result.warnings)), result.error, result.worker]
        lines.append([*start, row.verdict, *numbers, *end, run])
    head = ["scene", "state", "preset", "inspection", *names, "warnings", "error", "worker", "run"]
    return csv_text(head, lines)


def _as_html(title: str, order: str, rows: Sequence[_Row]) -> str:
    ranks = [row.rank for row in rows]
    used = [e for e in _NUMBERS if e[1] and any(row.number(e[0], e[2]) for row in rows)]
    counts = {
        "scenes": len(rows),
        "done": ranks.count(2),
        "failed": ranks.count(0),
        TO_DO: ranks.count(1),
    }
    verdicts = [row.verdict for row in rows if row.verdict]
    if verdicts:
        counts |= {"passed inspection": verdicts.count("pass")}
        counts |= {"did not pass": verdicts.count("fail")}
    return html.render_template(
        "batch.html",
        title=title,
        order=order,
        facts=counts.items(),
        numbers=[name for _, name, _ in used],
        inspected=bool(verdicts),
        heads=[
            "scene",
            "state",
            *["inspection"] * bool(verdicts),
            *(name for _, name, _ in used),
            "warnings",
            "error",
        ],
        states=sorted({TO_DO if row.result is None else row.result.state for row in rows}),
        jobs=[_job(row, used) for row in rows],
    )


def _job(row: _Row, used: Sequence[tuple[str, str, int]]) -> dict[str, Any]:
    picture = row.paths.picture
    return {
        "scene": row.paths.scene,
        "result": row.result,
        "failed": row.rank == 0,
        "page": row.link(REPORT_NAME) or row.link(CONTENT_NAME) or row.link(RUN_NAME),
        "verdict": row.verdict,
        "inspection": row.link(f"{INSPECTION_NAME}.html"),
        "picture": str(picture.relative_to(row.paths.out)) if is_file(picture) else "",
        "numbers": [row.number(name, digits) for name, _, digits in used],
    }
