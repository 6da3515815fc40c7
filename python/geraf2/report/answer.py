"""Summary of a run in sentences: content, size, expected errors, unseen surface."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from geraf2._types import Bools, Floats
from geraf2.echoes.glint_set import Glints
from geraf2.echoes.transparency import describe
from geraf2.geometry.triangles import vertex_areas, vertex_normals, volume_centroid_m
from geraf2.io.mesh import Evidence, TriangleMesh
from geraf2.io.text import NOT_DETERMINED
from geraf2.io.verdict import Verdict, confidence, not_determined
from geraf2.surfaces.expected_error import seen_vertices, typical_error_m
from geraf2.surfaces.isosurface import SurfaceReport, surface_report
from geraf2.surfaces.pieces import ghost_texts
from geraf2.surfaces.samples import size_lines
from geraf2.surfaces.stated_score import score_of, score_text

# Vertices this near to the extreme of the content define its end [m]: half of the usual voxel.
_END_REACH_M = 0.0015
# Normals within 45 degrees of the vertical face up or down.
_STEEP_COSINE = float(np.sqrt(0.5))
_MIN_SHARE = 0.005  # that is named
_ENDS = (("-x", "+x"), ("-y", "+y"), ("bottom", "top"))


@dataclass(frozen=True, kw_only=True)
class Card:
    """One of the three answers at the top of a report."""

    title: str
    """Question that it answers."""
    value: str
    """Number that answers it."""
    lines: tuple[str, ...] = ()
    """Sentences below it."""
    shares: tuple[tuple[str, float], ...] = ()
    """Parts of the surface by evidence, with their share of the area."""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Summary at the top of a report."""

    found: str
    """Content and its size."""
    cards: tuple[Card, ...] = ()
    """Size, certainty, unseen surface."""
    scores: tuple[tuple[str, str], ...] = ()
    """Scores against the truth, (name, value)."""
    corrected: tuple[str, ...] = ()
    """Names of the effects that calibration corrected."""
    notes: tuple[str, ...] = ()
    """Sentences on a box that the radar found, and on content that is a dielectric."""


def answer_of(
    content: TriangleMesh | None,
    glints: Glints | None,
    numbers: Mapping[str, Mapping[str, Any]],
    metrics: Mapping[str, Any],
    verdict: Verdict | None = None,
) -> Answer:
    """Summarise a run.

    content, glints: results of the run; None where missing.
    numbers: results of each stage, by its name, without those that the verdict withdraws.
    metrics: scores against the truth, if any.
    """
    applied = numbers.get("calibration", {}).get("applied", ())
    corrected = tuple(str(text).partition(":")[0] for text in applied)
    box, inside = numbers.get("box", {}).get("by_radar", ""), describe(numbers.get("glints", {}))
    notes = tuple(f"{text[0].upper()}{text[1:]}." for text in (box, inside) if text)
    if content is None or not content.faces.shape[0]:
        found = "Nothing was found in the box: the surface is empty."
        if content is None:
            found = "Nothing has been reconstructed in this folder yet."
        return Answer(found=found, corrected=corrected, notes=notes)
    report = surface_report(content)
    seen = seen_vertices(content, glints)
    sizes = dict(size_lines(numbers.get("mesh", {}), confidence(verdict)))
    cards = [_size(content, report, sizes)]
    if content.expected_error_m is not None:
        cards.append(_certainty_card(content, verdict))
    if seen is not None:
        outlines = bool(numbers.get("outlines", {}).get("outlines"))
        cards.append(_unseen_card(content, seen, outlines))
    ghosts = "; ".join(ghost_texts(numbers.get("mesh", {})))
    not_counted = f" Likely ghosts, not counted: {ghosts}." if ghosts else ""
    return Answer(
        found=_describe_content(content, report) + not_counted,
        cards=tuple(cards),
        scores=tuple(_scores(metrics)) if "scores" in metrics else (),
        corrected=corrected,
        notes=notes,
    )


def _sides(content: TriangleMesh) -> str:
    return " x ".join(f"{side:.0f}" for side in 1e3 * np.ptp(content.vertices, axis=0)) + " mm"


def _size(content: TriangleMesh, report: SurfaceReport, intervals: Mapping[str, str]) -> Card:
    lines = ["Along x, y and z."]
    if intervals:
        lines.append(f"Intervals: {intervals['size x, y, z']}, volume {intervals['volume']}.")
    elif report.volume_m3 is not None:
        lines.append(f"Volume {1e6 * report.volume_m3:.0f} cm³.")
    return Card(title="Size", value=_sides(content), lines=tuple(lines))


