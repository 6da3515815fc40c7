"""Sources of planes while a scan is made; folders to which it is written, plane by plane."""

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from geraf2.apps.importers.geraf_sens import (
    FRAME_NAME,
    Frame,
    capture_manifest,
    check_headers,
    group_frames,
    read_capture_json,
    read_group,
)
from geraf2.errors import UserError
from geraf2.imaging.phase_sign import find_phase_sign
from geraf2.io.container import RADAR_NAME, SceneReader, is_scene
from geraf2.io.growing_scene import may_grow
from geraf2.io.manifest import RadarManifest
from geraf2.io.samples import complex_pose
from geraf2.records import Pose
from geraf2.scene.store import capture_without_poses

if TYPE_CHECKING:
    from geraf2.scene import Capture

N_PLANES_KEY = "n_planes"
"""Entry of a scene's provenance: how many planes it will have."""
_SOURCES = (
    "a scene folder, mf/<index>_<angle>_<sub>/ as GeRaF-SENS writes, a rosbag2 folder, .mcap, "
    ".db3, .bin of a DCA1000, tcp://localhost:PORT or unix:PATH"
)
# Files that nobody wrote to for so long are not being written [s].
_SETTLED_S = 2.0


@dataclass(frozen=True, kw_only=True, eq=False)
class NewPlane:
    """A plane that came, or why it cannot be used."""

    name: str
    pose: Pose | None = None
    problem: str = ""


class Source(ABC):
    """Where the planes of a scan come from, while it is made."""

    def __init__(self) -> None:
        self.about: Capture | None = None
        """Waveform, walls and provenance, without planes; None until the source states them."""
        self.last_s = time.monotonic()
        """When something came last, of `time.monotonic` [s]."""
        self.notes: tuple[str, ...] = ()
        """Warnings about what was read."""

    @property
    @abstractmethod
    def ending(self) -> str:
        """Why no more planes come; empty as long as some may."""

    @abstractmethod
    def poll(self, *, is_last: bool = False) -> Iterator[NewPlane]:
        """Planes that are whole and did not come before; those that are half written wait.

        is_last: also planes that more may belong to.
        """

    def close(self) -> None:  # noqa: B027 - a folder has nothing to close
        """Let other processes use what the source has opened."""


class FolderSource(Source):
    """A folder that grows."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path = path
        self.n_planes: int | None = None
        """Number of planes that the folder announces; None where it does not."""
        self._done: set[str] = set()
        self._named: set[str] = set()

    @property
    def ending(self) -> str:
        """Whether all planes came that were announced."""
        if self.n_planes is None or len(self._done) < self.n_planes:
            return ""
        return f"all {self.n_planes} planes of the scan came"

    def poll(self, *, is_last: bool = False) -> Iterator[NewPlane]:
        """Planes that came; one that cannot be read, and that nobody writes to, is named once.

        It comes when it is repaired.
        """
        for name, folder in self._find_planes():
            if name in self._done:
                continue
            try:
                pose = self._read(name, is_last=is_last)
            except UserError as error:
                if name not in self._named and (is_last or _age_s(folder) > _SETTLED_S):
                    self._named.add(name)
                    yield NewPlane(name=name, problem=str(error))
                continue
            if pose is not None:
                self._done.add(name)
                self.last_s = time.monotonic()
                yield NewPlane(name=name, pose=pose)

    @abstractmethod
    def _find_planes(self) -> list[tuple[str, Path]]:
        """Name and folder of each plane that is there, whole or not."""

    @abstractmethod
    def _read(self, name: str, *, is_last: bool) -> Pose | None:
        """Read a plane; None while parts of it are expected, UserError where it is not whole."""


class SceneSource(FolderSource):
    """A scene folder in this project's own layout, such as `GrowingScene` writes."""

    def _find_planes(self) -> list[tuple[str, Path]]:
        try:
            self._reader = SceneReader(self.path)
        except UserError:  # between two planes
            return []
        if self.about is None:
            self.about = capture_without_poses(self._reader.manifest)
            announced = self.about.provenance.get(N_PLANES_KEY, "")
            if announced.isdecimal():
                self.n_planes = int(announced)
            elif not may_grow(self.path):
                self.n_planes = self._reader.n_poses
        folder = self.path / RADAR_NAME
        return [(str(number), folder) for number in range(self._reader.n_poses)]

    def _read(self, name: str, *, is_last: bool) -> Pose | None:
        del is_last  # a plane of a scene is whole
        assert self.about is not None  # see _find_planes
        if self._reader.manifest.waveform != self.about.waveform:
            raise UserError(what="is of another radar", where=f"plane {name}")
        return self._reader.read_pose(int(name))


