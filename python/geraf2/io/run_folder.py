"""The folder of a run: which scene it belongs to, which stages are done, and what they wrote.

`run.json` holds the hash of the scene, and per stage the key (a hash of all that the stage
depends on), the hash of each file it wrote, its numbers and its times. A stage is reused only
if its key is the same and its files are still what they were; so an interrupted run continues
where it stopped, and a changed setting runs again exactly the stages that depend on it. Who writes
into the folder holds `run.lock`. `log.jsonl` is for people and the report; no stage reads it.
"""

import glob
import hashlib
import json
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, is_dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from filelock import SoftFileLock, Timeout

from geraf2.errors import UserError
from geraf2.io.atomic import sweep_folder, write_json_atomic
from geraf2.io.digests import file_digest, inside
from geraf2.io.outputs import is_passing, require_consent, require_folder
from geraf2.io.regular import RECORD_BYTES, read_regular, require_no_links
from geraf2.io.stage_numbers import checked_numbers
from geraf2.io.text import parse_json

RUN_NAME = "run.json"
LOCK_NAME = "run.lock"
LOG_NAME = "log.jsonl"
CONFIG_NAME = "config.toml"
PLANES_NAME = "planes.json"
"""Rectangles that the antennas covered, for drawings."""
PRIOR_NAME = "prior.npz"
"""Outside of the box as the run read it, with its walls."""
CALIBRATION_NAME = "calibration.npz"
"""Corrections that were applied to the capture."""
GLINTS_NAME = "glints.npz"
BACK_NAME = "back_glints.npz"
"""Glints seen through a dielectric, which the surface is not drawn through."""
PEAKS_NAME = "peaks.ply"
RIM_NAME = "rim_glints.npz"
SILHOUETTES_NAME = "silhouettes.npz"
"""Outlines of the content on the far walls of the box, of `--preset best`."""
FIT_NAME = "sdf_fit.npz"
"""Field as fitted: its gradient is below 1 and it holds every fragment."""
SDF_NAME = "sdf.npz"
"""Distance to the content's mesh."""
SAMPLES_NAME = "samples.npz"
"""Surfaces drawn from the posterior, where they were asked for."""
CHECKPOINT_NAME = "checkpoint.safetensors"
FIELDS_NAME = "fields.safetensors"
ECHO_NAME = "echo.safetensors"
"""Scatterers beside the surface, fitted to the residual of its echo."""
LIVE_FOLDER = "live"
TENSORBOARD_FOLDER = "tensorboard"
CONTENT_NAME = "mesh_content.ply"
"""The content without the box; every preset writes it."""
GHOSTS_NAME = "mesh_ghosts.ply"
BOX_NAME = "mesh_box.ply"
MESH_NAME = "mesh.ply"
"""Both together."""
IMAGE_NAME = "image.npz"
METRICS_NAME = "metrics.json"
PROVENANCE_NAME = "provenance.json"
REPORT_NAME = "report.html"
INSPECTION_NAME = "inspection"
"""Stem of `inspection.json`, `.csv` and `.html`."""
COMPARISON_NAME = "comparison"
FIGURES_FOLDER = "figures"
ERRORS_NAME = "errors.png"
VIEWS_FOLDER = "views"
PSNR_NAME = "psnr.json"
TRUTH_PICTURES = ("mesh.png", ERRORS_NAME, "slices.png", "shadows.png")
"""Pictures of the mesh that also show the truth, where `geraf2 evaluate` drew them."""
TRUTH_COPY = f"{FIGURES_FOLDER}/truth.npz"
"""The truth and the distances to it, for the report's view in 3D."""
REPORT_FILES = (REPORT_NAME, PROVENANCE_NAME, f"{FIGURES_FOLDER}/*.png", TRUTH_COPY)
"""Patterns of the files of a report."""
_DERIVED = (
    METRICS_NAME,
    f"{INSPECTION_NAME}.*",
    REPORT_NAME,
    *(f"{FIGURES_FOLDER}/{name}" for name in TRUTH_PICTURES),
    TRUTH_COPY,
    f"{VIEWS_FOLDER}/{PSNR_NAME}",
    f"{VIEWS_FOLDER}/angle_*",
)
"""Patterns of files that describe one mesh_content.ply."""
_OF_A_SCENE = (
    *_DERIVED,
    CONFIG_NAME,
    PLANES_NAME,
    PRIOR_NAME,
    PROVENANCE_NAME,
    LOG_NAME,
    CHECKPOINT_NAME,
    f"{FIGURES_FOLDER}/*.png",
    f"{LIVE_FOLDER}/*.png",
    f"{TENSORBOARD_FOLDER}/events.*",
    "los/*",
)
"""Patterns of all that a run writes beside the files of its stages."""
_FORMAT = "geraf2-run"
_VERSION = 3
_NAMED_S = 0.5
"""A process names itself in its lock within microseconds of making it."""


