"""Source of a live scan by what its name and its files are."""

from pathlib import Path

from geraf2.apps.importers import RecordingOptions
from geraf2.apps.live.recordings import RecordingSource
from geraf2.apps.live.sockets import SocketSource, is_address
from geraf2.apps.live.sources import Source, folder_source
from geraf2.io.container import is_scene
from geraf2.io.manifest import RadarManifest
from geraf2.io.ros import bag_files, is_bag

_DCA1000 = ".bin"


def open_source(
    source: Path | str,
    radar: RadarManifest | None = None,
    recording: RecordingOptions | None = None,
) -> Source | None:
    """Source of a socket's address, a file or a folder; None while nothing is there.

    radar, recording: as of an import. UserError for what is no source.
    """
    if is_address(str(source)):
        return SocketSource(str(source))
    path = Path(source)
    name = None if is_scene(path) else _format(path)
    if name is None:
        return folder_source(path)
    return RecordingSource(path, name, radar or RadarManifest(), recording or RecordingOptions())


def _format(path: Path) -> str | None:
    """Format of a raw recording; None for anything else."""
    if is_bag(path) or (path.is_dir() and bag_files(path)):
        return "rosbag"
    files = [path] if path.is_file() else path.iterdir() if path.is_dir() else ()
    return "dca1000" if any(one.suffix == _DCA1000 for one in files) else None