class GerafSensSource(FolderSource):
    """A folder in the layout of GeRaF-SENS; sub-scans of one index and angle are a plane."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._is_positive = False

    def _find_planes(self) -> list[tuple[str, Path]]:
        root = self.path / "mf" if (self.path / "mf").is_dir() else self.path
        self._folders: dict[str, list[Path]] = {}
        frames = [entry for entry in root.iterdir() if FRAME_NAME.fullmatch(entry.name)]
        for name, group in groupby(sorted(frames, key=_sort_key), key=_plane_name):
            self._folders[name] = list(group)
        return [(name, folders[-1]) for name, folders in self._folders.items()]

    def _read(self, name: str, *, is_last: bool) -> Pose | None:
        folders = self._folders[name]
        frames = [check_headers(folder) for folder in folders]
        begun = name != list(self._folders)[-1]
        if not (is_last or begun or max(map(_age_s, folders)) > _SETTLED_S):
            return None
        groups = group_frames(frames)
        if len(groups) > 1:
            raise UserError(
                what="has sub-scans that repeat positions, or with other axes",
                where=folders[0],
                hint="give them indices of their own",
            )
        pose = complex_pose(read_group(groups[0]))
        if self.about is None:
            self._begin(pose, frames[0])
        if self._is_positive:
            pose = replace(pose, signal=np.conj(pose.signal))
        return pose

    def _begin(self, pose: Pose, frame: Frame) -> None:
        """Take waveform and sign of the phase from the first plane."""
        stated = read_capture_json(self.path)
        manifest, _ = capture_manifest(self.path, stated, RadarManifest(), frame.n_samples)
        about = capture_without_poses(manifest)
        sign = find_phase_sign([pose], about.waveform)
        self._is_positive = sign.is_positive
        self.about = replace(about, provenance={**about.provenance, **sign.provenance})
        announced = stated.get("n_poses")
        self.n_planes = announced if isinstance(announced, int) and announced > 0 else None


def folder_source(path: Path) -> FolderSource | None:
    """Source of a folder by what is in it; None while nothing is."""
    if path.exists() and not path.is_dir():
        raise UserError(what="is a file", where=path, expected=_SOURCES)
    if is_scene(path):
        return SceneSource(path)
    if not path.is_dir():
        return None
    names = {entry.name for entry in path.iterdir() if not entry.name.startswith(".")}
    if names <= {RADAR_NAME}:  # a scene that is begun
        return None
    if names & {"mf", "capture.json"} or any(map(FRAME_NAME.fullmatch, names)):
        return GerafSensSource(path)
    raise UserError(
        what="is no scan that grows",
        where=path,
        expected=_SOURCES,
    )


def _sort_key(folder: Path) -> tuple[int, float, int]:
    match = FRAME_NAME.fullmatch(folder.name)
    assert match is not None  # only frames get here
    return int(match["index"]), float(match["angle"]), int(match["sub"])


def _plane_name(folder: Path) -> str:
    return folder.name.rpartition("_")[0]


def _age_s(folder: Path) -> float:
    """Time since the newest file of a folder was written [s]."""
    files = [folder, *(entry for entry in folder.iterdir() if entry.is_file())]
    return time.time() - max(file.stat().st_mtime for file in files)
