"""Page of many runs: a row for each."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from geraf2.apps.batch.folder import DONE, JobPaths, JobResult
from geraf2.io.atomic import write_text_atomic
from geraf2.io.objects import is_file
from geraf2.io.run_folder import CONTENT_NAME, REPORT_NAME, RUN_NAME
from geraf2.io.verdict import Trust
from geraf2.report import html

TO_DO = "to do"
_SHOWN = ("error", "verdict", "because", "do")
# Share of the time of a running batch that is spent on its page.
_TIME_SHARE = 0.02
# Field of a record, of its numbers or scores; title; digits.
NUMBERS = (
    ("typical_error_mm", "typical error [mm]", 2),
    ("not_seen_percent", "not seen [%]", 0),
    ("f1_5mm", "F1 5 mm", 3),
    ("f1_2mm", "F1 2 mm", 3),
    ("chamfer_1e3_m2", "CD [1e-3 m²]", 4),
    ("volume_ratio", "volume / true", 3),
    ("offset_mm", "offset [mm]", 2),
    ("seconds", "time [s]", 1),
    ("peak_memory_mib", "memory [MiB]", 0),
)


@dataclass
class Pages:
    """Page of a folder, drawn again while results come."""

    out: Path
    title: str
    stem: str = "batch"
    """Of the file."""
    numbers: Sequence[tuple[str, str, int]] = NUMBERS
    n_latest: int | None = None
    """Rows of the page: so many with the last names, or all with failed ones first when None."""
    _drawn_s: float = field(default_factory=time.monotonic)
    _draw_s: float = 0.0

    def draw_sometimes(
        self, paths: Callable[[], Sequence[JobPaths]], known: Mapping[str, JobResult]
    ) -> None:
        """Write the page, unless that would exceed a share of the time."""
        if self._draw_s <= _TIME_SHARE * (time.monotonic() - self._drawn_s):
            self.draw(paths(), known)

    def draw(self, paths: Sequence[JobPaths], known: Mapping[str, JobResult]) -> None:
        """Write the page for jobs; known: results by key."""
        start = time.monotonic()
        rows = [self._row(own, known.get(own.key) or own.read()) for own in paths]
        rows.sort(key=lambda row: str(row["scene"]))
        order = f"The last {self.n_latest}, the latest first"
        if self.n_latest is None:
            order = "Failed scenes come first"
            rows.sort(key=lambda row: {TO_DO: 1, DONE: 2}.get(row["state"], 0))
        if self.n_latest is not None:
            rows = rows[: -self.n_latest - 1 : -1]
        write_text_atomic(self.out / f"{self.stem}.html", self._as_html(order, rows))
        self._drawn_s = time.monotonic()
        self._draw_s = self._drawn_s - start

    def _row(self, paths: JobPaths, result: JobResult | None) -> dict[str, Any]:
        """Entries of a row."""
        found = {} if result is None else {**vars(result), **result.numbers, **result.scores}
        row = {
            name: f"{found[name]:.{digits}f}" if name in found else ""
            for name, _, digits in self.numbers
        }
        return {
            **row,
            **{name: "" if (v := found.get(name)) is None else v for name in _SHOWN},
            "scene": paths.scene,
            "state": found.get("state", TO_DO),
            "warnings": str(len(found["warnings"])) if found else "",
            "paths": paths,
            "result": result,
        }

    def _as_html(self, order: str, rows: Sequence[Mapping[str, Any]]) -> str:
        states = [row["state"] for row in rows]
        used = [e for e in self.numbers if any(row[e[0]] for row in rows)]
        titles = [title for _, title, _ in used]
        n_done, n_to_do = states.count(DONE), states.count(TO_DO)
        trusts = [row["verdict"] for row in rows]
        return html.render_template(
            "batch.html",
            title=self.title,
            order=order,
            facts=[
                ("scenes", len(rows)),
                ("done", n_done),
                *((trust, trusts.count(trust)) for trust in Trust if any(trusts)),
                ("failed", len(rows) - n_done - n_to_do),
                (TO_DO, n_to_do),
            ],
            numbers=titles,
            heads=["scene", "state", "verdict", *titles, "warnings", "error or doubt"],
            states=sorted(set(states)),
            jobs=[
                {
                    **row,
                    "failed": row["state"] not in (DONE, TO_DO),
                    "page": _link(row["paths"]),
                    "numbers": [row[name] for name, _, _ in used],
                }
                for row in rows
            ],
        )


def _link(paths: JobPaths) -> str:
    """File of the run that its name leads to; empty where there is none."""
    names = (REPORT_NAME, CONTENT_NAME, RUN_NAME)
    found = (paths.run / name for name in names if is_file(paths.run / name))
    return next((str(path.relative_to(paths.out)) for path in found), "")
