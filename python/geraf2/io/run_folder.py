"""The folder of a run: which scene it belongs to, which stages are done, and what they wrote.

`run.json` holds the hash of the scene, and per stage the key (a hash of all that the stage
depends on), the hash of each file it wrote, its numbers and what it took. A stage is reused only
if its key is the same and its files are still what they were; so an interrupted run continues
where it stopped, and a changed setting runs again exactly the stages that depend on it. Who writes
into the folder holds `run.lock`. `log.jsonl` is for people; no program reads it.
"""

import hashlib
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from filelock import SoftFileLock, Timeout

from geraf2._types import AnyPath
from geraf2.errors import UserError
from geraf2.io.atomic import write_json_atomic

RUN_NAME = "run.json"
LOCK_NAME = "run.lock"
LOG_NAME = "log.jsonl"
CONFIG_NAME = "config.toml"
PRIOR_NAME = "prior.npz"
"""Outside of the box as the run read it, with its walls."""
CALIBRATION_NAME = "calibration.npz"
"""What was taken off the capture before anything else."""
GLINTS_NAME = "glints.npz"
KEPT_NAME = "kept_glints.npz"
RIM_NAME = "rim_glints.npz"
SILHOUETTES_NAME = "silhouettes.npz"
"""Outlines of the content against the box's far walls: of `--preset hybrid`."""
FIT_NAME = "sdf_fit.npz"
"""Field as fitted: its gradient is below 1 and it holds every fragment."""
MOVED_NAME = "sdf_moved.npz"
"""Distance to the surface that the fit to heat maps has moved."""
SDF_NAME = "sdf.npz"
"""Distance to the content's mesh."""
CHECKPOINT_NAME = "checkpoint.safetensors"
FIELDS_NAME = "fields.safetensors"
ECHO_NAME = "echo.safetensors"
LIVE_FOLDER = "live"
TENSORBOARD_FOLDER = "tensorboard"
CONTENT_NAME = "mesh_content.ply"
"""What was reconstructed, without the box around it: every preset writes it."""
BOX_NAME = "mesh_box.ply"
MESH_NAME = "mesh.ply"
"""Both together."""
METRICS_NAME = "metrics.json"
PROVENANCE_NAME = "provenance.json"
REPORT_NAME = "report.html"
FIGURES_FOLDER = "figures"
ERRORS_NAME = "errors.png"
VIEWS_FOLDER = "views"
PSNR_NAME = "psnr.json"
TRUTH_PICTURES = ("mesh.png", ERRORS_NAME, "slices.png", "shadows.png")
"""Figures of the mesh that show the truth, too, where `geraf2 evaluate` drew them."""
_DERIVED = (
    METRICS_NAME,
    REPORT_NAME,
    *(f"{FIGURES_FOLDER}/{name}" for name in TRUTH_PICTURES),
    f"{VIEWS_FOLDER}/{PSNR_NAME}",
    f"{VIEWS_FOLDER}/angle_*",
)
"""Patterns of all that says something of one mesh_content.ply, and of no other."""
_FORMAT = "geraf2-run"
_VERSION = 2


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
    """What came out, in numbers."""


