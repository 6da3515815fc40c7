"""`geraf2 view`: a run or a scene in 3D in a browser."""

import signal
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from annotated_types import Interval

from geraf2._bounds import Arg
from geraf2.apps.viewing.server import LiveView
from geraf2.cli._console import say
from geraf2.cli._fields import Positional
from geraf2.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Config:
    """Serve a page with the layers, slices and planes of a run or scene, of two side by side.

    Example: geraf2 view OUT --port 8090
    """

    paths: Positional[Annotated[tuple[Path, ...], Arg(metavar="OUT|SCENE")]]
    """Run folder or scene; two are shown side by side."""
    port: Annotated[int, Interval(ge=1, le=65535)] = 8080
    """Port of the page."""
    host: str = "127.0.0.1"
    """Address that it listens on; 0.0.0.0 lets other machines connect."""


def main(config: Config) -> int:
    """Run the command; Ctrl-C is its normal end."""
    if not 1 <= len(config.paths) <= 2:
        raise UserError(what="give one run or scene, or two", got=len(config.paths))
    view = LiveView(config.paths, port=config.port, host=config.host)
    try:
        say(f"page     {view.url}")
        say(f"over SSH {view.ssh_line}")
        say("Ctrl-C ends it")
        threading.Event().wait()
    except KeyboardInterrupt as stop:
        if stop.args and stop.args[0] != signal.SIGINT:
            raise
    finally:
        view.stop()
    return 0
