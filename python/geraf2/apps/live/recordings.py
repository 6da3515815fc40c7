"""Raw recordings that grow: ROS 2 bags, and files of a DCA1000 with a position log."""

import re
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np

from geraf2.apps.importers import ImportOptions, RecordingOptions, Scan, load_importer
from geraf2.apps.importers.import_capture import scan_parts
from geraf2.apps.live.sources import NewPlane, Source
from geraf2.errors import UserError
from geraf2.imaging.phase_sign import find_phase_sign
from geraf2.io.container import join_parts
from geraf2.io.manifest import RadarManifest
from geraf2.io.ros import bag_files, is_finished_bag
from geraf2.io.samples import complex_pose
from geraf2.records import Pose, RawPose
from geraf2.scene.store import capture_without_poses

# A recording is read again after as many times the seconds that reading it took, and named broken
# after so long.
_PAUSES, _BROKEN_S = 4.0, 10.0
_NUMBERS = re.compile(r"[\d.]+")


class RecordingSource(Source):
    """A recording that is imported again and again; all its planes but the last one are whole.

    The last one is whole once the recording's end was written, or nothing more comes.

    options: as of the import; what is cut short or has no position yet is left out.
    """

    def __init__(
        self, path: Path, format_name: str, radar: RadarManifest, options: RecordingOptions
    ) -> None:
        super().__init__()
        self.path, self._format, self._radar = path, format_name, radar
        self._options = ImportOptions(**vars(options), keep_good=True)
        self._n_done, self._n_bytes, self._is_positive = 0, -1, False
        self._is_read = False
        self._next_s, self._broken_s = 0.0, np.inf
        self._named: set[str] = set()

    @property
    def ending(self) -> str:
        """Whether the recording's end was written, and all its planes came."""
        return "the recording has ended" if self._is_read else ""

    def poll(self, *, is_last: bool = False) -> Iterator[NewPlane]:
        """Planes that are whole; what keeps a recording from being read is named once."""
        is_finished = self._format == "rosbag" and is_finished_bag(self.path)
        n_bytes, now = self._size(), time.monotonic()
        if n_bytes != self._n_bytes:
            self.last_s = now
        elif not (is_last or is_finished):
            return
        if now < self._next_s and not is_last:
            return
        self._n_bytes = n_bytes
        try:
            scan = load_importer(self._format).open(self.path, self._radar, self._options)
            yield from self._planes(scan, is_whole=is_last or is_finished)
            self._broken_s = np.inf
        except UserError as error:
            self._broken_s = min(self._broken_s, now)
            kind = _NUMBERS.sub("", str(error))
            is_old = is_last or is_finished or now - self._broken_s > _BROKEN_S
            if is_old and kind not in self._named:
                self._named.add(kind)
                yield NewPlane(name=str(self._n_done), problem=str(error))
        self._is_read = is_finished
        self._next_s = time.monotonic() + _PAUSES * (time.monotonic() - now)

    def _size(self) -> int:
        """Bytes of the recording and its positions."""
        files = bag_files(self.path) if self._format == "rosbag" else [self.path]
        if self._format != "rosbag" and self.path.is_dir():
            files = [one for one in self.path.iterdir() if one.is_file()]
        log = self._options.positions
        return sum(one.stat().st_size for one in (*files, *([log] if log else [])))

    def _planes(self, scan: Scan, *, is_whole: bool) -> Iterator[NewPlane]:
        self.notes = scan.notes
        n_whole = len(scan.n_antennas) - (not is_whole)
        if n_whole <= self._n_done:
            return
        for number, parts in groupby(scan_parts(scan), key=lambda part: part[0]):
            pieces = [part for _, part, _ in parts]
            if self._n_done <= number < n_whole:
                pose = self._pose(scan, number, join_parts(pieces))
                self._n_done += 1
                yield NewPlane(name=str(number), pose=pose)
            if self._n_done == n_whole:
                return

    def _pose(self, scan: Scan, number: int, raw: RawPose) -> Pose:
        pose = replace(complex_pose(raw), name=str(number))
        about = capture_without_poses(scan.manifest)
        if self.about is None:
            stated = self._options.phase_sign or scan.phase_sign
            sign = find_phase_sign([pose], about.waveform, stated=stated)
            self._is_positive = sign.is_positive
            self.about = replace(about, provenance={**about.provenance, **sign.provenance})
        if about.waveform != self.about.waveform:
            raise UserError(what="is of another radar", where=f"plane {number}")
        return replace(pose, signal=np.conj(pose.signal)) if self._is_positive else pose
