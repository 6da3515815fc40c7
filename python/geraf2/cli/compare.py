"""`geraf2 compare`: what changed in a packed box since reference scans."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from annotated_types import Interval

from geraf2._bounds import Arg
from geraf2.apps.inspection.compare_runs import compare
from geraf2.cli._console import CONSOLE, keep, rows, say, threads
from geraf2.cli._fields import Positional
from geraf2.cli._outcome import EXIT_NO, print_verdict
from geraf2.io.run_folder import COMPARISON_NAME


@dataclass(frozen=True, kw_only=True)
class Config:
    """What appeared, vanished or moved since reference runs.

    Exit code 2: an input cannot be used; 3: something changed, or a run is not to be trusted.

    Example: geraf2 compare today packed
    """

    run: Positional[Annotated[Path, Arg(metavar="RUN")]]
    """Run folder of `geraf2 reconstruct`."""
    references: Positional[Annotated[tuple[Path, ...], Arg(metavar="REFERENCE...")]]
    """Runs of the same packed box; a change differs from all of them."""
    tolerance_mm: Annotated[float, Interval(gt=0.0, le=1000.0)] = 0.5
    """Largest shift of a part that is no change [mm]."""
    out: Path | None = None
    """Folder for comparison.json, comparison.html (3D) and comparison.glb; the run folder when not
    given."""


def main(config: Config) -> int:
    """Run the command."""
    found = compare(
        config.run,
        config.references,
        tolerance_mm=config.tolerance_mm,
        out=config.out,
        num_threads=threads(),
        listener=CONSOLE,
    )
    shift = ", ".join(f"{1e3 * x:.1f}" for x in found.shift_m)
    rows(
        [
            ("parts", f"{found.n_parts[0]}, before " + ", ".join(map(str, found.n_parts[1:]))),
            ("registered", f"moved by ({shift}) mm, turned by {found.turn_deg:.2f} degrees"),
            ("compared", f"{100 * found.compared_fraction:.0f} % of the glints: in view of both"),
        ]
    )
    for change in found.changes:
        say(f"changed  {change}")
    say(f"result   {found.answer}")
    keep(found.to_dict())
    say(f"page     {(config.out or config.run) / f'{COMPARISON_NAME}.html'}")
    untrusted = print_verdict(found.verdict, strict=True)
    return EXIT_NO if found.changed else untrusted