@dataclass(frozen=True, kw_only=True)
class StageRecord:
    """A stage that is done."""

    key: str
    """Hash of everything the stage depended on."""
    files: dict[str, str]
    """Hash of each file it wrote, by its path in the folder."""
    seconds: float
    """How long it took [s]."""
    cpu_seconds: float = 0.0
    """Processor time that it took, of all threads [s]."""
    peak_memory_mib: float = 0.0
    """Largest resident set of the process up to its end [MiB]."""
    numbers: dict[str, Any] = field(default_factory=dict)
    """Numbers of the result."""
    asked: str = ""
    """Hash of the request that it answers."""


class RunFolder:
    """A run folder that is known to belong to one scene."""

    def __init__(self, path: Path, scene_digest: str, scene_name: str) -> None:
        self.path = Path(path)
        self.scene_digest = scene_digest
        self.scene_name = scene_name
        self.warnings: list[str] = []
        """Warnings since the last start."""
        self._stages: dict[str, StageRecord] = {}
        self._kept: dict[str, str] = {}
        """Hash of each file that is of no stage, or was written again after it."""
        self._stale: set[str] = set()
        """Files of stages that were forgotten."""
        self._replaces: str | None = None
        """Digest of another scene, whose run is removed when the folder is locked."""

    @classmethod
    def open(
        cls, path: Path, *, scene_digest: str, scene_name: str, overwrite: bool = False
    ) -> "RunFolder":
        """Open or make the run folder of a scene.

        UserError for the run of another scene, unless it may be overwritten (it goes when the
        folder is locked), and for a folder with files but no run: nothing in it is touched.
        """
        path = Path(path)
        run = cls(path, scene_digest, scene_name)
        is_run = (path / RUN_NAME).is_file()
        only_locked = path.is_dir() and all(
            entry.name == LOCK_NAME or is_passing(entry) for entry in path.iterdir()
        )
        require_folder(path, "run", own=is_run or only_locked)
        if is_run:
            stored = cls.read(path)
            if stored.scene_digest == scene_digest:
                return stored
            same = stored.scene_name == scene_name
            other = "of that name, or of this one before it changed" if same else ""
            what = f"the run of another scene {other or f'({stored.scene_name!r})'}"
            got = f"scene {scene_name!r}"
            require_consent(path, what, overwrite=overwrite, got=got)
            run._replaces = stored.scene_digest
            return run
        path.mkdir(parents=True, exist_ok=True)
        run._save()
        return run

    def _require_same(self, result: str, asked: str, *, overwrite: bool) -> None:
        """Refuse to replace a finished result by one of another request."""
        done = self._stages.get(result)
        if done is not None and done.asked != asked:
            what = f"a finished {result} of other settings"
            require_consent(self.path, what, overwrite=overwrite)
            self.forget([result])  # the consent holds for a restart, too

    @classmethod
    def read(cls, path: Path) -> "RunFolder":
        """Open an existing run folder; UserError for one with links, which lead out of it."""
        file = Path(path) / RUN_NAME
        try:
            values = parse_json(read_regular(file, RECORD_BYTES))
            known = values["format"] == _FORMAT and values["version"] == _VERSION
            run = cls(Path(path), str(values["scene"]["digest"]), str(values["scene"]["name"]))
            if known:
                run._take(values)
        except (FileNotFoundError, NotADirectoryError):
            raise UserError(
                what=f"is no run folder: it has no {RUN_NAME}",
                where=path,
                hint="make one with 'geraf2 reconstruct'",
            ) from None
        except (ValueError, KeyError, TypeError, AttributeError):
            raise UserError(what="cannot be read as the record of a run", where=file) from None
        if not known:
            raise UserError(
                what=f"is a run of format version {values.get('version')}, of another geraf2",
                where=path,
                expected=_VERSION,
                hint="its meshes can be used as they are; run it again into a new folder",
            )
        require_no_links(run.path)
        return run

    def _take(self, values: Mapping[str, Any]) -> None:
        self.warnings = [str(text) for text in values["warnings"]]
        self._stale = {inside(file) for file in values.get("stale", ())}
        self._kept = {inside(k): str(v) for k, v in values.get("kept", {}).items()}
        self._stages = {
            str(name): StageRecord(
                key=str(record["key"]),
                files={inside(k): str(v) for k, v in record["files"].items()},
                seconds=float(record["seconds"]),
                cpu_seconds=float(record["cpu_seconds"]),
                peak_memory_mib=float(record["peak_memory_mib"]),
                numbers=checked_numbers(record["numbers"], f"{self.path / RUN_NAME}: {name}"),
                asked=str(record.get("asked", "")),
            )
            for name, record in values["stages"].items()
        }

    @contextmanager
    def locked(
        self, result: str | None = None, asked: str = "", *, overwrite: bool = False
    ) -> Iterator[None]:
        """Hold the folder against other processes; UserError if one writes into it.

        result: what is to be made; UserError where it is done and was asked for in other words,
        unless it may be overwritten. asked: hash of the request. What killed processes left
        half-written is removed. The lock is a file that names its process and host; one whose
        process is gone is taken over, but a process of another host cannot be looked for.
        """
        path = self.path / LOCK_NAME
        lock = SoftFileLock(path, timeout=0.5)
        try:
            _acquire(lock, path)
        except Timeout:
            holder = _holder_of(path)
            raise UserError(
                what="another run is writing into this folder",
                where=self.path,
                got=holder,
                hint=f"wait for it, or choose another folder; if it is gone, remove {LOCK_NAME}",
            ) from None
        try:
            stored = self.read(self.path)
            if stored.scene_digest == self._replaces:
                self._clear(stored)
            elif stored.scene_digest != self.scene_digest:
                raise UserError(what="another run has just begun in this folder", where=self.path)
            else:
                self._stages, self.warnings = stored._stages, stored.warnings
                self._stale, self._kept = stored._stale, stored._kept
            if result is not None:
                self._require_same(result, asked, overwrite=overwrite)
            sweep_folder(self.path)
            yield
        finally:
            lock.release()

    def _clear(self, stored: "RunFolder") -> None:
        """Replace a run of another scene."""
        self._replaces = None
        self._save()
        files = [file for record in stored._stages.values() for file in record.files]
        for pattern in (*map(glob.escape, files), *_OF_A_SCENE):
            for path in self.path.glob(pattern):
                path.unlink()

    @property
    def stages(self) -> Mapping[str, StageRecord]:
        """Stages that are done."""
        return dict(self._stages)

    def forget(self, names: Iterable[str], *, stale: bool = False) -> None:
        """Mark stages as not done; files stay until replaced, stale ones until `drop_stale`."""
        for name in names:
            record = self._stages.pop(name, None)
            if stale and record is not None:
                self._stale |= set(record.files)
        self._save()

    def release(self, *patterns: str) -> None:
        """Forget files of these patterns before they are replaced or removed.

        Stages that wrote one of them are no longer done.
        """

        def goes(file: str) -> bool:
            return any(fnmatchcase(file, pattern) for pattern in patterns)

        self._kept = {file: d for file, d in self._kept.items() if not goes(file)}
        self.forget([name for name, r in self._stages.items() if any(map(goes, r.files))])

    def drop_stale(self) -> None:
        """Remove files of stages that were forgotten, in this run or one that was stopped."""
        kept = {file for record in self._stages.values() for file in record.files}
        for file in self._stale - kept:
            (self.path / file).unlink(missing_ok=True)
        self._stale = set()
        self._save()

    def forget_derived(self, content: bytes) -> None:
        """Remove what was derived of another mesh than this `content`."""
        mesh = self.path / CONTENT_NAME
        if mesh.is_file() and read_regular(mesh) == content:
            return
        self.release(*_DERIVED)
        for pattern in _DERIVED:
            for path in self.path.glob(pattern):
                path.unlink()
        with suppress(OSError):  # is missing, or holds foreign files
            (self.path / VIEWS_FOLDER).rmdir()

    def is_done(self, name: str, key: str) -> bool:
        """Whether a stage ran with this key and its files are unchanged."""
        record = self._stages.get(name)
        return (
            record is not None
            and record.key == key
            and all(file_digest(self.path / file) == d for file, d in record.files.items())
        )

    def mark_done(
        self, name: str, key: str, files: Sequence[str], seconds: float, **measured: Any
    ) -> None:
        """Record a finished stage and what it wrote; `measured` as in :class:`StageRecord`."""
        digests = {file: file_digest(self.path / file) or "" for file in files}
        if "numbers" in measured:
            measured["numbers"] = _plain(measured["numbers"])
        if name in self._stages:
            self._stale |= set(self._stages[name].files)
        self._stages[name] = StageRecord(key=key, files=digests, seconds=seconds, **measured)
        self._kept = {file: d for file, d in self._kept.items() if file not in digests}
        self._save()

    def keep(self, *patterns: str) -> None:
        """Record hashes of files of no stage, or rewritten after it, for :meth:`digests`."""
        paths = [path for pattern in patterns for path in sorted(self.path.glob(pattern))]
        for path in paths:
            self._kept[path.relative_to(self.path).as_posix()] = file_digest(path) or ""
        self._kept = {file: d for file, d in self._kept.items() if (self.path / file).is_file()}
        self._save()

    @property
    def digests(self) -> dict[str, str]:
        """Hash of each expected file, by its path in the folder."""
        stages = {file: d for record in self._stages.values() for file, d in record.files.items()}
        return {**stages, **self._kept}

    def confirm(self, name: str, asked: str) -> None:
        """Record that a finished stage answers this request, too."""
        if self._stages[name].asked != asked:
            self._stages[name] = replace(self._stages[name], asked=asked)
            self._save()

    def written(self, name: str) -> Path | None:
        """Path of a file that a stage of this run wrote, None if none did or it is gone."""
        path = self.path / name
        recorded = any(name in record.files for record in self._stages.values())
        return path if recorded and path.is_file() else None

    def restart(self) -> None:
        """Drop the warnings of an earlier start."""
        self.warnings = []
        self._save()

    def warn(self, text: str, level: str = "warning") -> None:
        """Record a line for the report, and log it; level: "info", "warning" or "error"."""
        self.warnings.append(text)
        self.log(text, level=level)
        self._save()

    def log(self, event: str, **data: Any) -> None:
        """Append one line to log.jsonl."""
        entry = {"time": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()), "event": event}
        line = json.dumps(entry | {k: _plain(v) for k, v in data.items()}) + "\n"
        with (self.path / LOG_NAME).open("a", encoding="utf-8") as handle:
            handle.write(line)

    def _save(self) -> None:
        write_json_atomic(
            self.path / RUN_NAME,
            {
                "format": _FORMAT,
                "version": _VERSION,
                "scene": {"name": self.scene_name, "digest": self.scene_digest},
                "warnings": self.warnings,
                "stages": {name: asdict(record) for name, record in self._stages.items()},
                "stale": sorted(self._stale),
                "kept": self._kept,
            },
        )


