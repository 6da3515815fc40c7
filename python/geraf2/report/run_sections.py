"""Sections of a run's report without pictures: numbers, files, settings, definitions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from geraf2 import __version__
from geraf2.echoes.ruled_out import describe_ruled_out, ruled_out_of, ruled_out_rows
from geraf2.errors import UserError
from geraf2.evaluation import MeshMetrics
from geraf2.io import run_folder
from geraf2.io.mesh import TriangleMesh
from geraf2.io.regular import TEXT_BYTES, read_regular
from geraf2.io.run_folder import StageRecord
from geraf2.io.text import parse_json
from geraf2.io.text import read_object as read_json
from geraf2.io.toml import parse_toml
from geraf2.report import html
from geraf2.surfaces.expected_error import SEEN_ANGLE_RAD, SEEN_REACH_M
from geraf2.surfaces.isosurface import surface_report

_FILES = {
    run_folder.CONTENT_NAME: "surface of the content, with expected errors, metres",
    run_folder.GHOSTS_NAME: "pieces that likely do not exist, with probabilities, metres",
    "mesh_content.glb": "the same for 3D programs",
    run_folder.BOX_NAME: "the box around it",
    run_folder.MESH_NAME: "both together",
    run_folder.SDF_NAME: "signed distance on a grid",
    run_folder.GLINTS_NAME: "oriented points",
    run_folder.SILHOUETTES_NAME: "shadows on the far walls",
    run_folder.METRICS_NAME: "scores against the truth",
    run_folder.CONFIG_NAME: "settings, from which the run can be repeated",
    run_folder.RUN_NAME: "stages, their numbers and digests",
    run_folder.LOG_NAME: "log of the run",
}


@dataclass(frozen=True)
class Section:
    """A part of the report with a heading and an entry in the contents."""

    id: str
    """Anchor of the section."""
    title: str
    """Heading."""
    kind: Literal["plain", "answer"] = "plain"
    """Template of the section."""
    note: str = ""
    """Line below the heading."""
    parts: tuple[str, ...] = ()
    """HTML of `geraf2.report.html`."""
    folded: str = ""
    """Text to unfold the parts; not folded when empty."""


def read_object(path: Path, what: str) -> dict[str, Any]:
    """JSON object of a file, empty where there is none; UserError for anything else."""
    if not path.is_file():
        return {}
    try:
        return read_json(path)
    except UserError as error:
        why, hint = str(error).removeprefix(f"{path}: "), "remove the file or run the stage again"
        raise UserError(what=f"cannot read {what}: {why}", where=path, hint=hint) from error


def read_log(folder: Path) -> list[dict[str, Any]]:
    """Readable lines of log.jsonl; broken ones are ignored."""
    path = folder / run_folder.LOG_NAME
    if not path.is_file():
        return []
    entries: list[dict[str, Any]] = []
    for line in read_regular(path, TEXT_BYTES).decode(errors="replace").splitlines():
        try:
            entry = parse_json(line)
        except ValueError:
            continue
        if isinstance(entry, dict) and "event" in entry:
            entries.append(entry)
    return entries


def meta(scene: str, config_text: str | None, log: Sequence[Mapping[str, Any]]) -> list[str]:
    """Line below the title: scan, preset, date."""
    preset = _config(config_text).get("preset")
    started = _last(log, "start")
    date = str(started.get("time", "")).replace("T", " ").replace("Z", " UTC")
    items = [f"scan '{scene}'" if scene else "", f"preset {preset}" if preset else "", date]
    return [item for item in items if item]


def _last(log: Sequence[Mapping[str, Any]], event: str) -> Mapping[str, Any]:
    return next((entry for entry in reversed(log) if entry["event"] == event), {})


def _config(text: str | None) -> dict[str, Any]:
    try:
        return parse_toml(text or "")
    except ValueError:
        return {}


def losses(log: Sequence[Mapping[str, Any]]) -> dict[str, list[tuple[int, float]]]:
    """Terms of the loss by name: (step, value), the last one of repeated steps."""
    terms: dict[str, dict[int, float]] = {}
    for entry in log:
        if entry["event"] != "training" or not isinstance(entry.get("step"), int):
            continue
        for name in ("heatmap", "eikonal", "rsdf"):
            if isinstance(entry.get(name), int | float):
                terms.setdefault(name, {})[entry["step"]] = float(entry[name])
    return {name: sorted(curve.items()) for name, curve in terms.items() if len(curve) > 1}


def growth(log: Sequence[Mapping[str, Any]]) -> list[tuple[int, float, float]]:
    """Planes, expected error [mm] and seen share after each plane of a scan that was followed."""
    found: dict[int, tuple[float, float]] = {}
    for entry in log:
        plane, error, share = (entry.get(k) for k in ("plane", "expected_error_mm", "seen_share"))
        if entry["event"] != "plane" or not isinstance(plane, int):
            continue
        if isinstance(error, int | float) and isinstance(share, int | float):
            found[plane] = float(error), float(share)
    return [(plane, *found[plane]) for plane in sorted(found)]


def level_moved(log: Sequence[Mapping[str, Any]]) -> str:
    """Sentence on the shift of the zero level after a training; empty without glints."""
    shift = _last(log, "glint_level")
    inward_mm, n_glints = shift.get("inward_mm"), shift.get("glints")
    if not isinstance(inward_mm, int | float) or not n_glints:
        return ""
    side, less = ("inward", ", thin parts by less") if inward_mm > 0.0 else ("outward", "")
    return (
        f"After the training the surface was moved {side} by {abs(inward_mm):.1f} mm{less}, to the "
        f"depth of the {n_glints} brightest echoes."
    )


def ruled_out(numbers: Mapping[str, Any]) -> list[Section]:
    """Section on the smallest bodies that would have been found; empty where it is not known.

    numbers: of the stage `mesh`.
    """
    regions = ruled_out_of(numbers)
    if not regions:
        return []
    head = ["where", "metal ball [mm]", "plastic ball [mm]", "out of sight [%]"]
    found = describe_ruled_out(regions)
    note = (
        f"{found[0].upper()}{found[1:]}. A ball of more than the stated diameter would have been "
        "found at 95 % of the places."
    )
    parts = (html.part("table", "", head, ruled_out_rows(regions)),)
    return [Section("ruled-out", "What was ruled out", note=note, parts=parts)]


def tables(
    stages: Mapping[str, StageRecord], metrics: Mapping[str, Any], content: TriangleMesh | None
) -> list[Section]:
    """Sections on calibration, and on numbers of surface, fit and stages."""
    sections: list[Section] = []
    calibration = stages.get("calibration")
    found = {} if calibration is None else calibration.numbers
    if found.get("applied") or found.get("left"):
        note = (
            "Unknown parameters of the capture, with one standard uncertainty. Each is corrected "
            "only if held-out echoes fit better afterwards."
        )
        parts = (html.part("calibration", found),)
        sections.append(Section("calibration", "Calibration", note=note, parts=parts))
    about_file = ("mesh_digest", "format", "format_version", "generator")
    other = html.scalar_rows(metrics, {*MeshMetrics.__dataclass_fields__, *about_file})
    if content is not None or other or stages:
        surface = None if content is None else surface_report(content)
        numbers = html.part("numbers", surface, other, stages)
        note = "The mesh in numbers, and time and memory of each stage."
        sections.append(Section("numbers", "Numbers", note=note, parts=(numbers,)))
    return sections


def provenance(
    folder: Path,
    scene: tuple[str, str],
    digests: Mapping[str, str],
    known: Mapping[str, Any],
    log: Sequence[Mapping[str, Any]],
) -> list[Section]:
    """Section on the origin of data and result, the command to repeat it, and the files."""
    started = _last(log, "start")
    rows = [("report drawn by", f"geraf2 {__version__}")]
    if started:
        version, python = started.get("version", "?"), started.get("python", "?")
        rows.append(("run made by", f"geraf2 {version}, Python {python}"))
        rows.append(("run began", str(started.get("time", "?"))))
    made_from = read_object(folder / f"{run_folder.CONTENT_NAME}.json", "the mesh's record").get(
        "made_from"
    )
    if isinstance(made_from, dict):
        rows.append(("repeat it by", str(made_from.get("command", "?"))))
        rows.append(("prior, digest", str(made_from.get("prior", "?"))))
    if scene[0]:
        rows.append(("scene", f"{scene[0]}, digest {scene[1]}"))
    rows += [(str(name), str(text)) for name, text in known.items()]
    parts = [html.part("table", "", (), rows, text=True)]
    files = []
    for name, what in _FILES.items():
        if (folder / name).is_file():
            size = (folder / name).stat().st_size
            written = f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{max(1, round(size / 1e3))} kB"
            files.append((name, what, written, digests.get(name, "")))
    if files:
        parts.append(html.part("file_table", files))
    note = "Where data and result come from, and the command that repeats the run."
    return [Section("provenance", "Provenance and files", note=note, parts=tuple(parts))]


def settings(config_text: str | None, stages: Mapping[str, StageRecord]) -> list[Section]:
    """Section of the settings of the run, in folded tables."""
    if config_text is None:
        return []
    config = _config(config_text)
    if "los" not in stages:
        config.pop("photos", None)  # unused without photos
    groups: dict[str, list[tuple[str, str]]] = {}
    for name, text in html.scalar_rows(config):
        group, _, key = name.rpartition(".")
        groups.setdefault(group, []).append((key, text))
    body = html.part("settings", groups) if groups else html.part("preformatted", config_text)
    note, folded = "Settings, from which the run can be repeated.", "All settings of this run"
    return [Section("settings", "Configuration", note=note, parts=(body,), folded=folded)]


def definitions(stages: Mapping[str, StageRecord], content: TriangleMesh | None) -> list[Section]:
    """Section with definitions of the terms in this report."""
    found = content is not None
    expected = content is not None and content.expected_error_m is not None
    glints = "glints" in stages
    if not (glints or expected):
        return []
    seen_mm = 1e3 * SEEN_REACH_M if found and glints else None
    seen_deg = np.rad2deg(SEEN_ANGLE_RAD)
    terms = html.part("terms", glints, expected, seen_mm, seen_deg)
    note, folded = "Meaning of the words and numbers of this page.", "What the numbers mean"
    return [Section("definitions", "Definitions", note=note, parts=(terms,), folded=folded)]
