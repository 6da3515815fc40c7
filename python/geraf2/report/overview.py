"""Overview picture of a scan: geometry, heat map, ranges, sampling, gaps."""

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from geraf2._types import AnyPath, Bools, Floats, Floats32
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.errors import UserError
from geraf2.freespace.specular import seen_share
from geraf2.imaging.plane_waves import search_depth
from geraf2.imaging.volume import image_volume
from geraf2.io.mesh import TriangleMesh
from geraf2.report import canvas
from geraf2.report.canvas import BOX_COLOUR, GLINT_COLOUR, RED, SKY
from geraf2.report.depth import draw_focus
from geraf2.report.plan import draw_normals
from geraf2.scene import Capture, Grid, LosPrior, Pose
from geraf2.scene.summary import CaptureSummary, constant_antennas, noisy_antennas

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_N_IMAGED_POSES = 6
_N_VOXELS = 44  # along the longest side of the heat map
_N_COLUMNS = 720  # of the picture of ranges over time
_RANGE_DB = 50.0
_HEAT_DB = 25.0
_UNKNOWN_WIDTH_M = 0.3


@dataclass(kw_only=True)
class _Gathered:
    """Data collected from poses that are read one at a time."""

    positions: list[Floats] = field(default_factory=list)
    """Positions of some antennas of each pose."""
    profiles: list[Floats] = field(default_factory=list)
    """Mean power over range of neighbouring antennas, (n_columns, n_ranges) each."""
    dropped: list[Bools] = field(default_factory=list)
    noisy: list[Bools] = field(default_factory=list)
    imaged: list[Pose] = field(default_factory=list)


def overview_figure(
    poses: Iterable[Pose],
    summary: CaptureSummary,
    path: AnyPath,
    *,
    box: TriangleMesh | None = None,
    num_threads: int | None = None,
) -> None:
    """Draw a scan in six panels.

    From above and from the side: antennas, box, and the heat map of six poses. Visible normals, or
    for a single plane without a box the sharpness of its image over depth. Power over range and
    time, with lost and noisy recordings. The required antenna spacing by the width of the scene.

    poses: of the scan, in order; six of them are held at a time.
    summary: of the same scan, with a focus, or a plane; UserError where the depth is unknown: one
        frequency, without a raster.
    box: outside of the box; the outermost wall of the scan when None.
    num_threads: threads of the heat map; all cores when None.
    """
    focus = summary.focus
    if focus is None and not summary.is_plane:
        msg = "summary must have a focus, got a scan without antennas"
        raise ValueError(msg)
    if box is None and summary.walls:
        box = LosPrior.from_box(summary.walls[0].size_m, summary.walls[0].center_m).mesh
    gathered = gather(poses, len(summary.poses))
    depths, sharpness = _search_depth(summary, gathered)
    standoff = summary.standoff_m
    if len(depths):
        plane, standoff = summary.usable_poses[0], float(depths[sharpness.argmax()])
        focus = plane.center + standoff * plane.axes[0]
    if focus is None:
        hint = "give the depth: 'geraf2 image --depth-m'"
        raise UserError(what="one frequency does not determine the depth", hint=hint)
    center, side = focus, summary.scene_width_m or _UNKNOWN_WIDTH_M
    if box is not None and box.vertices.shape[0]:
        low, high = box.vertices.min(axis=0), box.vertices.max(axis=0)
        center, side = 0.5 * (low + high), 1.3 * float((high - low).max())
    grid = Grid.cube((center[0], center[1], center[2]), 0.5 * side, _N_VOXELS)
    capture = Capture(waveform=summary.waveform, poses=tuple(gathered.imaged))
    volume = image_volume(capture, grid, num_threads=num_threads)

    wide = 5.0 + canvas.BAR
    sheet = canvas.Sheet.of((4.8, (4.9, 4.9, wide)), (3.8, (9.8, wide)))
    (*both, third), (ranges, sampling) = sheet.rows
    for panel, planes in zip(both, ((0, 1, 2), (0, 2, 1)), strict=True):
        _draw_geometry(panel, (volume, grid), gathered, box, planes)
    if len(depths):
        title = f"sharpest {1e3 * standoff:.0f} mm before the plane"
        draw_focus(third, depths, sharpness, title)
    else:
        sides = np.full(3, summary.scene_width_m or _UNKNOWN_WIDTH_M)
        share = seen_share(summary.planes, focus, sides)
        draw_normals(sheet, third, summary.planes, focus, share)
    _draw_ranges(ranges, gathered, summary, standoff)
    _draw_sampling(sampling, summary, standoff)
    sheet.save(path)


def _search_depth(summary: CaptureSummary, gathered: _Gathered) -> tuple[Floats, Floats]:
    """Depths before a single plane [m] and the sharpness at each; empty without a raster."""
    waveform = summary.waveform
    if summary.is_plane and gathered.imaged:
        with suppress(UserError):
            return search_depth(gathered.imaged[0], waveform, waveform.unambiguous_range_m)
    return np.zeros(0), np.zeros(0)


