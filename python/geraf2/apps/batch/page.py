"""batch.html and batch.csv: a row for each scene, failed ones first."""

import csv
import io
from collections.abc import Mapping
from html import escape
from urllib.parse import quote

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
_STYLE = """<style>
#jobs th { cursor: pointer; } #jobs td { vertical-align: middle; }
#jobs .text { text-align: left; } #jobs td.error { min-width: 16rem; overflow-wrap: anywhere; }
#jobs td.name { min-width: 8rem; max-width: 20rem; overflow-wrap: anywhere; }
#jobs img { width: 64px; height: 64px; display: block; }
#jobs tr.failed td { background: var(--alert-paper); }
</style>"""
# A click on a column head sorts by it, a second click reverses; numbers sort as numbers.
_SORT = """<script>
document.querySelectorAll("#jobs th").forEach((head, column) => head.onclick = () => {
  const body = document.querySelector("#jobs tbody"), up = head.dataset.up !== "1";
  head.dataset.up = up ? "1" : "0";
  const key = row => row.cells[column].dataset.key ?? row.cells[column].textContent;
  const order = (a, b) => (a === "") - (b === "") ||
    (up ? 1 : -1) * (a === "" ? 0 : isNaN(a) || isNaN(b) ? a.localeCompare(b) : a - b);
  [...body.rows].sort((a, b) => order(key(a), key(b))).forEach(row => body.append(row));
});
</script>"""


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
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [name for name, _, _ in _NUMBERS]
    writer.writerow(["scene", "state", "preset", *names, "warnings", "error", "worker", "run"])
    for paths, result in pairs:
        numbers = [_number(result, name, digits + 2) for name, _, digits in _NUMBERS]
        run = str(paths.run.relative_to(paths.out))
        if result is None:
            writer.writerow([paths.scene, TO_DO, "", *numbers, "", "", "", run])
            continue
        end = [len(result.warnings), result.error, result.worker, run]
        writer.writerow([paths.scene, result.state, result.preset, *numbers, *end])
    return text.getvalue()


def _as_html(folder: BatchFolder, pairs: list[tuple[JobPaths, JobResult | None]]) -> str:
    ranks = [_rank(result) for _, result in pairs]
    used = [e for e in _NUMBERS if any(_number(result, e[0], e[2]) for _, result in pairs)]
    facts = html.facts(
        [
            ("scenes", str(len(pairs))),
            ("done", str(ranks.count(2))),
            ("failed", str(ranks.count(0))),
            (TO_DO, str(ranks.count(1))),
        ]
    )
    heads = ["", "scene", "state", *(title for _, title, _ in used), "warnings", "error"]
    kinds = dict.fromkeys(("scene", "state", "error"), ' class="text"')
    head = "".join(f'<th scope="col"{kinds.get(h, "")}>{escape(h)}</th>' for h in heads)
    rows = "".join(_row(paths, result, used) for paths, result in pairs)
    table = (
        f'<div class="scroll"><table id="jobs"><thead><tr>{head}</tr></thead>'
        f"<tbody>{rows}</tbody></table></div>"
    )
    return html.page(f"geraf2 batch {folder.out.name}", [_STYLE, facts, table, _SORT])


def _row(paths: JobPaths, result: JobResult | None, used: list[tuple[str, str, int]]) -> str:
    run = paths.run.relative_to(paths.out)
    picture = ""
    if is_file(paths.picture):
        source = quote(str(paths.picture.relative_to(paths.out)))
        picture = f'<img loading="lazy" alt="{escape(paths.scene)}" src="{source}">'
    name = escape(paths.scene)
    if result is not None:
        page = run / REPORT_NAME if is_file(paths.run / REPORT_NAME) else run
        name = f'<a href="{quote(str(page))}">{name}</a>'
    warnings = result.warnings if result else ()
    cells = [
        f"<td>{picture}</td>",
        f'<td class="text name" data-key="{escape(paths.scene)}">{name}</td>',
        f'<td class="text">{escape(result.state if result else TO_DO)}</td>',
        *(f"<td>{_number(result, name, digits)}</td>" for name, _, digits in used),
        f'<td title="{escape(chr(10).join(warnings))}">{len(warnings) or ""}</td>',
        f'<td class="text error" title="{escape(chr(10).join(result.log_tail if result else ()))}">'
        f"{escape(result.error if result else '')}</td>",
    ]
    kind = ' class="failed"' if _rank(result) == 0 else ""
    return f"<tr{kind}>{''.join(cells)}</tr>\n"
