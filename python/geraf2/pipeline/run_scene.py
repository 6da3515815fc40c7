"""Capture of a run."""

from pathlib import Path

from geraf2.errors import UserError
from geraf2.pipeline.reconstruction import Reconstruction
from geraf2.pipeline.stages.calibration import correct_capture
from geraf2.scene import Capture, load_capture
from geraf2.scene.store import capture_digest


def capture_of(result: Reconstruction, scene: Path | str | Capture | None) -> Capture:
    """Capture of a run with its corrections, as the stages used it.

    scene: capture or its folder; by default the folder in the run's record.

    Raises UserError if it is missing, or another scene.
    """
    path = result.record.scene if scene is None else scene
    if path is None:  # the capture was in memory, or its path is not UTF-8 text
        raise UserError(
            what="the run does not record where its scene is",
            where=result.path,
            hint="name it with --scene",
        )
    if scene is None and not (isinstance(path, Path) and path.exists()):
        raise UserError(
            what="the scene of the run is no longer there",
            where=path,
            hint=f"name it with --scene; it was called {result.run.scene_name!r}",
        )
    capture = path if isinstance(path, Capture) else load_capture(path)
    if capture_digest(capture) != result.run.scene_digest:
        raise UserError(
            what="is not the scene of the run",
            where="capture" if isinstance(path, Capture) else path,
            expected=repr(result.run.scene_name),
            hint="name it with --scene",
        )
    return correct_capture(result.run, capture)
