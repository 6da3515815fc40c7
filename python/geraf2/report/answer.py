"""Summary of a run in sentences: content, size, expected errors, unseen surface."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from geraf2._types import Bools, Floats
from geraf2.echoes.glint_set import Glints
from geraf2.echoes.transparency import describe
from geraf2.geometry.triangles import vertex_areas, vertex_normals
from geraf2.io.mesh import TriangleMesh
from geraf2.surfaces.expected_error import quality_numbers, seen_vertices
from geraf2.surfaces.isosurface import SurfaceReport, surface_report
from geraf2.surfaces.pieces import ghost_texts, likely_part
from geraf2.surfaces.samples import size_lines

# Vertices this near to the extreme of the content define its end [m]: half of the usual voxel.
_END_REACH_M = 0.0015
# Normals within 45 degrees of the vertical face up or down.
_STEEP_COSINE = float(np.sqrt(0.5))
_ENDS = (("-x", "+x"), ("-y", "+y"), ("bottom", "top"))


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Summary at the top of a report."""

    found: str
    """Content and its size."""
    tiles: tuple[tuple[str, str], ...] = ()
    """Headline numbers, (name, value)."""
    sure: tuple[str, ...] = ()
    """Reliability of the surface."""
    unseen: tuple[str, ...] = ()
    """Unseen surface."""
    corrected: tuple[str, ...] = ()
    """Names of the effects that calibration corrected."""
    remarks: tuple[str, ...] = ()
    """Further remarks of the stages."""


def answer_of(
    content: TriangleMesh | None,
    glints: Glints | None,
    numbers: Mapping[str, Mapping[str, Any]],
    metrics: Mapping[str, Any],
) -> Answer:
    """Summarise a run.

    content, glints: results of the run; None where missing.
    numbers: results of each stage, by its name.
    metrics: scores against the truth, if any.
    """
    applied = numbers.get("calibration", {}).get("applied", ())
    corrected = tuple(str(text).partition(":")[0] for text in applied)
    rest: dict[str, Any] = {"corrected": corrected, "remarks": _remarks(numbers)}
    if content is None:
        return Answer(found="Nothing has been reconstructed in this folder yet.", **rest)
    if not content.faces.shape[0]:
        return Answer(found="Nothing was found in the box: the surface is empty.", **rest)
    content = likely_part(content)
    report = surface_report(content)
    size = 1e3 * np.ptp(content.vertices, axis=0)
    lengths = " x ".join(f"{side:.0f}" for side in size)
    tiles = [("size x, y, z [mm]", lengths)]
    if report.volume_m3 is not None:
        tiles.append(("volume", f"{1e6 * report.volume_m3:.0f} cm³"))
    sure, unseen = list[str](), list[str]()
    quality = quality_numbers(content)
    if quality:
        half, most = (quality[f"expected_error_{q}_mm"] for q in ("median", "95_percent"))
        tiles.append(("expected error, median", f"{half:.1f} mm"))
        sure.append(
            f"Expected error (one standard deviation): half of the surface below {half:.1f} mm, "
            f"95 % below {most:.1f} mm."
        )
    sure += _sizes(numbers.get("mesh", {}))
    seen = seen_vertices(content, glints)
    if seen is not None:
        share = _share(vertex_areas(content.vertices, content.faces), seen, np.ones_like(seen))
        n_glints = f" ({len(glints):,} glints in all)" if glints is not None else ""
        tiles.append(("never seen, of area", f"{100 * (1 - share):.0f} %"))
        sure.append(
            f"{100 * share:.0f} % of the surface was seen: echoes with this "
            f"normal came from there{n_glints}{_others(quality)}."
        )
        unseen += _unseen(content, seen)
        unseen += _ends(content, seen, bool(numbers.get("selection", {}).get("outlines")))
    sure += _labels(numbers)
    if "scores" in metrics:
        distance = metrics["surface_mesh_to_truth"]
        sure.insert(
            0,
            f"Against the truth: half of the surface is within {1e3 * distance['median_m']:.1f} mm "
            f"of it, 95 % within {1e3 * distance['p95_m']:.1f} mm.",
        )
        tiles += _scores(metrics)
    elif content.expected_error_m is None:
        sure.append("This mesh has no expected errors.")
    return Answer(
        found=_found(content, report, lengths) + _ghosts(numbers.get("mesh", {})),
        tiles=tuple(tiles),
        sure=tuple(sure),
        unseen=tuple(unseen),
        **rest,
    )


def _sizes(numbers: Mapping[str, Any]) -> list[str]:
    """Sentence on size and volume with their 95 % intervals."""
    sizes = dict(size_lines(numbers))
    if not sizes:
        return []
    return [f"Intervals: size x, y, z {sizes['size x, y, z']}, volume {sizes['volume']}."]


