"""`geraf2 belt`: parcels on a belt, one after the other."""

from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path
from typing import Annotated

from geraf2._bounds import Arg
from geraf2.apps.belt.running import STEM, BeltOptions, run_belt
from geraf2.cli._console import keep, rows, say, threads
from geraf2.cli._fields import Positional


@dataclass(frozen=True, kw_only=True)
class Config(BeltOptions):
    """Cut a stream of parcels apart, and reconstruct each on a worker: a folder and a row each.

    The same command continues after a stop. For example: geraf2 belt STREAM out --workers 2
    """

    stream: Positional[Annotated[Path, Arg(metavar="STREAM")]]
    """Scene folder with belt.json, as of `geraf2 simulate` with [belt]; it may grow."""
    out: Positional[Annotated[Path, Arg(metavar="OUT")]]
    """Folder for parcels/, runs/, results/ and parcels.html."""
    preset: Annotated[str, Arg(metavar="NAME")] = "best"
    """As of `geraf2 reconstruct`."""


def main(config: Config) -> int:
    """Run the command; exit code 2 if a parcel failed."""
    options = replace(config, threads=threads())
    found = run_belt(config.stream, config.out, config.preset, options=options, on_line=say)
    keep({"done": found.n_done, "failed": found.n_failed, "cpu_seconds": found.cpu_seconds})
    keep({"per_hour": found.per_hour, "cores_for_6000_per_hour": found.cores})
    rows(
        [
            ("parcels", f"{found.n_done} done, {found.n_failed} failed"),
            (
                "rate",
                f"{found.per_hour:.0f} an hour here; {found.cpu_seconds:.1f} CPU s each, "
                f"{ceil(found.cores)} cores for 6,000 an hour",
            ),
            ("page", str(config.out / f"{STEM}.html")),
        ]
    )
    return 2 if found.n_failed else 0
