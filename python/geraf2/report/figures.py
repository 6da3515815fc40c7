"""Pictures of a run, as PNG files; lengths in millimetres, colours safe for the colour-blind."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from geraf2._types import AnyPath, Array, Floats
from geraf2._validation import require_shape
from geraf2.echoes.glint_set import Glints
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.geometry.transforms import triple
from geraf2.io.mesh import TriangleMesh
from geraf2.io.mesh_colours import ERROR_COLOURS, worst_shown_m
from geraf2.report import canvas
from geraf2.report.canvas import AXIS_NAMES, BLUE, BOX_COLOUR, GLINT_COLOUR, RED, TRUTH_COLOUR
from geraf2.report.render import MeshPainter, View
from geraf2.scene import Grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_GREY = (0.78, 0.78, 0.78)
_MESH_PIXELS = 300
_MESH_WIDTH, _MESH_MARGINS = 3.1, (0.3, 0.05, 0.05, 0.4)  # of a side's panel [inch]
_WIDEST = 5.6  # of a panel whose letters are to be 11 px on a phone [inch]
_THREE = (4.0, 4.0, 4.0 + canvas.BAR)  # widths of three panels, the last with a colour bar [inch]
_HEAT_MAP_RANGE_DB = 30.0  # below the maximum

FOUR_SIDES_DEG = (0.0, 90.0, 180.0, 270.0)
"""Azimuths of the mesh pictures [degrees]."""

# label, mesh, vertex colours, (colour scale, its label) or None
_Row = tuple[str, MeshPainter, Floats, tuple[Any, str] | None]

_SIDE_NAMES = ("+x", "+y", "-x", "-y")
# (across, up, axis of the projection or cut)
_PLANES = ((0, 1, 2), (0, 2, 1), (1, 2, 0))


def sdf_slices(
    sdf: SdfGrid,
    path: AnyPath,
    *,
    glints: Glints | None = None,
    truth: TriangleMesh | None = None,
    box: TriangleMesh | None = None,
    center_m: Sequence[float] | None = None,
) -> None:
    """Draw cuts of a signed distance field on three axes, with its zero level and the glints.

    sdf: field [m].
    glints: drawn within half a voxel, at least 2 mm, of the cut, with a line along the normal.
    truth, box: their cuts are drawn as lines.
    center_m: point of the cuts [m]; by default the centre of the negative values.
    """
    center = _middle(sdf) if center_m is None else np.asarray(center_m, dtype=np.float64)
    sheet = canvas.Sheet.of((4.0, _THREE), with_legend=True)
    (panels,) = sheet.rows
    near = max(0.5 * sdf.grid.spacing_m, 0.002)
    image: Any = None
    for panel, (across, up, cut) in zip(panels, _PLANES, strict=True):
        image = _draw_field(panel, sdf, center, (across, up, cut))
        for mesh, colour in ((box, BOX_COLOUR), (truth, TRUTH_COLOUR)):
            canvas.draw_section(panel, mesh, (across, up, cut), (colour, 1.6), center)
        if glints is not None:
            _draw_glints_near(panel, glints, center, (across, up, cut), near)
        title = f"{AXIS_NAMES[cut]} = {round(1e3 * center[cut])} mm"
        canvas.label_millimetres(panel, across, up, title)
        _limit_to_content(panel, sdf.grid, box, (across, up))
    sheet.colour_bar(panels[-1], image, "signed distance [mm], negative inside")
    sheet.legend(_slice_lines(glints is not None, truth is not None, box is not None, near))
    sheet.save(path)


def projections(
    volume: Array,
    grid: Grid,
    path: AnyPath,
    *,
    box: TriangleMesh | None = None,
    title: str | None = None,
) -> None:
    """Draw maximum-intensity projections of a heat map on three axes.

    volume: complex image or magnitude, grid.shape; shown as 20 log10 |v| / max |v|.
    box: outline drawn over the projections.
    """
    require_shape("volume", volume, grid.shape)
    magnitude = np.abs(np.asarray(volume))
    maxima = [magnitude.max(axis=axis) for axis in range(3)]
    draw_projections(maxima, grid, path, box, title)


def draw_projections(
    maxima: Sequence[Array],
    grid: Grid,
    path: AnyPath,
    box: TriangleMesh | None = None,
    title: str | None = None,
) -> None:
    """Draw given projections, `maxima` along x, y and z; see :func:`projections`."""
    peak = float(maxima[0].max(initial=0.0))
    if not np.isfinite(peak) or peak <= 0:
        raise UserError(
            what="the heat map has no signal to draw",
            expected="a positive, finite largest magnitude",
            got=peak,
        )
    sheet = canvas.Sheet.of((4.0, _THREE), title=title)
    (panels,) = sheet.rows
    image: Any = None
    for panel, (across, up, along) in zip(panels, _PLANES, strict=True):
        # The remaining axes keep their order: rows are `across` and columns `up`.
        decibels = 20.0 * np.log10(np.maximum(maxima[along] / peak, 1e-20))
        extent = canvas.extent_mm(grid, across, up)
        image = canvas.show(panel, decibels, extent, vmin=-_HEAT_MAP_RANGE_DB, vmax=0.0)
        canvas.draw_section(panel, box, (across, up, along), ("#BBBBBB", 1.0))
        canvas.label_millimetres(panel, across, up, f"largest along {AXIS_NAMES[along]}")
        _limit_to_content(panel, grid, box, (across, up))
        panel.set_facecolor("black")
    sheet.colour_bar(panels[-1], image, "magnitude [dB of the largest]")
    sheet.save(path)


def mesh_views(
    mesh: TriangleMesh,
    path: AnyPath,
    *,
    truth: TriangleMesh | None = None,
    distances_m: Floats | None = None,
    num_threads: int | None = None,
) -> None:
    """Draw the mesh from four sides, coloured by expected error, beside the truth if known.

    truth: true surface, drawn grey in a second row, with the same scale and position.
    distances_m: distance of each vertex to the truth, (n_vertices,) [m]: drawn in a third row.
    """
    if mesh.faces.shape[0] == 0:
        raise UserError(what="the mesh has no triangles to draw")
    known = np.concatenate([mesh.vertices, truth.vertices]) if truth is not None else mesh.vertices
    views, tallest = _four_views(known)
    side = 1e3 * views[0].half_width_m
    painter = MeshPainter(mesh, num_threads=num_threads)
    rows: list[_Row] = [_expected_row(painter)]
    if truth is not None and truth.faces.shape[0]:
        grey = np.tile(np.array(_GREY), (truth.vertices.shape[0], 1))
        rows.append(("truth", MeshPainter(truth, num_threads=num_threads), grey, None))
    if distances_m is not None:
        rows.append(_distance_row(painter, distances_m))
    widths = [_MESH_WIDTH] * len(FOUR_SIDES_DEG)
    if any(scale is not None for *_, scale in rows):
        widths[-1] += canvas.BAR
    left, bottom, right, top = _MESH_MARGINS
    tall = bottom + top + (_MESH_WIDTH - left - right) * tallest / side
    sheet = canvas.Sheet.of(*[(tall, widths)] * len(rows), margins=_MESH_MARGINS)
    for (label, row_painter, colours, scale), panels in zip(rows, sheet.rows, strict=True):
        for view, panel in zip(views, panels, strict=True):
            picture = row_painter.render(view, colours)
            panel.imshow(picture, extent=(-side, side, -side, side))
            panel.set_ylim(-tallest, tallest)
            panel.set_axis_off()
            panel.set_anchor("W")
        panels[0].text(-side, 0.0, label, rotation=90, ha="right", va="center")
        _scale_bar(panels[0], side, tallest)
        if scale is not None:
            sheet.colour_bar(panels[-1], *scale)
    for panel, azimuth, name in zip(sheet.rows[0], FOUR_SIDES_DEG, _SIDE_NAMES, strict=True):
        panel.set_title(f"from {name} ({azimuth:.0f}°)")
    sheet.save(path)


def glint_overview(glints: Glints, path: AnyPath, *, box: TriangleMesh | None = None) -> None:
    """Draw positions of the glints on three axes, their strengths, and their scan planes."""
    sheet = canvas.Sheet.of((4.0, _THREE), (3.0, (_WIDEST, _WIDEST)))
    panels, (strength, per_pose) = sheet.rows
    largest = float(glints.strengths.max(initial=0.0))
    relative = glints.strengths / largest if largest > 0 else np.ones(len(glints))
    decibels = 20.0 * np.log10(np.maximum(relative, 1e-20))
    order = np.argsort(decibels)  # the strongest are drawn last, on top
    dots: Any = None
    for panel, (across, up, along) in zip(panels, _PLANES, strict=True):
        x, y = 1e3 * glints.positions[order][:, [across, up]].T
        scale: dict[str, Any] = {"cmap": "viridis", "vmin": -30, "vmax": 0}
        dots = panel.scatter(x, y, c=decibels[order], s=5, linewidths=0, **scale)
        canvas.draw_section(panel, box, (across, up, along), (BOX_COLOUR, 1.2))
        panel.set_aspect("equal", adjustable="datalim")
        canvas.label_millimetres(panel, across, up, f"seen along {AXIS_NAMES[along]}")
    sheet.colour_bar(panels[-1], dots, "strength [dB of the strongest]")
    strength.hist(np.clip(decibels, -40, 0), bins=list(range(-40, 1)), color=BLUE)
    canvas.label(strength, "strength [dB of the strongest]", "glints")
    counts = np.bincount(glints.poses) if len(glints) else np.zeros(1, dtype=np.int64)
    per_pose.bar(np.arange(counts.size), counts, color=BLUE)
    canvas.label(per_pose, "scan plane", "glints")
    for panel in (strength, per_pose):
        panel.spines[["top", "right"]].set_visible(False)
    sheet.save(path)


def error_curves(
    distances_m: dict[str, Floats], path: AnyPath, *, thresholds_m: Sequence[float] = ()
) -> None:
    """Draw the share of samples nearer than a distance, for each named set of distances [m]."""
    sheet = canvas.Sheet.of((4.0, (_WIDEST,)))
    ((panel,),) = sheet.rows
    limit = 5.0
    colours = (BLUE, RED, TRUTH_COLOUR, "#CC79A7")
    styles = ("-", "--", "-.", ":")
    for (name, distances), colour, style in zip(distances_m.items(), colours, styles, strict=False):
        ordered = np.sort(np.abs(distances)) * 1e3
        share = np.arange(1, ordered.size + 1) / ordered.size
        panel.plot(ordered, 100 * share, color=colour, linestyle=style, label=name, linewidth=1.8)
        limit = max(limit, 1.2 * float(np.quantile(ordered, 0.99)))
    for threshold in thresholds_m:
        if 1e3 * threshold <= limit:
            panel.axvline(1e3 * threshold, color="#999999", linewidth=0.8)
            text = f" {1e3 * threshold:g} mm"
            panel.text(1e3 * threshold, 2.0, text, color="#666666", fontsize=8)
    panel.set_xlim(0, limit)
    panel.set_ylim(0, 101)
    canvas.label(panel, "distance [mm]", "samples nearer than that [%]")
    panel.spines[["top", "right"]].set_visible(False)
    panel.legend(loc="lower right", frameon=False)
    sheet.save(path)


def loss_curves(curves: dict[str, list[tuple[int, float]]], path: AnyPath) -> None:
    """Draw terms of a loss, (step, value) by name, on a logarithmic axis."""
    sheet = canvas.Sheet.of((4.0, (_WIDEST,)))
    ((panel,),) = sheet.rows
    for (name, curve), colour in zip(curves.items(), (BLUE, RED, TRUTH_COLOUR), strict=False):
        steps, values = zip(*curve, strict=True)
        panel.plot(steps, np.maximum(values, 1e-12), color=colour, label=name, linewidth=1.6)
    panel.set_yscale("log")
    canvas.label(panel, "step", "term of the loss")
    panel.spines[["top", "right"]].set_visible(False)
    panel.legend(frameon=False)
    sheet.save(path)


def growth_curves(growth: Sequence[tuple[int, float, float]], path: AnyPath) -> None:
    """Draw expected error [mm] and seen share over the number of planes, one above the other."""
    # Wide enough for "2 x 10^-1", which a logarithmic axis of few decades has.
    sheet = canvas.Sheet.of(*[(2.8, (_WIDEST,))] * 2, margins=(1.5, 0.65, 0.2, 0.3))
    planes, errors, shares = zip(*growth, strict=True)
    (upper,), (lower,) = sheet.rows
    upper.plot(planes, errors, "o-", color=BLUE, linewidth=1.6, markersize=4)
    upper.set_yscale("log")
    canvas.label(upper, "planes", "expected error [mm]")
    lower.plot(planes, np.multiply(100.0, shares), "o-", color=RED, linewidth=1.6, markersize=4)
    lower.set_ylim(0.0, 100.0)
    canvas.label(lower, "planes", "seen [%]")
    for panel in (upper, lower):
        panel.spines[["top", "right"]].set_visible(False)
    sheet.save(path)


def _middle(sdf: SdfGrid) -> Floats:
    inside = np.argwhere(sdf.values < 0)
    index = inside.mean(axis=0) if inside.size else 0.5 * (np.asarray(sdf.grid.shape) - 1.0)
    return np.asarray(sdf.grid.origin_m) + sdf.grid.spacing_m * index


def _draw_field(panel: "Axes", sdf: SdfGrid, center: Floats, plane: tuple[int, int, int]) -> Any:
    across, up, cut = plane
    axes_m = sdf.grid.axes_m
    first, second = np.meshgrid(axes_m[across], axes_m[up], indexing="ij")
    points = np.empty((first.size, 3))
    points[:, across], points[:, up], points[:, cut] = first.ravel(), second.ravel(), center[cut]
    millimetres = 1e3 * sdf.sample(points).reshape(first.shape)
    extent = canvas.extent_mm(sdf.grid, across, up)
    style = {"cmap": _pale_diverging_map(), "interpolation": "bilinear", "vmin": -40, "vmax": 40}
    image = canvas.show(panel, millimetres, extent, **style)
    x, y = 1e3 * axes_m[across], 1e3 * axes_m[up]
    if millimetres.min() < 0 < millimetres.max():
        levels = [level for level in range(-40, 50, 10) if level]
        panel.contour(
            x, y, millimetres.T, levels=levels, colors="#00000030", linewidths=0.6, linestyles="-"
        )
        panel.contour(x, y, millimetres.T, levels=[0.0], colors="black", linewidths=1.6, zorder=4)
    return image


def _pale_diverging_map() -> Any:
    mpl = canvas.load_matplotlib()
    from matplotlib.colors import ListedColormap  # noqa: PLC0415 - as above

    # Without the dark ends, so that lines and points stay readable.
    return ListedColormap(mpl.colormaps["RdBu_r"](np.linspace(0.2, 0.8, 256)))


def _draw_glints_near(
    panel: "Axes", glints: Glints, center: Floats, plane: tuple[int, int, int], near_m: float
) -> None:
    across, up, cut = plane
    close = np.abs(glints.positions[:, cut] - center[cut]) <= near_m
    points = 1e3 * glints.positions[close][:, [across, up]]
    tips = points + 5.0 * glints.normals[close][:, [across, up]]
    # One line with gaps: a line for each glint takes half of the time of the picture.
    lines = np.stack([points, tips, np.full_like(points, np.nan)], axis=1).reshape(-1, 2)
    panel.plot(lines[:, 0], lines[:, 1], color=GLINT_COLOUR, linewidth=0.7)
    edge: dict[str, Any] = {"edgecolors": "black", "linewidths": 0.3}
    panel.scatter(points[:, 0], points[:, 1], s=9, color=GLINT_COLOUR, zorder=3, **edge)


def _slice_lines(has_glints: bool, has_truth: bool, has_box: bool, near_m: float) -> list[Any]:
    """Lines and points of the slices, as their legend shows them."""
    from matplotlib.lines import Line2D  # noqa: PLC0415 - as above

    handles = [Line2D([], [], color="black", linewidth=1.8, label="zero level")]
    if has_truth:
        handles.append(Line2D([], [], color=TRUTH_COLOUR, linewidth=1.6, label="truth"))
    if has_box:
        handles.append(Line2D([], [], color=BOX_COLOUR, linewidth=1.6, label="box"))
    if has_glints:
        label = f"glints within {1e3 * near_m:.0f} mm, with normals"
        handles.append(Line2D([], [], color=GLINT_COLOUR, marker="o", markersize=4, label=label))
    return handles


def _limit_to_content(
    panel: "Axes", grid: Grid, box: TriangleMesh | None, plane: tuple[int, int]
) -> None:
    """Limit a panel to a square around the grid, and around the box if that is not much larger."""
    edges = np.array([canvas.extent_mm(grid, axis, axis)[:2] for axis in range(3)])
    if box is not None and box.faces.shape[0]:
        low = np.minimum(edges[:, 0], 1e3 * box.vertices.min(axis=0) - 4.0)
        high = np.maximum(edges[:, 1], 1e3 * box.vertices.max(axis=0) + 4.0)
        if (high - low).max() < 1.6 * np.ptp(edges, axis=1).max():
            edges = np.stack([low, high], axis=1)
    half = 0.5 * float(np.ptp(edges, axis=1).max())
    center = edges.mean(axis=1)
    panel.set_xlim(center[plane[0]] - half, center[plane[0]] + half)
    panel.set_ylim(center[plane[1]] - half, center[plane[1]] + half)


def _expected_row(painter: MeshPainter) -> _Row:
    n_vertices = painter.mesh.vertices.shape[0]
    expected_m = painter.mesh.expected_error_m
    if expected_m is None:
        return "reconstruction", painter, np.tile(np.array(_GREY), (n_vertices, 1)), None
    colours, mappable = _colour_errors(1e3 * expected_m, 1e3 * worst_shown_m(expected_m))
    return "reconstruction", painter, colours, (mappable, "expected error [mm]")


def _distance_row(painter: MeshPainter, distances_m: Floats) -> _Row:
    require_shape("distances_m", distances_m, (painter.mesh.vertices.shape[0],))
    colours, mappable = _colour_errors(1e3 * np.abs(distances_m), 8.0)
    return "error", painter, colours, (mappable, "distance to the truth [mm]")


def _colour_errors(values: Floats, largest: float) -> tuple[Floats, Any]:
    canvas.load_matplotlib()
    from matplotlib.cm import ScalarMappable  # noqa: PLC0415 - as above
    from matplotlib.colors import LinearSegmentedColormap, Normalize  # noqa: PLC0415 - as above

    colours = LinearSegmentedColormap.from_list("errors", ERROR_COLOURS)
    mappable = ScalarMappable(norm=Normalize(0.0, largest), cmap=colours)
    return np.asarray(mappable.to_rgba(values), dtype=np.float64)[:, :3], mappable


def _four_views(points: Floats) -> tuple[list[View], float]:
    """Cameras around all points (n, 3) [m], and half of the required height [mm]."""
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    views = [
        View(
            azimuth_deg=azimuth,
            center_m=triple(center),
            half_width_m=1.04 * float(np.linalg.norm(points - center, axis=1).max()),
            n_pixels=_MESH_PIXELS,
        )
        for azimuth in FOUR_SIDES_DEG
    ]
    heights = [float(np.abs((points - center) @ view.axes[1]).max()) for view in views]
    return views, 1.1e3 * max(heights)


def _scale_bar(panel: "Axes", half_width_mm: float, half_height_mm: float) -> None:
    length = next(n for n in (500, 200, 100, 50, 20, 10, 5, 2, 1) if n <= 0.6 * half_width_mm)
    left, bottom = -0.97 * half_width_mm, -0.95 * half_height_mm
    panel.plot([left, left + length], [bottom, bottom], color="black", linewidth=2.5)
    panel.text(left + 0.5 * length, bottom + 0.03 * half_width_mm, f"{length} mm", ha="center")
