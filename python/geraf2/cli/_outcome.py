"""What a run found and how far it can be trusted, in a few lines and as numbers."""

from collections.abc import Mapping
from shlex import quote
from typing import Any

from geraf2.cli._console import keep, rows
from geraf2.io.run_folder import CONTENT_NAME, PRIOR_NAME
from geraf2.io.verdict import WITHDRAWN, Trust, Verdict, confidence, not_determined
from geraf2.pipeline.reconstruction import Reconstruction
from geraf2.surfaces.pieces import ghost_texts
from geraf2.surfaces.samples import size_lines
from geraf2.surfaces.stated_score import score_text

EXIT_NO = 3
"""The answer is no: failed, changed, or, with `--strict`, not to be trusted."""
_KEPT = (
    "n_pieces",
    "extents_mm",
    "center_mm",
    "volume_cm3",
    "expected_error_median_mm",
    "expected_error_95_percent_mm",
    "evidence_shares",
    "likely_ghosts",
)


def print_found(result: Reconstruction) -> None:
    """Print what a run found, and keep it for `--json`."""
    mesh, verdict = result.numbers.get("mesh", {}), result.verdict
    score = result.stated_f1
    stated = [] if score is None else [("stated F1", score_text(score))]
    rows([*found_lines(mesh, verdict), *stated, *size_lines(mesh, confidence(verdict))])
    keep({"stated_f1_5mm": score} | {name: mesh[name] for name in _KEPT if name in mesh})
    if verdict is not None and not_determined(verdict):
        keep({name: None for name in _KEPT if name in WITHDRAWN})
        keep({"not_determined": verdict.reason})
    keep({"out": str(result.path), "content": str(result.path / CONTENT_NAME)})
    keep({"report": None if result.report is None else str(result.report)})
    if (result.path / PRIOR_NAME).is_file():
        prior = result.prior
        size_m = prior.size_m if prior.cuboid is None else prior.cuboid[1].tolist()
        by_radar = result.numbers.get("box")
        keep({"box": {"size_m": size_m, "center_m": prior.center_m, "by_radar": by_radar}})


def print_next(result: Reconstruction) -> None:
    """Print where the surface and the report of a run are, and the command to go on with.

    A result that is not to be trusted has the next step in its verdict.
    """
    found = [("content", str(result.path / CONTENT_NAME))]
    if result.report is not None:
        found.append(("report", str(result.report)))
    if not not_determined(result.verdict):
        found.append(("next", f"geraf2 view {quote(str(result.path))}"))
    rows(found)


def print_verdict(verdict: Verdict | None, *, strict: bool = False) -> int:
    """Print the verdict, which ends the output of a command, and keep it for `--json`.

    Returns the exit code: EXIT_NO for a result that is not to be trusted, if `strict`.
    """
    if verdict is None:
        return 0
    rows(list(verdict.lines), style=None if verdict.trust is Trust.RELIABLE else "yellow")
    keep({"verdict": verdict.numbers()})
    return EXIT_NO if strict and not_determined(verdict) else 0


def found_lines(mesh: Mapping[str, Any], verdict: Verdict | None) -> list[tuple[str, str]]:
    """Name and text of what a run found; [] of a run without a surface.

    mesh: numbers of the stage `mesh` in run.json, as stated.
    """
    if "n_pieces" not in mesh:
        return []
    n = mesh["n_pieces"]
    sides, center = (
        mark.join(f"{v:z.0f}" for v in mesh[name])
        for name, mark in (("extents_mm", " x "), ("center_mm", ", "))
    )
    pieces = "one object" if n == 1 else f"{n} separate pieces"
    lines = [("found", f"{pieces}, {sides} mm, centre at ({center}) mm")]
    if "evidence_shares" in mesh:
        error = not_determined(verdict)
        if not error:
            half, most = mesh["expected_error_median_mm"], mesh["expected_error_95_percent_mm"]
            error = f"{half:.1f} mm; 95 % of the surface below {most:.1f} mm"
            error += verdict.condition if verdict else ""
        lines.append(("typical error", error))
        shares = mesh["evidence_shares"]
        text = f"{100 * (1 - shares['seen'] - shares['outline']):.0f} % of the surface"
        if shares["outline"] > 0.005:
            text += f"; {100 * shares['outline']:.0f} % more rests on an outline"
        lines.append(("not seen", text))
    return [*lines, *(("likely ghost", f"{text}, not counted") for text in ghost_texts(mesh))]
