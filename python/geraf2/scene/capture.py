"""A capture in memory: poses, waveform, frame, walls."""

from dataclasses import dataclass, field

from geraf2.io.manifest import CalibrationManifest
from geraf2.records import Pose, Wall, Waveform


@dataclass(frozen=True, kw_only=True, eq=False)
class Capture:
    """Everything the radar measured, in metres, in one named frame.

    What does not go together is a UserError where a capture is read, reconstructed or saved.

    >>> capture, truth = geraf2.examples.small_capture()
    >>> len(capture.poses), capture.n_antennas, capture.walls[0].size_m
    (6, 2646, (0.16, 0.16, 0.16))
    """

    waveform: Waveform
    poses: tuple[Pose, ...]
    frame: str = "capture"
    """Name of the right-handed frame that positions are given in."""
    walls: tuple[Wall, ...] = ()
    """Known walls, outermost first; empty when nothing is known."""
    calibration: tuple[CalibrationManifest, ...] = ()
    """What calibrations found, in order; samples, positions and delay already have it."""
    provenance: dict[str, str] = field(default_factory=dict)
    """Where the capture came from: importer, source, phase sign found, seed."""

    @property
    def n_antennas(self) -> int:
        """Antennas over all poses."""
        return sum(pose.n_antennas for pose in self.poses)
