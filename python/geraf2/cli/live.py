"""`geraf2 live`: the surface grows while the scan is made."""

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from annotated_types import Interval

from geraf2._bounds import Arg
from geraf2.apps.importers import RecordingOptions
from geraf2.apps.live.follow import LiveOptions, PlaneReport, follow
from geraf2.apps.live.target import Target
from geraf2.apps.viewing.server import LiveView
from geraf2.cli._console import CONSOLE, say, threads, warn
from geraf2.cli._fields import Positional, part_of
from geraf2.cli._outcome import print_found, print_next, print_verdict
from geraf2.io.manifest import RadarManifest
from geraf2.io.toml import read_toml
from geraf2.pipeline.prior import PriorSource


@dataclass(frozen=True, kw_only=True)
class Config(PriorSource, RecordingOptions):
    """Reconstruct a scan while it is made: one line a plane, and OUT is updated after each.

    The same command continues after a stop. The last lines say how far the result can be trusted.
    For example: geraf2 live SOURCE out --until "expected 1 mm over 90 %"
    """

    source: Positional[Annotated[str, Arg(metavar="SOURCE")]]
    """Scan that grows or is whole: a scene, a folder of GeRaF-SENS, a ROS 2 bag, files of a DCA1000
    with --positions; or a socket of this machine, tcp://localhost:PORT or unix:PATH."""
    out: Positional[Annotated[Path, Arg(metavar="OUT")]] = Path("out")
    """Run folder; its folder scene keeps the planes."""
    preset: Annotated[str, Arg(metavar="NAME")] = "best"
    """best or fast."""
    until: Annotated[str | None, Arg(metavar="TARGET")] = None
    """End when the surface is reliable and as good: "expected 1 mm over 90 %" of the area."""
    idle: Annotated[float, Interval(ge=0.1, le=1e6), Arg(metavar="SECONDS")] = 60.0
    """End when no plane came for this time, or when all came that SOURCE announces."""
    view: bool = False
    """Show the surface in a browser while it grows, with the planes so far."""
    port: Annotated[int, Interval(ge=1, le=65535)] = 8080
    """Port of that page, on this machine alone."""
    radar: Path | None = None
    """TOML file with radar parameters that a recording lacks; they go before its own."""
    no_report: bool = False
    """Leave out the report."""
    strict: bool = False
    """Exit with code 3 if the result is not to be trusted."""


def main(config: Config) -> int:
    """Run the command."""
    until = None if config.until is None else Target.of(config.until)
    ending = LiveOptions(
        radar=read_toml(config.radar, RadarManifest) if config.radar else None,
        recording=part_of(config, RecordingOptions),
        until=until,
        idle_s=config.idle,
        report=not config.no_report,
    )
    with ExitStack() as stack:
        if config.view:
            page = LiveView([config.out], port=config.port, waits=True)
            stack.callback(page.stop)
            say(f"page     {page.url}")
            say(f"over SSH {page.ssh_line}")
        found = follow(
            config.source,
            config.out,
            part_of(config, PriorSource),
            config.preset,
            ending=ending,
            listener=CONSOLE,
            on_plane=_show,
            num_threads=threads(),
        )
    say(f"{found.n_planes} planes: {found.reason}")
    print_found(found.result)
    print_next(found.result)
    return print_verdict(found.result.verdict, strict=config.strict)


def _show(report: PlaneReport) -> None:
    if report.is_left_out:
        warn(report.problem)
        return
    found, error_mm = f"no surface yet: {report.problem}", report.expected_error_mm
    if report.seen_share is not None:
        error = "not determined" if error_mm is None else f"{error_mm:.2f} mm"
        found = f"expected error {error}  seen {100 * report.seen_share:.0f} %"
    if report.stated_f1 is not None:
        low, middle, high = report.stated_f1
        found += f"  F1 {middle:.2f} ({low:.2f} to {high:.2f})"
    if report.verdict is not None:
        found += f"  {report.verdict.trust}"
    say(f"plane {report.plane:3d}  {report.n_peaks:4d} peaks  {found}  {report.seconds:.1f} s")