def _certainty_card(content: TriangleMesh, verdict: Verdict | None) -> Card:
    """Card of the expected error."""
    title, why = "How sure", not_determined(verdict)
    if why:
        hint = "The expected errors in the mesh, and their colours here, do not hold."
        why = why.removeprefix(f"{NOT_DETERMINED}, b")
        return Card(title=title, value=NOT_DETERMINED, lines=(f"B{why}.", hint))
    most, condition = 1e3 * typical_error_m(content, 0.95), verdict.condition if verdict else ""
    line = "Typical expected error, one standard deviation: half of the surface is below it, 95 %"
    lines, score = [f"{line} below {most:.1f} mm{condition}."], score_of(content, verdict)
    if score is not None:
        lines.append(f"Stated F1 {score_text(score)}.")
    value = f"{1e3 * typical_error_m(content):.1f} mm"
    return Card(title=title, value=value, lines=tuple(lines))


def _unseen_card(content: TriangleMesh, seen: Bools, has_outlines: bool) -> Card:
    """Card of the surface without an echo or an outline."""
    areas = vertex_areas(content.vertices, content.faces)
    kinds = np.where(seen, Evidence.SEEN, Evidence.NOT_SEEN)
    if content.evidence is not None:
        kinds = content.evidence.astype(np.int64)
    every = np.ones_like(seen)
    shares = {kind: _share(areas, kinds == kind, every) for kind in reversed(Evidence)}
    lines = ["No echo came from this part of the surface."]
    if shares[Evidence.OUTLINE] > _MIN_SHARE:
        lines = [f"{_percent(shares[Evidence.OUTLINE])} more rest on the outline of a shadow."]
    return Card(
        title="Not seen",
        value=_percent(shares[Evidence.NOT_SEEN]),
        lines=(
            *lines,
            *_describe_unseen_sides(content, kinds == Evidence.NOT_SEEN),
            *_ends(content, seen, has_outlines),
        ),
        shares=tuple((str(kind), share) for kind, share in shares.items() if share > 0),
    )


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _describe_content(content: TriangleMesh, report: SurfaceReport) -> str:
    n, lengths = report.n_components, _sides(content)
    center = 1e3 * volume_centroid_m(content.vertices, content.faces)
    position = ", ".join(f"{value:z.0f}" for value in center)
    closed = "" if report.is_watertight else " The surface is open."
    if n == 1:
        return f"One body, {lengths}, its centre at ({position}) mm.{closed}"
    return f"{n} separate pieces, {lengths} over all, their centre at ({position}) mm.{closed}"


def _scores(metrics: Mapping[str, Any]) -> list[tuple[str, str]]:
    items = [(f"F1 {1e3 * s['threshold_m']:g} mm", f"{s['f1']:.3f}") for s in metrics["scores"]]
    for share, key in (("median", "median_m"), ("95 %", "p95_m")):
        error = 1e3 * metrics["surface_mesh_to_truth"][key]
        items.append((f"error, {share}", f"{error:.2f} mm"))
    if (offset := metrics["surface_bias_m"]) is not None:
        items.append(("offset along the normal", f"{1e3 * offset:+z.2f} mm"))
    if size := metrics.get("size"):
        if size["volume_ratio"] is not None:
            items.append(("volume over the true one", f"{size['volume_ratio']:.2f}"))
        errors = ", ".join(f"{1e3 * error:+z.1f}" for error in size["extent_errors_m"])
        items.append(("error of size x, y, z [mm]", errors))
    return items


def _describe_unseen_sides(content: TriangleMesh, not_seen: Bools) -> list[str]:
    """Sentence on the directions that were not seen."""
    areas = vertex_areas(content.vertices, content.faces)
    up = vertex_normals(content.vertices, content.faces)[:, 2]
    sides = {
        "faces up": up > _STEEP_COSINE,
        "faces down": up < -_STEEP_COSINE,
        "faces sideways": np.abs(up) <= _STEEP_COSINE,
    }
    shares = {name: _share(areas, not_seen, which) for name, which in sides.items()}
    parts = [f"{_percent(s)} of what {name}" for name, s in shares.items() if s >= _MIN_SHARE]
    return [f"By side: {_join_words(parts)}."] if parts else []


def _share(areas: Floats, marked: Bools, among: Bools) -> float:
    total = float(areas[among].sum())
    return float(areas[among & marked].sum()) / total if total > 0 else 0.0


def _ends(content: TriangleMesh, seen: Bools, has_outlines: bool) -> list[str]:
    """Sentence on the ends, and so the lengths, that lie on unseen surface."""
    areas = vertex_areas(content.vertices, content.faces)
    near: dict[str, Bools] = {}
    for height, (lowest, highest) in zip(content.vertices.T, _ENDS, strict=True):
        near[lowest] = height <= height.min() + _END_REACH_M
        near[highest] = height >= height.max() - _END_REACH_M
    blind = [name for name, among in near.items() if _share(areas, ~seen, among) > 0.5]
    if not blind:
        return []
    source = " other than the shadow on the far walls" if has_outlines else ""
    which = "This end" if len(blind) == 1 else "These ends"
    return [f"{which} of the size had no echo{source}: {_join_words(blind)}."]


def _join_words(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