def gather(poses: Iterable[Pose], n_poses: int) -> _Gathered:
    """Collect data from poses that are read once."""
    gathered = _Gathered()
    imaged = {
        int(i) for i in np.linspace(0, n_poses, min(_N_IMAGED_POSES, n_poses), endpoint=False)
    }
    columns = max(1, _N_COLUMNS // max(1, n_poses))
    for number, pose in enumerate(poses):
        if pose.n_antennas == 0:
            continue
        if number in imaged and np.isfinite(pose.signal).all():
            gathered.imaged.append(pose)
        gathered.positions.append(pose.phase_centers[:: max(1, pose.n_antennas // 200)])
        signal = np.nan_to_num(pose.signal)
        n_samples = signal.shape[1]
        window = np.hanning(n_samples + 2)[1:-1]
        power = np.abs(np.fft.ifft(signal * window, n=2 * n_samples, axis=1)) ** 2
        parts = np.array_split(np.arange(pose.n_antennas), min(columns, pose.n_antennas))
        lost, noisy = constant_antennas(signal), noisy_antennas(signal)
        gathered.profiles.append(np.stack([power[part].mean(axis=0) for part in parts]))
        gathered.dropped.append(np.array([lost[part].any() for part in parts]))
        gathered.noisy.append(np.array([noisy[part].any() for part in parts]))
    return gathered


def _draw_geometry(
    panel: "Axes",
    heat: tuple[Floats32, Grid],
    gathered: _Gathered,
    box: TriangleMesh | None,
    axes: tuple[int, int, int],
) -> None:
    across, up, along = axes
    volume, grid = heat
    strongest = volume.max(axis=along)
    peak = float(strongest.max(initial=0.0))
    if peak > 0:
        decibels = 20.0 * np.log10(np.maximum(strongest / peak, 1e-20))
        extent = canvas.extent_mm(grid, across, up)
        canvas.show(panel, decibels, extent, vmin=-_HEAT_DB, vmax=0.0)
    positions = 1e3 * np.concatenate(gathered.positions)
    panel.plot(positions[:, across], positions[:, up], ".", color=SKY, markersize=1.0, zorder=0)
    canvas.draw_section(panel, box, axes, ("white", 1.4))
    corners = 1e3 * (np.asarray(grid.origin_m) + np.outer([0, _N_VOXELS - 1], [grid.spacing_m] * 3))
    everything = np.concatenate([positions, corners])
    for limits, axis in ((panel.set_xlim, across), (panel.set_ylim, up)):
        limits(everything[:, axis].min() - 20.0, everything[:, axis].max() + 20.0)
    panel.set_aspect("equal")
    n = len(gathered.imaged)
    shown = f"{n} plane{'s' * (n != 1)}, {_HEAT_DB:.0f} dB"
    canvas.label_millimetres(panel, across, up, f"antennas, box, heat map ({shown})")


def _draw_ranges(
    panel: "Axes", gathered: _Gathered, summary: CaptureSummary, standoff_m: float
) -> None:
    """Draw power over range and time; ranges are ambiguous like the beat frequency."""
    waveform = summary.waveform
    if waveform.n_samples == 1:
        panel.set_axis_off()
        panel.set_title("one frequency: no ranges")
        return
    profiles = np.concatenate(gathered.profiles)
    n_ranges = profiles.shape[1]
    pitch = SPEED_OF_LIGHT_M_PER_S / waveform.bandwidth_hz * waveform.n_samples / n_ranges
    ranges = 0.5 * (np.arange(n_ranges) * pitch - waveform.path_bias_m)
    peak = max(float(profiles.max()), 1e-300)
    decibels = 10.0 * np.log10(np.maximum(profiles / peak, 1e-12))
    extent = (0.0, float(len(profiles)), float(ranges[0]), float(ranges[-1]))
    canvas.show(panel, decibels, extent, aspect="auto", vmin=-_RANGE_DB, vmax=0.0)
    for flags, colour, label in (
        (gathered.dropped, RED, "lost"),
        (gathered.noisy, GLINT_COLOUR, "noisy"),
    ):
        where = np.nonzero(np.concatenate(flags))[0]
        if len(where):
            height = np.full(len(where), 0.97 * ranges[-1])
            panel.plot(where + 0.5, height, "v", color=colour, label=f"{label} recordings")
            panel.legend(loc="upper right", framealpha=0.9)
    bounds = np.cumsum([0] + [len(p) for p in gathered.profiles])
    every = max(1, len(gathered.profiles) // 12)
    panel.set_xticks(bounds[:-1:every], [str(i) for i in range(0, len(bounds) - 1, every)])
    if np.isfinite(standoff_m):
        panel.axhline(standoff_m, color="white", linewidth=0.8, linestyle="--")
    title = f"power over range and time ({_RANGE_DB:.0f} dB); dashed: middle of the scene"
    canvas.label(panel, "plane, antennas in their order", "range [m]", title)


def _draw_sampling(panel: "Axes", summary: CaptureSummary, standoff_m: float) -> None:
    """Draw the required spacing, lambda D / (2 w), at least lambda / 4."""
    wavelength = summary.waveform.center_wavelength_m
    widths = np.linspace(0.02, 0.8, 200)
    standoff_m = float(np.nan_to_num(standoff_m))
    needed = np.maximum(wavelength / 4.0, wavelength * standoff_m / (2.0 * widths))
    panel.plot(1e3 * widths, 1e3 * needed, color="black", label="needed")
    panel.axhline(1e3 * summary.spacing_m, color=SKY, label="antennas")
    width = summary.scene_width_m
    if width is not None:
        panel.axvline(1e3 * width, color=BOX_COLOUR, label="box")
    top = 3.0 * max(summary.spacing_m, wavelength / 4.0)
    panel.set_ylim(0.0, 1e3 * top if np.isfinite(top) else None)
    title = "sampling: the antennas must lie below the line"
    canvas.label(panel, "width of the scene [mm]", "antenna spacing [mm]", title)
    panel.legend(frameon=False)
