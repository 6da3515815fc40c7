"""`geraf2 plan`: what to scan, how long it takes, and what it will see."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from geraf2.cli._console import rows, say, warn
from geraf2.cli._fields import Arg
from geraf2.errors import UserError
from geraf2.io.manifest import RadarManifest
from geraf2.io.toml import read_toml
from geraf2.pipeline.prior import Triple
from geraf2.scene import Waveform
from geraf2.scene.plan import (
    PlanePlan,
    ScanPlan,
    nyquist_spacing_m,
    suggested_aperture_m,
    suggested_planes,
    suggested_standoff_m,
)

Preset = Literal["awr1843", "iwr6843"]

# Typical chirps of 3.6 GHz, decimated to 32 samples.
_PRESETS: dict[str, Waveform] = {
    name: Waveform(
        start_frequency_hz=start_hz,
        chirp_slope_hz_per_s=70.15e12,
        sample_rate_hz=625e3,
        n_samples=32,
        path_bias_m=0.15,
    )
    for name, start_hz in (("awr1843", 77.3704e9), ("iwr6843", 60.25e9))
}
_MAX_SIDE_M = 10.0


@dataclass(frozen=True, kw_only=True)
class Config:
    """Plan a turntable scan of a box: spacing, standoff, planes, elevations, time, and a drawing.

    With --depth in place of --box: a single plane before what lies so far away. What is not given
    is suggested.
    """

    box: Annotated[Triple | None, Arg(metavar="X Y Z")] = None
    """Outer side lengths of the box, Z along the turntable's axis [m]."""
    depth: float | None = None
    """Single plane to what it looks at [m]."""
    radar: Path | None = None
    """TOML file with the chirp, as for `geraf2 import`."""
    preset: Preset | None = None
    """Or a known radar; awr1843 when neither is given."""
    standoff: float | None = None
    """Planes to the turntable's axis [m]."""
    aperture: Annotated[tuple[float, float] | None, Arg(metavar="W H")] = None
    """Width and height of a plane [m]."""
    spacing: float | None = None
    """Distance of neighbouring antennas [m]."""
    planes: int | None = None
    """Planes around the box, for each elevation."""
    elevations_deg: tuple[float, ...] = (0.0,)
    """Elevations of the planes' middles [degrees]."""
    frame_period_s: float = 3e-3
    """From one recording to the next [s]."""
    speed_m_per_s: float = 0.2
    """Of the radar along a row [m/s]."""
    figure: Path | None = None
    """PNG to draw."""


def main(config: Config) -> int:
    """Run the command."""
    if config.depth is not None:
        return _show_plane(make_plane(config))
    plan = make_plan(config)
    wavelength = plan.waveform.center_wavelength_m
    limit = nyquist_spacing_m(plan.box_m, plan.standoff_m, wavelength)
    n_rows, n_columns = plan.rows_columns
    width, height = plan.aperture_m
    tilt = np.rad2deg(np.arctan(0.5 * height / plan.standoff_m))
    rings = ", ".join(f"{e - tilt:.0f} to {e + tilt:.0f}" for e in plan.elevations_deg)
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
            ("antennas", f"{plan.n_antennas} places, {plan.n_bytes / 1e6:.0f} MB"),
            ("time", _duration(plan.seconds)),
            ("normals seen", f"{100 * plan.seen_share():.0f} %: tilted by {rings} degrees"),
        ]
    )
    _warn(plan, limit)
    if config.figure is not None:
        from geraf2.report.plan import plan_figure  # noqa: PLC0415 - matplotlib takes 0.5 s

        plan_figure(plan, config.figure)
        say(f"drawing  {config.figure}")
    return 0


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
            ("antennas", f"{n_rows * n_columns} places, {plan.n_bytes / 1e6:.2g} MB"),
            ("time", _duration(plan.seconds)),
        ]
    )
    if plan.spacing_m > plan.nyquist_spacing_m:
        warn("the spacing is too coarse: expect ghosts at the edges of the scene")
    if plan.depth_m > plan.waveform.unambiguous_range_m > 0 and plan.waveform.n_samples > 1:
        far = plan.waveform.unambiguous_range_m
        warn(f"beyond the unambiguous range of {far:.2f} m: take more frequencies")
    if 2 * plan.depth_of_focus_m > plan.depth_m:
        warn("so far away the plane tells no depth by focusing: make it wider")
    return 0


