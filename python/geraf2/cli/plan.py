"""`geraf2 plan`: planes of a scan, its time, and what it will see."""

from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from geraf2._bounds import Arg
from geraf2._types import Floats
from geraf2.apps.planning.expected import BOX_M
from geraf2.apps.planning.planning import (
    ExplainedScan,
    PlanOptions,
    explain_scan,
    make_plan,
    make_plane,
    make_timed_plan,
)
from geraf2.apps.planning.scan_time import TimedPlan
from geraf2.cli._console import keep, rows, say, warn
from geraf2.errors import UserError
from geraf2.freespace.specular import seen_share
from geraf2.io.outputs import PICTURES, require_file
from geraf2.io.scan_file import ScanFile, write_scan_file
from geraf2.pipeline.estimates import fine_image
from geraf2.scene import Waveform
from geraf2.scene.aperture import Aperture
from geraf2.scene.plan import PlanePlan, ScanPlan, nyquist_spacing_m, suggested_planes

_MUCH_OF_TIME = 0.9
"""A plan that takes a smaller share of the minutes says so."""


@dataclass(frozen=True, kw_only=True)
class Config(PlanOptions):
    """Plan a scan of a box: planes, spacing, time, what will be seen, and a drawing.

    The planes that see most in --minutes are chosen, raised ones and one above the box included;
    with --planes or --elevations-deg, rings as stated. With --depth in place of --box: a single
    plane at this distance from its object. --like explains a scan.
    """

    figure: Path | None = None
    """PNG to draw."""
    like: Annotated[Path | None, Arg(metavar="SCENE")] = None
    """Explain the scan of a scene instead: what it sees, and how long it would take."""


