"""A capture in memory: poses, waveform, frame, walls."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import overload

from geraf2.io.manifest import CalibrationManifest
from geraf2.records import Pose, Wall, Waveform


class LazyPoses(Sequence[Pose]):
    """Poses that are read, or computed, at each access; none is kept.

    n_antennas: of each pose. read: gives the pose of an index.
    """

    def __init__(self, n_antennas: Sequence[int], read: Callable[[int], Pose]) -> None:
        self.n_antennas = tuple(int(n) for n in n_antennas)
        self._read = read

    def __len__(self) -> int:
        return len(self.n_antennas)

    @overload
    def __getitem__(self, index: int) -> Pose: ...
    @overload
    def __getitem__(self, index: slice) -> "LazyPoses": ...
    def __getitem__(self, index: int | slice) -> "Pose | LazyPoses":
        """Pose of an index; of a slice, some of them, which are not read yet."""
        if isinstance(index, slice):
            chosen = range(len(self))[index]
            return LazyPoses(self.n_antennas[index], lambda i: self._read(chosen[i]))
        return self._read(range(len(self))[index])

    def map(self, function: Callable[[int, Pose], Pose]) -> "LazyPoses":
        """Poses that a function makes of index and pose when they are asked for."""
        return LazyPoses(self.n_antennas, lambda i: function(i, self._read(i)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Capture:
    """Measurements of a radar, in metres, in one named frame.

    Raises
    ------
    UserError
        Where a capture whose parts do not go together is read, reconstructed or saved.

    Examples
    --------
    >>> capture, truth = geraf2.examples.small_capture()
    >>> len(capture.poses), capture.n_antennas, capture.walls[0].size_m
    (6, 2646, (0.16, 0.16, 0.16))
    """

    waveform: Waveform
    poses: Sequence[Pose]
    """Scan planes: a tuple in memory, or :class:`LazyPoses`, which are read each time."""
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
        return sum(self.pose_sizes)

    @property
    def pose_sizes(self) -> tuple[int, ...]:
        """Antennas of each pose; nothing is read."""
        if isinstance(self.poses, LazyPoses):
            return self.poses.n_antennas
        return tuple(pose.n_antennas for pose in self.poses)

    def load(self) -> "Capture":
        """Return the same with all poses read; itself where they are."""
        if isinstance(self.poses, tuple):
            return self
        return replace(self, poses=tuple(self.poses))

    def __repr__(self) -> str:
        """Summary in a line, without its arrays."""
        return (
            f"Capture({len(self.poses)} planes, {self.n_antennas} antennas, "
            f"{self.waveform.n_samples} samples a chirp, {len(self.walls)} walls)"
        )
