"""`geraf2 inspect`: presence, completeness and identity of the parts in the box."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from geraf2._bounds import Arg
from geraf2.apps.inspection.bodies import BodyReport
from geraf2.apps.inspection.inspect_run import InspectOptions, inspect
from geraf2.apps.inspection.material import material_text
from geraf2.apps.inspection.result import FAIL, NOT_JUDGED, ModelReport, rotation_vector_deg
from geraf2.cli._console import CONSOLE, keep, rows, say, threads
from geraf2.cli._fields import Positional
from geraf2.cli._outcome import EXIT_NO, print_verdict
from geraf2.echoes.ruled_out import describe_ruled_out
from geraf2.io.run_folder import INSPECTION_NAME
from geraf2.io.text import NOT_DETERMINED


@dataclass(frozen=True, kw_only=True)
class Config:
    """Parts of a run with their sizes, compared with CAD models.

    Exit code 2: an input cannot be used; 3: what was required is not there, or cannot be
    determined because the scan is not to be trusted; with --strict also if nothing was required.

    Example: geraf2 inspect OUT --cad bracket.stl --expect 1 --tolerance-mm 3
    """

    run: Positional[Annotated[Path, Arg(metavar="OUT")]]
    """Run folder of `geraf2 reconstruct`."""
    cad: Annotated[tuple[Path, ...], Arg(metavar="FILES")] = ()
    """Closed CAD models to find (STL, PLY, OBJ, GLB)."""
    expect: Annotated[str | None, Arg(metavar="N|LIST")] = None
    """Required number of parts, or a list of CAD models (contents.toml)."""
    out: Path | None = None
    """Folder for inspection.json, inspection.csv and inspection.html; the run folder when not
    given."""
    strict: bool = False
    """Exit with code 3 if the scan is not to be trusted."""
    options: Annotated[InspectOptions, Arg(name="")] = field(default_factory=InspectOptions)
    """Options of the inspection."""


def main(config: Config) -> int:
    """Run the command."""
    wanted = config.expect
    found = inspect(
        config.run,
        config.cad,
        expect=int(wanted) if wanted is not None and wanted.isdecimal() else wanted,
        options=config.options,
        out=config.out,
        num_threads=threads(),
        listener=CONSOLE,
    )
    say(f"{len(found.parts)} in the box  ({found.intervals})")
    for number, part in enumerate(found.parts, 1):
        say(f"part {number}  {part.material.kind}")
        rows(_part(part))
    for report in found.models:
        say(f"model '{report.model.name}': {report.match.status}")
        if report.match.placement is not None:
            rows(_model(report))
    if found.ruled_out:
        say(f"ruled out  {describe_ruled_out(found.ruled_out)}")
    for text in found.notes:
        say(f"note: {text}")
    for text in found.failures:
        say(f"fails: {text}")
    nothing = ": nothing was required; --cad and --expect do"
    say(f"result   {found.result}{nothing if found.result == NOT_JUDGED else ''}")
    keep(found.to_dict())
    say(f"page     {(config.out or config.run) / f'{INSPECTION_NAME}.html'}")
    untrusted = print_verdict(found.verdict, strict=config.strict)
    return EXIT_NO if found.result in (FAIL, NOT_DETERMINED) else untrusted


def _part(part: BodyReport) -> list[tuple[str, str]]:
    lengths = " x ".join(length.text(1e3) for length in part.dimensions_m)
    exists = NOT_DETERMINED if part.probability is None else f"{100 * part.probability:.0f} %"
    return [
        ("  centre", f"{part.center_text} mm"),
        ("  along x, y, z", " x ".join(f"{1e3 * v:.1f}" for v in part.extents_m) + " mm"),
        ("  along its own axes", f"{lengths} mm"),
        ("  volume", part.volume_m3.text(1e6, unit=" cm^3")),
        ("  area", part.area_m2.text(1e4, unit=" cm^2")),
        ("  exists", exists),
        ("  material", material_text(part.material)),
        ("  seen", f"{100 * part.seen_fraction:.0f} %"),
    ]


def _model(report: ModelReport) -> list[tuple[str, str]]:
    placement, deviation = report.match.placement, report.deviation
    assert placement is not None  # or there are no rows
    turn = ", ".join(f"{value:z.1f}" for value in rotation_vector_deg(placement.pose))
    found = [
        ("  centre", f"{report.center_text} mm"),
        ("  turn", f"{turn} degrees about x, y, z"),
        ("  misfit", f"{placement.misfit:.2f}, at most {report.match.largest_misfit:.2f} passes"),
        ("  size by CAD", " x ".join(f"{1e3 * v:.1f}" for v in report.model.lengths_m) + " mm"),
    ]
    if placement.explained is not None:
        found.append(("  echoes", f"{100 * placement.explained:.0f} % of them explained"))
    if deviation is not None:
        within = f"{100 * deviation.within_fraction:.0f} % within tolerance"
        found += [
            ("  deviation", f"{1e3 * deviation.rms_m:.2f} mm rms, {within}"),
            ("  seen", f"{100 * deviation.seen_fraction:.0f} % of the model"),
        ]
    return found