class RunFolder:
    """A run folder that is known to belong to one scene."""

    def __init__(self, path: Path, scene_digest: str, scene_name: str) -> None:
        self.path = Path(path)
        self.scene_digest = scene_digest
        self.scene_name = scene_name
        self.warnings: list[str] = []
        """What should be read since the last start."""
        self._stages: dict[str, StageRecord] = {}

    @classmethod
    def open(cls, path: Path, *, scene_digest: str, scene_name: str) -> "RunFolder":
        """Open or make the run folder of a scene.

        Raises UserError for a folder that holds the run of another scene, or that holds files
        but no run: nothing in it is touched.
        """
        path = Path(path)
        run = cls(path, scene_digest, scene_name)
        if path.exists() and not path.is_dir():
            raise UserError(what="is a file", where=path, expected="a folder for the results")
        if (path / RUN_NAME).is_file():
            stored = cls.read(path)
            if stored.scene_digest != scene_digest:
                raise UserError(
                    what=f"holds the run of another scene ({stored.scene_name!r})",
                    where=path,
                    got=f"scene {scene_name!r}",
                    hint="choose another output folder",
                )
            return stored
        if path.is_dir() and any(entry.name != LOCK_NAME for entry in path.iterdir()):
            raise UserError(
                what="holds files but no run of geraf2",
                where=path,
                hint="choose another output folder",
            )
        path.mkdir(parents=True, exist_ok=True)
        run._save()
        return run

    @classmethod
    def read(cls, path: Path) -> "RunFolder":
        """Open an existing run folder."""
        file = Path(path) / RUN_NAME
        try:
            values = json.loads(file.read_text(encoding="utf-8"))
            known = values["format"] == _FORMAT and values["version"] == _VERSION
            run = cls(Path(path), str(values["scene"]["digest"]), str(values["scene"]["name"]))
            if known:
                run._take(values)
        except FileNotFoundError:
            raise UserError(
                what=f"is no run folder: it has no {RUN_NAME}",
                where=path,
                hint="make one with 'geraf2 reconstruct'",
            ) from None
        except (ValueError, KeyError, TypeError, AttributeError):
            raise UserError(what="cannot be read as the record of a run", where=file) from None
        if not known:
            raise UserError(
                what=f"is a run of format version {values['version']}, of another geraf2",
                where=path,
                expected=_VERSION,
                hint="its meshes can be used as they are; reconstruct into a new folder to go on",
            )
        return run

    def _take(self, values: Mapping[str, Any]) -> None:
        self.warnings = [str(text) for text in values["warnings"]]
        self._stages = {
            str(name): StageRecord(
                key=str(record["key"]),
                files={str(k): str(v) for k, v in record["files"].items()},
                seconds=float(record["seconds"]),
                cpu_seconds=float(record["cpu_seconds"]),
                peak_memory_mib=float(record["peak_memory_mib"]),
                numbers=dict(record["numbers"]),
            )
            for name, record in values["stages"].items()
        }

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the folder against other processes; UserError if one writes into it.

        The lock is a file that only one process can make, on network folders too; it names its
        process and host. One whose process is gone, after kill -9 for example, is taken over, but
        a process of another host cannot be looked for.
        """
        path = self.path / LOCK_NAME
        lock = SoftFileLock(path, timeout=0.5)
        try:
            lock.acquire()
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
            if stored.scene_digest != self.scene_digest:
                raise UserError(what="another run has just begun in this folder", where=self.path)
            self._stages, self.warnings = stored._stages, stored.warnings
            yield
        finally:
            lock.release()

    @property
    def stages(self) -> Mapping[str, StageRecord]:
        """Stages that are done."""
        return dict(self._stages)

    def forget(self, names: Sequence[str]) -> None:
        """Take stages for not done; their files stay until they are replaced."""
        for name in names:
            self._stages.pop(name, None)
        self._save()

    def forget_derived(self, content: bytes) -> None:
        """Remove scores, report, pictures and views of the mesh that `content` is to replace.

        Call it before the new mesh_content.ply is written; nothing goes where the bytes stay.
        """
        mesh = self.path / CONTENT_NAME
        if mesh.is_file() and mesh.read_bytes() == content:
            return
        self.forget(["report"])
        for pattern in _DERIVED:
            for path in self.path.glob(pattern):
                path.unlink()
        with suppress(OSError):  # is not there, or holds files of somebody else
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
        self._stages[name] = StageRecord(key=key, files=digests, seconds=seconds, **measured)
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
        """Keep a line that the report shows, and log it; level: "info", "warning" or "error"."""
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
            },
        )


def _holder_of(lock: Path) -> str:
    try:
        pid, host, *_ = lock.read_text(encoding="utf-8", errors="replace").split("\n")
    except (OSError, ValueError):
        return "a process that does not say which"
    return f"process {pid} on {host}"


def stage_key(**inputs: Any) -> str:
    """Hash of everything a stage depends on: text, numbers, arrays, frozen dataclasses."""
    text = json.dumps({name: _plain(value) for name, value in inputs.items()}, sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def mesh_digest(folder: Path) -> dict[str, str | None]:
    """Which mesh a score is of: the entry `mesh_digest` that metrics.json and psnr.json hold."""
    return {"mesh_digest": file_digest(folder / CONTENT_NAME)}


def file_digest(path: AnyPath) -> str | None:
    """Hash of a file's bytes; None if there is no such file."""
    try:
        with Path(path).open("rb") as handle:
            return hashlib.file_digest(handle, lambda: hashlib.blake2b(digest_size=16)).hexdigest()
    except (FileNotFoundError, IsADirectoryError):
        return None


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