def main(config: Config) -> int:
    """Run the command."""
    if config.figure is not None:
        require_file(config.figure, PICTURES)
    if config.depth is not None and config.minutes is None:
        if config.figure is not None:
            raise UserError(what="--depth plans a single plane, without --figure")
        return _show_plane(make_plane(config))
    if config.minutes is not None or config.like is not None or not config.has_rings:
        return _show_lines(config)
    for name in ("array", "out"):
        if getattr(config, name) is not None:
            what = f"--{name} goes with planes that are chosen, or with --like"
            raise UserError(what=what, hint="leave --planes and --elevations-deg out")
    plan = make_plan(config)
    wavelength = plan.waveform.center_wavelength_m
    limit = nyquist_spacing_m(plan.box_m, plan.standoff_m, wavelength)
    n_rows, n_columns = plan.rows_columns
    sizes = [n_rows * n_columns] * (plan.n_antennas // (n_rows * n_columns))
    width, height = plan.aperture_m
    center = np.array([0.0, 0.0, plan.height_m])
    share = seen_share(plan.apertures, center, np.asarray(plan.box_m))
    tilt = _tilt_deg(height, plan.standoff_m)
    rings = ", ".join(f"{e - tilt:z.0f} to {e + tilt:z.0f}" for e in plan.elevations_deg)
    keep({**plan.numbers(), "nyquist_spacing_m": limit, "seen_share": share})
    rows(
        [
            _band(plan.waveform),
            ("standoff", _standoff(plan)),
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
    _draw(config.figure, plan.apertures, plan.box_m, center)
    return 0


def _standoff(plan: ScanPlan) -> str:
    height = f"; {1e3 * plan.height_m:+.0f} mm above its middle" if plan.height_m else ""
    return f"{plan.standoff_m:.2f} m from the axis of the box to the planes{height}"


def _tilt_deg(height_m: float, standoff_m: float) -> float:
    """Largest tilt of a surface that a plane of this height sees from the side [degrees]."""
    return float(np.rad2deg(np.arctan(0.5 * height_m / standoff_m)))


def _draw(
    figure: Path | None,
    planes: list[Aperture],
    box_m: tuple[float, float, float],
    center_m: Floats,
) -> None:
    """Draw planes about the middle of what they look at, (3,) [m], if a figure is asked for."""
    if figure is None:
        return
    from geraf2.report.plan import plan_figure  # noqa: PLC0415 - matplotlib takes 0.5 s

    plan_figure(planes, box_m, center_m, figure)
    say(f"drawing  {figure}")


def _show_lines(config: Config) -> int:
    if config.out is not None:
        require_file(config.out, (".json", ".csv"))
    if config.minutes is not None and config.like is not None:
        raise UserError(what="give either --minutes or --like", got="both")
    if config.like is not None:
        return _show_like(explain_scan(config.like, config.scanner), config)
    return _show_timed(make_timed_plan(config), config)


def _show_timed(plan: TimedPlan, config: Config) -> int:
    base, design, lines = make_plan(config), plan.design, plan.scan.planes[0].lines
    width, height = design.aperture_m
    keep({name: getattr(base, name) for name in ("box_m", "standoff_m", "height_m")})
    keep({"waveform": asdict(base.waveform), **asdict(design), "n_planes": design.n_planes})
    keep({"n_lines_of_a_plane": len(lines), "ring_seen_share": plan.ring_share})
    time = _duration(plan.seconds)
    if config.minutes is not None and plan.seconds < _MUCH_OF_TIME * 60.0 * config.minutes:
        time += f" of the {config.minutes:g} minutes: no plan sees more in the rest"
    rows(
        [
            _band(base.waveform),
            ("standoff", _standoff(base)),
            ("planes", f"{design.n_planes}: {design}"),
            ("plane", f"{1e3 * width:.0f} x {1e3 * height:.0f} mm (horizontal x vertical)"),
            (
                "lines",
                f"{len(lines)} a plane, {lines[0].n_positions} positions every "
                f"{1e3 * plan.scan.spacing_m:g} mm, at {lines[0].speed_m_per_s:.2g} m/s",
            ),
            *_accuracy_rows(plan, time, config.box),
            ("one ring", _of_one_ring(plan, _tilt_deg(height, base.standoff_m))),
            *_write_scan(plan.scan, config.out),
        ]
    )
    _warn_range(base)
    _draw(config.figure, plan.planes, base.box_m, np.array([0.0, 0.0, base.height_m]))
    return 0


def _of_one_ring(plan: TimedPlan, tilt_deg: float) -> str:
    """Say what a ring around the box sees in the time of a plan, and what it misses."""
    misses = f"nothing that tilts by more than {tilt_deg:.0f} degrees, such as a top"
    if plan.design.n_around == plan.design.n_planes:
        return f"this plan is one, and sees {misses}; more --minutes allow raised planes"
    share = f"{100 * plan.ring_share:.0f} %"
    return f"of {plan.design.n_planes} planes in the same time sees {share}: {misses}"


def _show_like(like: ExplainedScan, config: Config) -> int:
    counts = Counter(round(e / 5.0) * 5 for e in like.elevations_deg)
    at = ", ".join(f"{n} at {e} degrees" for e, n in sorted(counts.items()))
    keep({"n_planes": len(like.planes), "elevations_deg": like.elevations_deg})
    keep({"spacing_m": like.spacing_m, "box_m": like.box_m, "center_m": like.center_m.tolist()})
    rows(
        [
            ("planes", f"{len(like.planes)}: {at} of elevation"),
            ("spacing", f"about {1e3 * like.spacing_m:.2g} mm"),
            *_accuracy_rows(like, _duration(like.seconds)),
            *_write_scan(like.scan, config.out),
        ]
    )
    _draw(config.figure, like.planes, like.box_m, like.center_m)
    return 0


def _accuracy_rows(
    found: TimedPlan | ExplainedScan,
    time: str,
    box_m: tuple[float, float, float] | None = None,
) -> list[tuple[str, str]]:
    scan, expected = found.scan, found.expected
    keep({"n_channels": scan.array.n_channels, "n_antennas": scan.n_antennas})
    keep({"seconds": found.seconds, "seen_share": found.seen_share})
    reached = "nothing: the spacing is so coarse that grating lobes fill the box"
    if expected is not None:
        reached = str(expected)
        if box_m is not None and not 0.5 * BOX_M <= max(box_m) <= 2.0 * BOX_M:
            reached = f"unknown: nothing was measured in a box of {100 * max(box_m):.0f} cm"
            expected = None
    keep({"expected": expected and asdict(expected)})
    one = "; --channels or --array names more" if scan.array.n_channels == 1 else ""
    return [
        ("channels", f"{scan.array.n_channels} at once{one}"),
        ("antennas", f"{scan.n_antennas} positions of a channel"),
        ("time", time),
        ("normals seen", f"{100 * found.seen_share:.0f} %"),
        ("expected", reached),
    ]


def _write_scan(scan: ScanFile, out: Path | None) -> list[tuple[str, str]]:
    """Write a scan file, if one is asked for; its row."""
    if out is None:
        return []
    write_scan_file(out, scan)
    keep({"scan_file": str(out)})
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
    derived = ("across_m", "depth_of_focus_m", "nyquist_spacing_m")
    keep({**plan.numbers(), **{name: getattr(plan, name) for name in derived}})
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
            ("antennas", f"{plan.n_antennas} positions, {plan.n_bytes / 1e6:.2g} MB"),
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
    _warn_range(plan)
    if min(plan.aperture_m) < 0.08:
        warn("a plane narrower than 80 mm blurs weak echoes together")
    needed = suggested_planes(plan.aperture_m, plan.standoff_m)
    if 2 * plan.n_planes < needed:
        warn(
            f"between the planes lie normals that none sees: {-(-needed // 2)} planes close the "
            f"circle, {needed} see each normal twice"
        )


def _warn_range(plan: ScanPlan) -> None:
    if plan.farthest_m > plan.waveform.unambiguous_range_m:
        warn(
            f"the far corner of the box lies at {plan.farthest_m:.2f} m, beyond the unambiguous "
            f"range of {plan.waveform.unambiguous_range_m:.2f} m: take more samples"
        )


def _duration(seconds: float) -> str:
    if seconds < 120.0:
        return f"about {seconds:.0f} s"
    if seconds < 7200.0:
        return f"about {seconds / 60.0:.0f} minutes"
    return f"about {seconds / 3600.0:.1f} hours"