def _acquire(lock: SoftFileLock, path: Path) -> None:
    """Acquire a lock, also one whose process was killed before it could name itself; Timeout."""
    try:
        lock.acquire()
    except Timeout:
        if not _is_empty(path):
            raise
        time.sleep(_NAMED_S)
        if _is_empty(path):
            path.unlink(missing_ok=True)
        lock.acquire()


def _is_empty(path: Path) -> bool:
    with suppress(FileNotFoundError):
        return path.stat().st_size == 0
    return False


def _holder_of(lock: Path) -> str:
    try:
        pid, host, *_ = read_regular(lock, RECORD_BYTES).decode(errors="replace").split("\n")
    except (OSError, ValueError, UserError):
        return "an unnamed process"
    return f"process {pid} on {host}"


def stage_key(**inputs: Any) -> str:
    """Hash of everything a stage depends on: text, numbers, arrays, frozen dataclasses."""
    text = json.dumps({name: _plain(value) for name, value in inputs.items()}, sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def mesh_digest(folder: Path) -> dict[str, str | None]:
    """Which mesh a score is of: the entry `mesh_digest` that metrics.json and psnr.json hold."""
    return {"mesh_digest": file_digest(folder / CONTENT_NAME)}


def _plain(value: Any) -> Any:
    """JSON of a value; arrays by their content."""
    if is_dataclass(value) and not isinstance(value, type):
        return {k: _plain(getattr(value, k)) for k in value.__dataclass_fields__}
    if isinstance(value, np.ndarray):
        digest = hashlib.blake2b(np.ascontiguousarray(value).tobytes(), digest_size=16)
        return [str(value.dtype), list(value.shape), digest.hexdigest()]
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    if value is None or isinstance(value, (str, int, float, bool)):
        return value
    msg = f"cannot make a key of {type(value).__name__}: {value!r}"
    raise TypeError(msg)
