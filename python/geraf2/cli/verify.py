"""`geraf2 verify`: check that a folder is unchanged since it was written."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from geraf2._bounds import Arg
from geraf2.cli._console import keep, say, warn
from geraf2.cli._fields import Positional
from geraf2.pipeline.commands.verify import verify


@dataclass(frozen=True, kw_only=True)
class Config:
    """Compare a run, a prior or a scene with its checksums; changes nothing."""

    folder: Positional[Annotated[Path, Arg(metavar="OUT")]]
    """Run folder, folder of `geraf2 los`, or scene."""


def main(config: Config) -> int:
    """Run the command; a file that is missing or changed is an error."""
    found = verify(config.folder)
    for note in found.notes:
        warn(note)
    keep({"kind": found.kind, "n_files": found.n_files})
    things = "planes" if found.kind == "scene" else "files"
    say(f"{found.kind} of {found.n_files} {things}, each as it was written")
    return 0
