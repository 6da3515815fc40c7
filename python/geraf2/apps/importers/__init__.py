"""Importers of foreign capture formats, one module a format; packages may add more.

A package adds a format by an entry point in the group ``geraf2.importers``. The name of the entry
point is the format's name on the command line; its object is a class without arguments that
follows :class:`Importer`::

    [project.entry-points."geraf2.importers"]
    my-format = "my_package.my_format:MyImporter"

``open`` checks the source without reading the samples and returns a :class:`Scan`.
``Scan.poses()`` then reads one pose at a time, or parts of a large one. Positions are in metres in
one right-handed frame. The signal keeps the phase sign of the source: the caller estimates the sign
and conjugates.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Annotated, Protocol

from annotated_types import Interval

from geraf2._bounds import Arg, ThreadCount
from geraf2.errors import UserError
from geraf2.io.manifest import RadarManifest, SceneManifest
from geraf2.records import RawPose

ENTRY_POINT_GROUP = "geraf2.importers"
_OffsetMs = Annotated[float, Interval(ge=-1e6, le=1e6)]

# As in pyproject.toml: a source tree that was never installed has no entry points.
_OWN = {
    "dca1000": "dca1000:Dca1000Importer",
    "geraf-sens": "geraf_sens:GerafSensImporter",
    "mat": "mat:MatImporter",
    "mmnorm": "mmnorm:MmnormImporter",
    "planar": "planar:PlanarImporter",
    "rosbag": "rosbag:RosbagImporter",
}


@dataclass(frozen=True, kw_only=True)
class RecordingOptions:
    """Options for raw samples with their positions."""

    positions: Path | None = None
    """Robot log, CSV or NPY: time_s, x_m, y_m, z_m, optionally qw, qx, qy, qz, file."""
    config: tuple[Path, ...] = ()
    """Files of the radar's own software: *.mmwave.json, cf.json, *.cfg, *LogFile.txt, *.lua."""
    adc_topic: Annotated[str | None, Arg(metavar="TOPIC")] = None
    """Topic of a bag with the radar's samples, where several may be meant."""
    pose_topic: Annotated[str | None, Arg(metavar="TOPIC")] = None
    """Topic of a bag with the radar's poses, where several may be meant."""
    frames: Annotated[tuple[str, str] | None, Arg(metavar="FIXED RADAR")] = None
    """Frames of a bag between which the transforms are chained."""
    clock_offset_ms: _OffsetMs | None = None
    """By how much the radar's time stamps in a bag are late; estimated when not given."""
    phase_sign: Annotated[int | None, Arg(metavar="-1|+1")] = None
    """The phase runs as exp(-j...) or exp(+j...), whatever format and image indicate."""

    def __post_init__(self) -> None:
        if self.phase_sign not in (None, -1, 1):
            raise UserError(what="must be -1 or +1", where="--phase-sign", got=self.phase_sign)


@dataclass(frozen=True, kw_only=True)
class ImportOptions(RecordingOptions):
    """Options of the command line, beside radar.toml."""

    arrays: Annotated[tuple[str, ...], Arg(metavar="OURS=THEIRS")] = ()
    """Names of arrays in a MATLAB file, as signal=sarData positions=scan.xyz; they go before
    [arrays] of --radar."""
    file_per_position: bool = False
    """The source holds one recording a position; a column 'file' of the positions names it, else
    their numbers."""
    static: bool = False
    """The radar stood still: all frames are averaged."""
    keep_good: bool = False
    """Leave out what is broken (a last frame cut short, rows with NaN, ...), with a note."""
    num_threads: Annotated[ThreadCount | None, Arg(hidden=True)] = None
    """Threads to use; all when not given."""


NO_OPTIONS = ImportOptions()


@dataclass(frozen=True, kw_only=True, eq=False)
class Scan:
    """Description of a capture, before its samples are read."""

    manifest: SceneManifest
    """Waveform, walls, frame, provenance."""
    n_antennas: tuple[int, ...]
    """Antennas of each pose, in the order of `poses`."""
    poses: Callable[[], Iterator[RawPose]]
    """Reads the poses one at a time; may be called more than once. A pose too large for memory
    comes in consecutive parts, `n_antennas` antennas in all."""
    notes: tuple[str, ...] = ()
    """Warnings: assumed defaults, skipped or merged folders."""
    facts: tuple[tuple[str, str], ...] = ()
    """Names and values of what the importer estimated, with the evidence."""
    thinned: Callable[[int], Sequence[RawPose]] | None = None
    """About this many antennas scattered over some poses, from which the sign of the phase is
    estimated without reading everything; finite. None: `poses` must be read for that."""
    integers: bool = False
    """Samples of `poses` are int16, I and Q, (n_antennas, n_samples, 2), and stored as such. The
    arrays may be modified."""
    phase_sign: int | None = None
    """-1 or +1 where the format defines the sign of the phase, exp(-j...) or exp(+j...); overruled
    only by overwhelming evidence of focusing."""


class Importer(Protocol):
    """Reads one foreign format."""

    def open(self, source: Path, radar: RadarManifest, options: ImportOptions = NO_OPTIONS) -> Scan:
        """Check `source` and describe it.

        source: file or folder the user named.
        radar: parameters of radar.toml; override those of the source.
        options: options of the command line.
        """


def load_importer(name: str) -> Importer:
    """Return the importer of a format; UserError for an unknown one."""
    own = [EntryPoint(n, f"{__name__}.{v}", ENTRY_POINT_GROUP) for n, v in _OWN.items()]
    points = {point.name: point for point in (*own, *entry_points(group=ENTRY_POINT_GROUP))}
    if name not in points:
        raise UserError(what=f"unknown format {name!r}", expected=" or ".join(sorted(points)))
    importer: Importer = points[name].load()()
    return importer