def make_plane(config: Config) -> PlanePlan:
    """Single plane with everything that was left open filled in; as wide as it is far."""
    for name in ("box", "figure", "standoff", "planes"):
        if getattr(config, name) is not None:
            raise UserError(what=f"--depth plans a single plane, without --{name}")
    _require_numbers(config)
    depth = config.depth or 0.0
    plan = PlanePlan(
        waveform=_chosen_waveform(config),
        depth_m=depth,
        aperture_m=config.aperture or (depth, depth),
        spacing_m=config.spacing or depth,
        frame_period_s=config.frame_period_s,
        speed_m_per_s=config.speed_m_per_s,
    )
    if config.spacing is not None:
        return plan
    return replace(plan, spacing_m=float(np.floor(1e4 * plan.nyquist_spacing_m) / 1e4))


def _chosen_waveform(config: Config) -> Waveform:
    if config.radar is not None and config.preset is not None:
        raise UserError(what="give either --radar or --preset", got="both")
    return _waveform(config.radar) if config.radar else _PRESETS[config.preset or "awr1843"]


def _require_numbers(config: Config) -> None:
    for name in ("depth", "standoff", "spacing", "frame_period_s", "speed_m_per_s"):
        value = getattr(config, name)
        if value is not None:
            _require_lengths("--" + name.replace("_", "-"), (value,))
    if config.aperture is not None:
        _require_lengths("--aperture", config.aperture)


def make_plan(config: Config) -> ScanPlan:
    """Plan with everything that was left open filled in."""
    if config.box is None:
        raise UserError(what="give --box, or --depth of a single plane")
    _require_lengths("--box", config.box)
    waveform = _chosen_waveform(config)
    _require_numbers(config)
    if config.planes is not None and config.planes < 1:
        raise UserError(what="--planes must be at least 1", got=config.planes)
    if not config.elevations_deg or not (np.abs(config.elevations_deg) < 90.0).all():
        raise UserError(
            what="--elevations-deg must lie between -90 and 90", got=config.elevations_deg
        )
    standoff = config.standoff or suggested_standoff_m(config.box)
    radius = 0.5 * float(np.hypot(config.box[0], config.box[1]))
    if standoff <= radius:
        raise UserError(
            what="the box would turn into the radar",
            where="--standoff",
            expected=f"more than {radius:.3f} m, half the diagonal of the box",
            got=f"{standoff:g} m",
        )
    aperture = config.aperture or suggested_aperture_m(config.box)
    limit = nyquist_spacing_m(config.box, standoff, waveform.center_wavelength_m)
    spacing = config.spacing or np.floor(1e4 * limit) / 1e4
    return ScanPlan(
        box_m=config.box,
        waveform=waveform,
        standoff_m=standoff,
        aperture_m=aperture,
        spacing_m=float(spacing),
        n_planes=config.planes or suggested_planes(aperture, standoff),
        elevations_deg=config.elevations_deg,
        frame_period_s=config.frame_period_s,
        speed_m_per_s=config.speed_m_per_s,
    )


def _waveform(path: Path) -> Waveform:
    radar = read_toml(path, RadarManifest)
    start = radar.first_sample_hz()
    slope, rate, n_samples = radar.chirp_slope_hz_per_s, radar.sample_rate_hz, radar.n_samples
    if start is None or slope is None or rate is None or n_samples is None:
        raise UserError(
            what="does not describe the chirp",
            where=path,
            expected="start_frequency_hz, chirp_slope_hz_per_s, sample_rate_hz and n_samples",
        )
    return Waveform(
        start_frequency_hz=start,
        chirp_slope_hz_per_s=slope,
        sample_rate_hz=rate,
        n_samples=n_samples,
        path_bias_m=radar.path_bias_m or 0.0,
    )


def _require_lengths(name: str, values: tuple[float, ...]) -> None:
    if not all(np.isfinite(v) and 0.0 < v <= _MAX_SIDE_M for v in values):
        raise UserError(
            what=f"{name} must be positive, at most {_MAX_SIDE_M:g}",
            got=" ".join(f"{v:g}" for v in values),
        )


def _warn(plan: ScanPlan, limit: float) -> None:
    if plan.spacing_m > limit:
        warn("the spacing is too coarse: expect ghosts at the edges of the scene")
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
