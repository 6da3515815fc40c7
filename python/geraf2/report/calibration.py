"""Picture of a calibration: delay, walls before and after, channels, positions."""

from typing import TYPE_CHECKING, Any

import numpy as np

from geraf2._types import AnyPath
from geraf2.calibration.driver import Calibration
from geraf2.report import canvas
from geraf2.report.canvas import BOX_COLOUR, GLINT_COLOUR

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def calibration_figure(found: Calibration, path: AnyPath) -> None:
    """Draw the results of a calibration in four panels."""
    figure = canvas.new_figure(11.0, 7.5)
    (delay, walls), (channels, drift) = figure.subplots(2, 2)
    _draw_delay(delay, found)
    _draw_walls(walls, found)
    _draw_channels(channels, found)
    _draw_drift(drift, found)
    canvas.save(figure, path)


def _draw_delay(panel: "Axes", found: Calibration) -> None:
    if found.walls is not None:
        peak = found.walls.peak
        panel.plot(2.0 * peak.candidates_m, peak.density, color="black")
        panel.axvline(found.walls.delay_m, color=GLINT_COLOUR)
        panel.set_ylabel("echoes along the walls' normals")
    panel.set(xlabel="change of the instrument delay, two-way path [m]", title="instrument delay")


def _draw_walls(panel: "Axes", found: Calibration) -> None:
    walls = found.walls
    panel.set(title="echoes of the walls", xlabel="behind the prior's position [mm]")
    if walls is None:
        _draw_note(panel, "not used")
        return
    bins = np.arange(-10.0, 10.01, 0.5)
    style: dict[str, Any] = {"bins": bins.tolist(), "histtype": "step", "linewidth": 1.8}
    before, after = walls.rms_m
    for offsets, colour, label in (
        (walls.offsets_before_m, BOX_COLOUR, f"before, rms {1e3 * before:.2f} mm"),
        (walls.offsets_after_m, GLINT_COLOUR, f"after, rms {1e3 * after:.2f} mm"),
    ):
        panel.hist(np.clip(1e3 * offsets, bins[0], bins[-1]), color=colour, label=label, **style)
    panel.set_ylabel("echoes")
    panel.legend(frameon=False)


def _draw_channels(panel: "Axes", found: Calibration) -> None:
    channels = found.channels
    panel.set(title="phases of channels", xlabel="channel")
    if channels is None:
        _draw_note(panel, "no separate channels")
        return
    phases, sigmas = np.rad2deg(channels.phases_rad), np.rad2deg(channels.sigma_rad)
    panel.errorbar(np.arange(len(phases)), phases, yerr=sigmas, fmt="o", color="black", capsize=3)
    panel.axhline(0.0, color=BOX_COLOUR, linewidth=0.8)
    panel.set_ylabel("corrected phase [degrees]")
    if not found.applied("channels"):
        panel.set_title("phases of channels: not significant, unchanged")


def _draw_drift(panel: "Axes", found: Calibration) -> None:
    drift = found.drift
    panel.set(
        title="positions of the antennas", xlabel="antenna, along the trajectory of its plane"
    )
    if drift is None:
        _draw_note(panel, "unchanged")
        return
    for number, pose in enumerate(found.capture.poses):
        panel.plot(1e3 * drift.displacements(number, pose.n_antennas), linewidth=0.8)
    panel.set_ylabel("towards the scene [mm], a line for each plane")
    if not found.applied("positions"):
        panel.set_title("positions of the antennas: not significant, unchanged")


def _draw_note(panel: "Axes", text: str) -> None:
    panel.text(
        0.5, 0.5, text, ha="center", va="center", transform=panel.transAxes, color=BOX_COLOUR
    )
