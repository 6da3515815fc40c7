"""Importers, one file a format; others may be added by entry points.

A package adds a format by an entry point in the group ``geraf2.importers``, whose name is
the format's name on the command line and whose object is a class without arguments that
follows :class:`Importer`::

    [project.entry-points."geraf2.importers"]
    my-format = "my_package.my_format:MyImporter"

``open`` looks at the whole source, checks what can be checked without reading the samples,
and returns a :class:`Scan`; ``Scan.poses()`` then reads one pose at a time, or parts of a large
one. Positions are in metres in one right-handed frame, the signal is in the sign the source has:
the caller finds the sign of the phase out and conjugates.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Protocol

from geraf2.errors import UserError
from geraf2.io.manifest import RadarManifest, SceneManifest
from geraf2.records import RawPose

ENTRY_POINT_GROUP = "geraf2.importers"

# As in pyproject.toml: a source tree that was never installed has no entry points.
_OWN = {
    "dca1000": "geraf2.apps.importers.dca1000:Dca1000Importer",
    "geraf-sens": "geraf2.apps.importers.geraf_sens:GerafSensImporter",
    "mat": "geraf2.apps.importers.mat:MatImporter",
    "mmnorm": "geraf2.apps.importers.mmnorm:MmnormImporter",
    "planar": "geraf2.apps.importers.planar:PlanarImporter",
}


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """What the user said on the command line beside radar.toml."""

    positions: Path | None = None
    """Robot log (CSV or NPY) for captures that hold no positions."""
    config: tuple[Path, ...] = ()
    """Configuration files of the radar's own software."""
    file_per_place: bool = False
    """The source is a folder with one recording a place."""
    static: bool = False
    """The radar stood still: all frames are averaged into one place."""
    keep_good: bool = False
    """Leave out what is broken, with a note, instead of refusing the capture."""
    num_threads: int | None = None
    """Threads that read and convert samples; all cores when None."""
    phase_sign: int | None = None
    """-1 or +1: the phase of the source runs as exp(-j...) or exp(+j...), whatever else says."""


NO_OPTIONS = ImportOptions()


@dataclass(frozen=True, kw_only=True, eq=False)
class Scan:
    """What an importer found, before the samples are read."""

    manifest: SceneManifest
    """Waveform, walls, frame, provenance."""
    n_antennas: tuple[int, ...]
    """Antennas of each pose, in the order of `poses`."""
    poses: Callable[[], Iterator[RawPose]]
    """Reads the poses one at a time; may be called more than once. A pose too large for memory
    comes in consecutive parts; `n_antennas` says where it ends."""
    notes: tuple[str, ...] = ()
    """What the user should know: defaults taken, folders skipped or merged."""
    facts: tuple[tuple[str, str], ...] = ()
    """Names and values of what was found out, with the evidence."""
    thinned: Callable[[int], Sequence[RawPose]] | None = None
    """About so many antennas of some poses, scattered over them, by which the sign is found
    without reading everything; finite. None where `poses` must be read for that."""
    integers: bool = False
    """Samples of `poses` are int16, I and Q, (n_antennas, n_samples, 2), and a scene keeps them;
    the arrays may be written to."""
    phase_sign: int | None = None
    """-1 or +1 where the source itself tells the sign of its phase, exp(-j...) or exp(+j...);
    goes before all but overwhelming evidence of focusing."""


class Importer(Protocol):
    """Reads one foreign format."""

    def open(self, source: Path, radar: RadarManifest, options: ImportOptions = NO_OPTIONS) -> Scan:
        """Check `source` and describe it.

        source: file or folder the user named.
        radar: what the user gave in radar.toml; goes before what the source says.
        options: what the user said on the command line.
        """


def importer_names() -> list[str]:
    """Names of all formats that can be imported."""
    return sorted({point.name for point in entry_points(group=ENTRY_POINT_GROUP)} | set(_OWN))


def load_importer(name: str) -> Importer:
    """Find the importer of a format by its name."""
    for point in entry_points(group=ENTRY_POINT_GROUP, name=name):
        importer: Importer = point.load()()
        return importer
    if name in _OWN:
        module, _, kind = _OWN[name].partition(":")
        own: Importer = getattr(import_module(module), kind)()
        return own
    raise UserError(what=f"unknown format {name!r}", expected=" or ".join(importer_names()))
