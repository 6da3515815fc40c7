"""`geraf2 plan`: planes of a scan, its time, and what it will see."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from geraf2._bounds import Arg
from geraf2.apps.planning.expected import BOX_M, ExpectedAccuracy
from geraf2.apps.planning.planning import (
    ExplainedScan,
    PlanOptions,
    explain_scan,
    make_plan,
    make_plane,
    make_timed_plan,
)
from geraf2.apps.planning.scan_time import TimedPlan
from geraf2.cli._console import rows, say, warn
from geraf2.errors import UserError
from geraf2.freespace.specular import seen_share
from geraf2.io.outputs import PICTURES, require_file
from geraf2.io.scan_file import ScanFile, write_scan_file
from geraf2.pipeline.estimates import fine_image
from geraf2.scene import Waveform
from geraf2.scene.plan import PlanePlan, ScanPlan, nyquist_spacing_m, suggested_planes


@dataclass(frozen=True, kw_only=True)
class Config(PlanOptions):
    """Plan a turntable scan of a box: spacing, standoff, planes, elevations, time, and a drawing.

    With --depth in place of --box: a single plane at this distance from its object. With --minutes:
    what is best in that time; --like explains a scan. What is not given is suggested.
    """

    figure: Path | None = None
    """PNG to draw."""
    like: Annotated[Path | None, Arg(metavar="SCENE")] = None
    """Explain the scan of a scene instead: what it sees, and how long it would take."""


def main(config: Config) -> int:
    """Run the command."""
    if config.minutes is not None or config.like is not None:
        return _show_lines(config)
    if config.array is not None:
        raise UserError(what="--array is swept by a plan of --minutes or --like: give one")
    if config.out is not None:
        raise UserError(what="--out writes what --minutes or --like planned: give one")
    if config.depth is not None:
        if config.figure is not None:
            raise UserError(what="--depth plans a single plane, without --figure")
        return _show_plane(make_plane(config))
    if config.figure is not None:
        require_file(config.figure, PICTURES)
    plan = make_plan(config)
    wavelength = plan.waveform.center_wavelength_m
    limit = nyquist_spacing_m(plan.box_m, plan.standoff_m, wavelength)
    n_rows, n_columns = plan.rows_columns
    sizes = [n_rows * n_columns] * (plan.n_antennas // (n_rows * n_columns))
    width, height = plan.aperture_m
    share = seen_share(plan.apertures, np.zeros(3), np.asarray(plan.box_m))
    tilt = np.rad2deg(np.arctan(0.5 * height / plan.standoff_m))
    rings = ", ".join(f"{e - tilt:z.0f} to {e + tilt:z.0f}" for e in plan.elevations_deg)
    rows(
        [
            _band(plan.waveform),
            ("standoff", f"{plan.standoff_m:.2f} m from the axis to the planes"),
            ("plane", f"{1e3 * width:.0f} x {1e3 * height:.0f} mm (horizontal x vertical)"),
            (
                "spacing",
                f"{1e3 * plan.spacing_m:.2f} mm, at most {1e3 * limit:.2f} mm for this box there: "
                f"{n_rows} rows of {n_columns}",
            ),
            (
                "planes",
                f"{plan.n_planes} around, every {360.0 / plan.n_planes:.1f} degrees, at "
                f"{len(plan.elevations_deg)} elevation{'s' * (len(plan.elevations_deg) > 1)}",
            ),
            ("antennas", f"{plan.n_antennas} positions, {plan.n_bytes / 1e6:.0f} MB"),
            ("a fine image", fine_image(plan.box_m, wavelength, sizes, plan.waveform.n_samples)),
            ("time", _duration(plan.seconds)),
            ("normals seen", f"{100 * share:.0f} %: tilted by {rings} degrees"),
        ]
    )
    _warn(plan, limit)
    if config.figure is not None:
        from geraf2.report.plan import plan_figure  # noqa: PLC0415 - matplotlib takes 0.5 s

        plan_figure(plan, config.figure)
        say(f"drawing  {config.figure}")
    return 0


def _show_lines(config: Config) -> int:
    if config.out is not None:
        require_file(config.out, (".json", ".csv"))
    if config.figure is not None:
        raise UserError(what="--figure draws a plan of rings, without --minutes or --like")
    if config.minutes is not None and config.like is not None:
        raise UserError(what="give either --minutes or --like", got="both")
    if config.like is not None:
        return _show_like(explain_scan(config.like, config.scanner), config.out)
    return _show_timed(make_timed_plan(config), config)


def _show_timed(plan: TimedPlan, config: Config) -> int:
    lines, (width, height) = plan.scan.planes[0].lines, plan.design.aperture_m
    rows(
        [
            ("planes", f"{plan.design.n_planes}: {plan.design}"),
            ("plane", f"{1e3 * width:.0f} x {1e3 * height:.0f} mm (horizontal x vertical)"),
            (
                "lines",
                f"{len(lines)} a plane, {lines[0].n_positions} positions every "
                f"{1e3 * plan.scan.spacing_m:g} mm, at {lines[0].speed_m_per_s:.2g} m/s",
            ),
            *_accuracy_rows(plan.scan, plan.seconds, plan.seen_share, plan.expected, config.box),
            *_write_scan(plan.scan, config.out),
        ]
    )
    return 0


def _show_like(like: ExplainedScan, out: Path | None) -> int:
    counts = Counter(round(e / 5.0) * 5 for e in like.elevations_deg)
    at = ", ".join(f"{n} at {e} degrees" for e, n in sorted(counts.items()))
    rows(
        [
            ("planes", f"{len(like.apertures)}: {at} of elevation"),
            ("spacing", f"about {1e3 * like.spacing_m:.2g} mm"),
            *_accuracy_rows(like.scan, like.seconds, like.seen_share, like.expected),
            *_write_scan(like.scan, out),
        ]
    )
    return 0


def _accuracy_rows(
    scan: ScanFile,
    seconds: float,
    share: float,
    expected: ExpectedAccuracy | None,
    box_m: tuple[float, float, float] | None = None,
) -> list[tuple[str, str]]:
    reached = "nothing: the spacing is so coarse that grating lobes fill the box"
    if expected is not None:
        reached = str(expected)
        if box_m is not None and not 0.5 * BOX_M <= max(box_m) <= 2.0 * BOX_M:
            reached = f"unknown: nothing was measured in a box of {100 * max(box_m):.0f} cm"
    one = "; --channels or --array names more" if scan.array.n_channels == 1 else ""
    return [
        ("channels", f"{scan.array.n_channels} at once{one}"),
        ("antennas", f"{scan.n_antennas} positions of a channel"),
        ("time", _duration(seconds)),
        ("normals seen", f"{100 * share:.0f} %"),
        ("expected", reached),
    ]


def _write_scan(scan: ScanFile, out: Path | None) -> list[tuple[str, str]]:
    """Write a scan file, if one is asked for; its row."""
    if out is None:
        return []
    write_scan_file(out, scan)
    return [("scan file", str(out))]


def _band(waveform: Waveform) -> tuple[str, str]:
    start, wavelength = waveform.start_frequency_hz / 1e9, 1e3 * waveform.center_wavelength_m
    if waveform.n_samples == 1:
        return "band", f"{start:.4g} GHz, wavelength {wavelength:.2f} mm, no ranges"
    return "band", (
        f"{start:.4g} GHz + {waveform.bandwidth_hz / 1e9:.3g} GHz, wavelength {wavelength:.2f} mm, "
        f"range cell {1e3 * waveform.range_cell_m:.0f} mm"
    )


def _show_plane(plan: PlanePlan) -> int:
    n_rows, n_columns = plan.rows_columns
    (width, height), (across, up) = plan.aperture_m, plan.across_m
    wavelength, sizes = plan.waveform.center_wavelength_m, [n_rows * n_columns]
    sides = (*plan.aperture_m, 8.0 * wavelength)
    rows(
        [
            _band(plan.waveform),
            ("plane", f"{1e3 * width:.0f} x {1e3 * height:.0f} mm (horizontal x vertical)"),
            (
                "spacing",
                f"{1e3 * plan.spacing_m:.2f} mm, at most {1e3 * plan.nyquist_spacing_m:.2f} mm for "
                f"a scene as wide as the plane: {n_rows} rows of {n_columns}",
            ),
            (
                "resolves",
                f"{1e3 * across:.1f} x {1e3 * up:.1f} mm across, "
                f"{1e3 * plan.depth_of_focus_m:.0f} mm in depth, {plan.depth_m:g} m away",
            ),
            ("antennas", f"{n_rows * n_columns} positions, {plan.n_bytes / 1e6:.2g} MB"),
            ("a fine image", fine_image(sides, wavelength, sizes, plan.waveform.n_samples)),
            ("time", _duration(plan.seconds)),
        ]
    )
    if plan.spacing_m > plan.nyquist_spacing_m:
        warn("the spacing is too coarse: expect grating lobes at the edges of the scene")
    if plan.depth_m > plan.waveform.unambiguous_range_m > 0 and plan.waveform.n_samples > 1:
        far = plan.waveform.unambiguous_range_m
        warn(f"beyond the unambiguous range of {far:.2f} m: take more frequencies")
    if 2 * plan.depth_of_focus_m > plan.depth_m:
        warn("so far away the plane measures no depth by focusing: make it wider")
    return 0


def _warn(plan: ScanPlan, limit: float) -> None:
    if plan.spacing_m > limit:
        warn("the spacing is too coarse: expect grating lobes at the edges of the scene")
    if plan.farthest_m > plan.waveform.unambiguous_range_m:
        warn(
            f"the far corner of the box lies at {plan.farthest_m:.2f} m, beyond the unambiguous "
            f"range of {plan.waveform.unambiguous_range_m:.2f} m: take more samples"
        )
    if min(plan.aperture_m) < 0.08:
        warn("a plane smaller than a sub-aperture (80 mm) blurs weak echoes together")
    needed = suggested_planes(plan.aperture_m, plan.standoff_m)
    if 2 * plan.n_planes < needed:
        warn(
            f"between the planes lie normals that none sees: {-(-needed // 2)} planes close the "
            f"circle, {needed} see each normal twice"
        )


def _duration(seconds: float) -> str:
    if seconds < 120.0:
        return f"about {seconds:.0f} s"
    if seconds < 7200.0:
        return f"about {seconds / 60.0:.0f} minutes"
    return f"about {seconds / 3600.0:.1f} hours"
