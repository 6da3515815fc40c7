"""Importers, one file a format; others may be added by entry points.

A package adds a format by an entry point in the group ``geraf2.importers``, whose name is
the format's name on the command line and whose object is a class without arguments that
follows :class:`Importer`::

    [project.entry-points."geraf2.importers"]
    my-format = "my_package.my_format:MyImporter"

``open`` looks at the whole source, checks what can be checked without reading the samples,
and returns a :class:`Scan`; ``Scan.poses()`` then reads one pose at a time. Positions are in
metres in one right-handed frame, the signal is complex64 in the sign the source has: the
caller finds the sign of the phase out and conjugates.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Protocol

from geraf2.errors import UserError
from geraf2.io.container import PoseArrays
from geraf2.io.manifest import RadarManifest, SceneManifest

ENTRY_POINT_GROUP = "geraf2.importers"


@dataclass(frozen=True, kw_only=True, eq=False)
class Scan:
    """What an importer found, before the samples are read."""

    manifest: SceneManifest
    """Waveform, walls, frame, provenance."""
    n_antennas: tuple[int, ...]
    """Antennas of each pose, in the order of `poses`."""
    poses: Callable[[], Iterator[PoseArrays]]
    """Reads the poses one at a time; may be called more than once."""
    notes: tuple[str, ...] = ()
    """What the user should know: defaults taken, folders skipped or merged."""


class Importer(Protocol):
    """Reads one foreign format."""

    def open(self, source: Path, radar: RadarManifest) -> Scan:
        """Check `source` and describe it.

        Parameters
        ----------
        source
            File or folder the user named.
        radar
            What the user gave in radar.toml; goes before what the source says.
        """


def importer_names() -> list[str]:
    """Names of all formats that can be imported."""
    return sorted({point.name for point in entry_points(group=ENTRY_POINT_GROUP)} | {"geraf-sens"})


def load_importer(name: str) -> Importer:
    """Find the importer of a format by its name."""
    for point in entry_points(group=ENTRY_POINT_GROUP, name=name):
        importer: Importer = point.load()()
        return importer
    if name == "geraf-sens":  # a source tree that was never installed has no entry points
        from geraf2.io.importers.geraf_sens import GerafSensImporter  # noqa: PLC0415 - cycle

        return GerafSensImporter()
    raise UserError(what=f"unknown format {name!r}", expected=" or ".join(importer_names()))