def _found(content: TriangleMesh, report: SurfaceReport, lengths: str) -> str:
    n = report.n_components
    middle = 5e2 * (content.vertices.min(axis=0) + content.vertices.max(axis=0))
    place = ", ".join(f"{value:.0f}" for value in np.round(middle) + 0.0)
    closed = "" if report.is_watertight else " The surface is open."
    if n == 1:
        return f"One body, {lengths} mm, its middle at ({place}) mm.{closed}"
    return f"{n} separate pieces, {lengths} mm over all, their middle at ({place}) mm.{closed}"


def _ghosts(numbers: Mapping[str, Any]) -> str:
    """Sentence on pieces that are not counted, after a space; empty without any."""
    texts = ghost_texts(numbers)
    return f" Likely ghosts, not counted: {'; '.join(texts)}." if texts else ""


def _others(quality: Mapping[str, Any]) -> str:
    """Evidence of the rest of the surface, with shares."""
    share = quality.get("evidence_shares", {}).get("outline", 0.0)
    return f"; {100 * share:.0f} % on a shadow's outline" if share > 0.005 else ""


def _scores(metrics: Mapping[str, Any]) -> list[tuple[str, str]]:
    items = [(f"F1 {1e3 * s['threshold_m']:g} mm", f"{s['f1']:.3f}") for s in metrics["scores"]]
    items.append(("median error", f"{1e3 * metrics['surface_mesh_to_truth']['median_m']:.2f} mm"))
    if (offset := metrics["surface_bias_m"]) is not None:
        items.append(("offset along the normal", f"{1e3 * offset:+.2f} mm"))
    if size := metrics.get("size"):
        if size["volume_ratio"] is not None:
            items.append(("volume over the true one", f"{size['volume_ratio']:.2f}"))
        errors = ", ".join(f"{1e3 * error:+.1f}" for error in size["extent_errors_m"])
        items.append(("error of size x, y, z [mm]", errors))
    return items


def _labels(numbers: Mapping[str, Mapping[str, Any]]) -> list[str]:
    counts = numbers.get("glints", {}).get("labels")
    if not counts:
        return []
    each = ", ".join(f"{n:,} {label.replace('_', ' ')}" for label, n in counts.items())
    return [f"Labels of the {sum(counts.values()):,} peaks at the ranges of the box: {each}."]


def _unseen(content: TriangleMesh, seen: Bools) -> list[str]:
    """Sentence on the directions that lack echoes."""
    areas = vertex_areas(content.vertices, content.faces)
    up = vertex_normals(content.vertices, content.faces)[:, 2]
    sides = {
        "faces up": up > _STEEP_COSINE,
        "faces down": up < -_STEEP_COSINE,
        "faces sideways": np.abs(up) <= _STEEP_COSINE,
    }
    shares = {name: _share(areas, ~seen, which) for name, which in sides.items()}
    parts = [
        f"{100 * share:.0f} % of what {name}" for name, share in shares.items() if share >= 0.005
    ]
    if not parts:
        return []
    return [f"Never seen, and only filled smoothly: {_listed(parts)}."]


def _share(areas: Floats, marked: Bools, among: Bools) -> float:
    total = float(areas[among].sum())
    return float(areas[among & marked].sum()) / total if total > 0 else 0.0


def _ends(content: TriangleMesh, seen: Bools, has_outlines: bool) -> list[str]:
    """Sentence on the ends, and so the lengths, that lie on unseen surface."""
    low, high = content.vertices.min(axis=0), content.vertices.max(axis=0)
    areas = vertex_areas(content.vertices, content.faces)
    blind: list[str] = []
    for axis, names in enumerate(_ENDS):
        height = content.vertices[:, axis]
        for name, near in zip(
            names,
            (height <= low[axis] + _END_REACH_M, height >= high[axis] - _END_REACH_M),
            strict=True,
        ):
            if _share(areas, ~seen, near) > 0.5:
                blind.append(name)
    if not blind:
        return []
    source = " other than the shadow on the far walls" if has_outlines else ""
    which = "This end" if len(blind) == 1 else "These ends"
    return [f"{which} of the size had no echo{source}: {_listed(blind)}."]


def _listed(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def _remarks(numbers: Mapping[str, Mapping[str, Any]]) -> tuple[str, ...]:
    """Sentences in the results of stages, without those of the calibration table."""
    remarks: list[str] = []
    if made_of := describe(numbers.get("glints", {})):
        remarks.append(f"{made_of[0].upper()}{made_of[1:]}.".replace("+- ", "± "))
    for stage, values in numbers.items():
        for key, value in values.items():
            if (stage == "calibration" and key in ("applied", "left")) or not value:
                continue
            texts = [value] if isinstance(value, str) else value if isinstance(value, list) else []
            words = key.replace("_", " ").replace("no outlines", "no outlines from shadows")
            remarks += [f"{words}: {text}" for text in texts if isinstance(text, str)]
    return tuple(remarks)
