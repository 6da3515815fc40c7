"""Captures and priors in a notebook: a small table, and the scan seen from above."""

from collections.abc import Sequence
from html import escape

import numpy as np

from geraf2._types import Floats
from geraf2.records import Wall, Waveform

_SIDE_PX = 240
PLANE_COLOR, BOX_COLOR = "#2a6fbb", "#a87b45"


def table_html(rows: Sequence[tuple[str, str]], picture: str = "") -> str:
    """Return a table of names and values beside a picture, as HTML."""
    body = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in rows
    )
    return (
        '<div style="display:flex;flex-wrap:wrap;gap:1em;align-items:center">'
        f"<table>{body}</table>{picture}</div>"
    )


def from_above_svg(outlines: Sequence[tuple[Floats, str]]) -> str:
    """Draw closed outlines seen along z.

    outlines: corners of each, in order around it, (n, 2 or 3) [m], and its colour.
    Returns "" where there is nothing to draw.
    """
    outlines = [
        (corners[:, :2], color) for corners, color in outlines if np.isfinite(corners).all()
    ]
    if not outlines:
        return ""
    points = np.concatenate([corners for corners, _ in outlines])
    low, high = points.min(axis=0), points.max(axis=0)
    side = 1.1 * max(float((high - low).max()), 1e-6)
    lowest = 0.5 * (low + high) - 0.5 * side
    drawn = []
    for corners, color in outlines:
        at = (corners - lowest) / side * _SIDE_PX
        path = " ".join(f"{x:.1f},{_SIDE_PX - y:.1f}" for x, y in at)
        drawn.append(
            f'<polygon points="{path}" stroke="{color}" fill="{color}" fill-opacity="0.3" '
            'stroke-width="1.5"/>'
        )
    return (
        f'<svg role="img" aria-label="seen from above, {side:.2f} m wide" width="{_SIDE_PX}" '
        f'height="{_SIDE_PX}" viewBox="0 0 {_SIDE_PX} {_SIDE_PX}">{"".join(drawn)}</svg>'
    )


def mesh_outline(vertices: Floats) -> Floats:
    """Corners of a solid's convex outline seen along z, in order around it, (n, 2) [m]."""
    from scipy.spatial import ConvexHull  # noqa: PLC0415 - 0.1 s, for a picture

    flat = vertices[:, :2]
    return np.asarray(flat[ConvexHull(flat).vertices])


def waveform_rows(waveform: Waveform) -> list[tuple[str, str]]:
    """Text of a chirp's band, samples and range cell."""
    start = waveform.start_frequency_hz
    return [
        ("band", f"{start / 1e9:.2f} to {(start + waveform.bandwidth_hz) / 1e9:.2f} GHz"),
        ("samples a chirp", f"{waveform.n_samples}"),
        ("range cell", f"{1e3 * waveform.range_cell_m:.1f} mm"),
        ("delay", f"{1e3 * waveform.path_bias_m:.1f} mm"),
    ]


def wall_rows(walls: Sequence[Wall]) -> list[tuple[str, str]]:
    """Text of the walls' sizes and materials, outermost first."""
    return [
        (
            f"wall {n}",
            f"{size_text(wall.size_m)}, {1e3 * wall.thickness_m:.1f} mm thick, "
            f"permittivity {wall.permittivity:.2f}",
        )
        for n, wall in enumerate(walls, 1)
    ] or [("walls", "none known")]


def size_text(size_m: Sequence[float]) -> str:
    """Text of side lengths in millimetres."""
    return " x ".join(f"{1e3 * side:.0f}" for side in size_m) + " mm"
