"""The folder of a result: which scene it is of, what was asked for, and what was written.

`run.json` names the scene by its hash, the request by another, and has the hash of every file, so
that numbers of another run are never shown. A result is written into a folder beside and takes the
place of the former one in one step: a failure, a full disk or a kill leaves what was there. What
is added later (scores, views, inspections) is recorded by :meth:`RunFolder.rewrite`.
"""

import hashlib
import json
import os
import shutil
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, is_dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from geraf2.errors import UserError
from geraf2.io.atomic import sweep_folder, take_place, temporary_sibling, write_json_atomic
from geraf2.io.digests import bytes_digest, file_digest, require_inside
from geraf2.io.locks import BusyFolderError, lock_folder
from geraf2.io.outputs import require_consent, require_folder
from geraf2.io.regular import RECORD_BYTES, read_regular, require_no_links
from geraf2.io.stage_numbers import check_numbers
from geraf2.io.text import parse_json
from geraf2.io.verdict import VERDICT_STAGE, Verdict, stated_numbers

RUN_NAME = "run.json"
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
SILHOUETTES_NAME = "silhouettes.npz"
"""Outlines of the content on the far walls of the box, of `--preset best`."""
FIT_NAME = "sdf_fit.npz"
"""Field as fitted: its gradient is below 1 and it holds every fragment."""
SDF_NAME = "sdf.npz"
"""Distance to the content's mesh."""
SAMPLES_NAME = "samples.npz"
"""Surfaces that the scan allows, where they were asked for."""
TRAINING_FOLDER = "training"
"""What a training leaves while it is not finished: checkpoint and log."""
CHECKPOINT_NAME = f"{TRAINING_FOLDER}/checkpoint.safetensors"
FIELDS_NAME = "fields.safetensors"
ECHO_NAME = "echo.safetensors"
"""Scatterers beside the surface, fitted to the residual of its echo."""
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
_OF_MESH = (
    METRICS_NAME,
    f"{INSPECTION_NAME}.*",
    f"{COMPARISON_NAME}.*",
    *REPORT_FILES,
    ECHO_NAME,
    f"{VIEWS_FOLDER}/{PSNR_NAME}",
    f"{VIEWS_FOLDER}/angle_*",
)
"""Patterns of files that describe one mesh_content.ply."""
OF_IMAGE = (
    IMAGE_NAME,
    "image.json",
    f"{FIGURES_FOLDER}/projections.png",
    f"{FIGURES_FOLDER}/depth.png",
)
"""Patterns of files of `geraf2 image`."""
_FORMAT = "geraf2-run"
_VERSION = 4


@dataclass(frozen=True, kw_only=True)
class StageRecord:
    """A step of a run that is done."""

    seconds: float
    """Duration [s]."""
    cpu_seconds: float = 0.0
    """Processor time of all threads [s]."""
    peak_memory_mib: float = 0.0
    """Largest resident set of the process up to its end [MiB]."""
    numbers: dict[str, Any] = field(default_factory=dict)
    """Numbers of the result."""


_RECORDED = ("asked", "warnings", "stages", "files")


class RunFolder:
    """Record of a folder that holds results of one scene, or is about to."""

    def __init__(self, path: Path, scene_digest: str, scene_name: str) -> None:
        self.path = Path(path)
        self.scene_digest = scene_digest
        self.scene_name = scene_name
        self.asked: dict[str, str] = {}
        """Hash of the request of each finished result: "mesh", "box", "image"."""
        self.warnings: list[str] = []
        """Warnings of the run."""
        self.stages: dict[str, StageRecord] = {}
        """Steps that are done, by name."""
        self.files: dict[str, str] = {}
        """Hash of each file that was written, by its path in the folder."""
        self.place = self.path
        """Path of the folder once it is whole."""
        self.log_path = self.path / LOG_NAME
        self._former: RunFolder | None = None
        """Folder whose place this one takes."""
        self._taken_over: dict[str, tuple[int, str | None]] = {}
        """Inode and hash of files of the former folder; no hash for those of the user."""
        self._is_inside = False
        """Whether this folder is within that whose place it takes."""
        self._is_held = False
        self._known: str | None = None
        """Hash of the record that this one was read from or wrote; None without one."""

    @property
    def verdict(self) -> Verdict | None:
        """How far the result can be trusted; None where it was not judged."""
        record = self.stages.get(VERDICT_STAGE)
        return Verdict.from_numbers(record.numbers) if record else None

    @property
    def numbers(self) -> dict[str, dict[str, Any]]:
        """Numbers of each step, without those that the verdict withdraws."""
        return {name: stated_numbers(r.numbers, self.verdict) for name, r in self.stages.items()}

    @classmethod
    def open(
        cls, path: Path, *, scene_digest: str, scene_name: str, overwrite: bool = False
    ) -> "RunFolder":
        """Record of a folder for results of a scene; nothing is made or changed.

        UserError for results of another scene, unless they may be overwritten, and for a folder
        with files that geraf2 did not make.
        """
        path = Path(path)
        is_run = (path / RUN_NAME).is_file()
        require_folder(path, "run", own=is_run or (path / TRAINING_FOLDER).is_dir())
        run = cls(path, scene_digest, scene_name)
        if not is_run:
            return run
        stored = cls.read(path)
        if stored.scene_digest == scene_digest:
            return stored
        same = stored.scene_name == scene_name
        other = "of that name, or of this one before it changed" if same else ""
        what = f"the run of another scene {other or f'({stored.scene_name!r})'}"
        require_consent(path, what, overwrite=overwrite, got=f"scene {scene_name!r}")
        run._known = stored._known
        return run

    def require_same(self, name: str, asked: str, what: str, *, overwrite: bool) -> None:
        """Refuse to replace a finished result of another request; `what` names it in the error."""
        if self.asked.get(name, asked) != asked:
            require_consent(self.path, f"a finished {what} of other settings", overwrite=overwrite)

    @classmethod
    def read(cls, path: Path) -> "RunFolder":
        """Open an existing run folder; UserError for one with links, which lead out of it."""
        file = Path(path) / RUN_NAME
        try:
            data = read_regular(file, RECORD_BYTES)
            values = parse_json(data)
            known = values["format"] == _FORMAT and values["version"] == _VERSION
            run = cls(Path(path), str(values["scene"]["digest"]), str(values["scene"]["name"]))
            run._known = bytes_digest(data)
            if known:
                run._take(values)
        except (FileNotFoundError, NotADirectoryError):
            is_training = (Path(path) / TRAINING_FOLDER).is_dir()
            hint = "finish it with 'geraf2 reconstruct --resume'"
            raise UserError(
                what="holds a training that is not finished"
                if is_training
                else f"is no run folder: it has no {RUN_NAME}",
                where=path,
                hint=hint if is_training else "make one with 'geraf2 reconstruct'",
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
        self.asked = {str(k): str(v) for k, v in values["asked"].items()}
        self.files = {require_inside(k): str(v) for k, v in values["files"].items()}
        self.stages = {
            str(name): StageRecord(
                seconds=float(record["seconds"]),
                cpu_seconds=float(record["cpu_seconds"]),
                peak_memory_mib=float(record["peak_memory_mib"]),
                numbers=check_numbers(record["numbers"], f"{self.path / RUN_NAME}: {name}"),
            )
            for name, record in values["stages"].items()
        }

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Hold the folder against other commands; UserError if one writes into it."""
        if self._is_held or not self.path.is_dir():
            yield
            return
        with lock_folder(self.path):
            self._is_held = True
            try:
                sweep_folder(self.path)
                if (self.path / RUN_NAME).is_file():
                    now = self.read(self.path)
                    if now.scene_digest == self.scene_digest:  # another command may have recorded
                        self.__dict__ |= {name: getattr(now, name) for name in _RECORDED}
                yield
            finally:
                self._is_held = False

    @contextmanager
    def replace_whole(self, *, grows: bool = False) -> Iterator["RunFolder"]:
        """Record of a new folder that takes the place of this one when the body ends.

        Where the body fails, this folder is as it was. It is filled file by file, its record last,
        where it cannot be replaced (it is mounted, or somebody's working directory), and if it
        `grows`: then its log goes on, too.
        """
        with self.lock():  # refused now, not after the work
            before, place = file_digest(self.path / RUN_NAME), self.path.resolve()
            if not grows and before != self._known:  # written since it was opened and compared
                raise self._overtaken()
        in_place = grows or _is_fixed(place)
        with temporary_sibling(place / "run" if in_place else place) as folder:
            new = RunFolder(folder, self.scene_digest, self.scene_name)
            new.place, new._former, new._is_inside = self.path, self, in_place
            if grows and (self.path / LOG_NAME).is_file():
                shutil.copy2(self.path / LOG_NAME, new.log_path)
            try:
                yield new
                new.record_files()
            except UserError as error:
                text = str(error)
                if str(folder) not in text:
                    raise
                raise type(error)(text.replace(str(folder), str(self.path))) from error
            with self.lock():
                if file_digest(self.path / RUN_NAME) != before:
                    raise self._overtaken()
                known = file_digest(new.path / RUN_NAME)
                if in_place:
                    new._move_into(place)
                else:
                    take_place(folder, place)
        self.__dict__ |= {name: getattr(new, name) for name in _RECORDED}
        self._known = known

    def _overtaken(self) -> BusyFolderError:
        return BusyFolderError("another result was written here meanwhile", where=self.path)

    def begin(self) -> None:
        """Make the folder, unless it holds results of the scene; results of another one go."""
        if not (self.path / RUN_NAME).is_file() or self.read(self.path).scene_digest != (
            self.scene_digest
        ):
            with self.replace_whole() as new:
                new.take_over()

    def take_over(self) -> None:
        """Keep of the former folder what this one does not replace.

        Kept are the user's own files and, of the same scene, an image, and scores and views if the
        mesh has the same bytes.
        """
        former = self._former
        if former is None or not former.path.is_dir():
            return
        sweep_folder(former.path)
        mesh = file_digest(former.path / CONTENT_NAME)
        is_same_mesh = mesh is not None and mesh == file_digest(self.path / CONTENT_NAME)
        stored = self.read(former.path) if (former.path / RUN_NAME).is_file() else former
        is_same_scene = stored.scene_digest == self.scene_digest

        def stays(file: str) -> bool:
            if file in {RUN_NAME, LOG_NAME}:
                return False
            if _matches(file, f"{TRAINING_FOLDER}/*"):
                return not (self.path / FIELDS_NAME).exists()
            if "image" in stored.stages and _matches(file, *OF_IMAGE):
                return is_same_scene
            if _matches(file, *_OF_MESH):
                return is_same_scene and is_same_mesh
            return file not in stored.files

        for path in require_no_links(former.path):
            file = path.relative_to(former.path).as_posix()
            is_own = file not in stored.files
            if (self._is_inside and is_own) or (self.path / file).exists() or not stays(file):
                continue
            link_file(path, self.path / file)
            inode = (self.path / file).stat().st_ino
            self._taken_over[file] = inode, stored.files.get(file)
        kept = {"image", *(["echo", "report"] if is_same_mesh else [])} if is_same_scene else set()
        for name in [name for name in stored.stages if name in kept - self.stages.keys()]:
            self.stages[name] = stored.stages[name]
        if is_same_scene and "image" in stored.asked:
            self.asked["image"] = stored.asked["image"]

    def _move_into(self, place: Path) -> None:
        """Move the files into an existing folder, whose record goes first and comes last."""
        assert self._former is not None
        (place / RUN_NAME).unlink(missing_ok=True)
        files = [p.relative_to(self.path).as_posix() for p in require_no_links(self.path)]
        gone = [f for f in self._former.files if f not in files]
        for path in (*map(place.joinpath, gone), *_find_files(place, _OF_MESH)):
            if path.relative_to(place).as_posix() not in files:
                path.unlink(missing_ok=True)
        for file in sorted(files, key=lambda file: file == RUN_NAME):
            (place / file).parent.mkdir(parents=True, exist_ok=True)
            (self.path / file).replace(place / file)
        if FIELDS_NAME in files:
            shutil.rmtree(place / TRAINING_FOLDER, ignore_errors=True)

    def record_files(self) -> None:
        """Hash all files of a new folder, and write its record."""
        self.files = {}
        for path in sorted(require_no_links(self.path)):
            file = path.relative_to(self.path).as_posix()
            inode, digest = self._taken_over.get(file, (None, None))
            if file in {RUN_NAME, LOG_NAME} or (inode == path.stat().st_ino and digest is None):
                continue
            kept = digest if inode == path.stat().st_ino else None
            self.files[file] = kept or file_digest(path) or ""
        self.save()

    @contextmanager
    def rewrite(self, *patterns: str) -> Iterator[None]:
        """Lock the folder, and record files of these patterns anew, which the body writes.

        While they are written none has a hash.
        """
        with self.lock():
            self.files = {f: d for f, d in self.files.items() if not _matches(f, *patterns)}
            self.save()
            yield
            for path in _find_files(self.path, patterns):
                file = path.relative_to(self.path).as_posix()
                self.files[file] = file_digest(path) or ""
            self.save()

    def find_file(self, name: str) -> Path | None:
        """Path of a file that is of the run; None if it has no such file, or it is gone."""
        path = self.path / name
        return path if name in self.files and path.is_file() else None

    def warn(self, text: str, level: str = "warning") -> None:
        """Record a line for the report, and log it; level: "info", "warning" or "error"."""
        self.warnings.append(text)
        self.log(text, level=level)

    def log(self, event: str, **data: Any) -> None:
        """Append one line to log.jsonl."""
        entry = {"time": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()), "event": event}
        line = json.dumps(entry | {k: _plain(v) for k, v in data.items()}) + "\n"
        with self.log_path.open("a", encoding="utf-8") as handle:
            handle.write(line)

    def save(self) -> None:
        """Write the record."""
        stages = {name: _plain(asdict(record)) for name, record in self.stages.items()}
        write_json_atomic(
            self.path / RUN_NAME,
            {
                "format": _FORMAT,
                "version": _VERSION,
                "scene": {"name": self.scene_name, "digest": self.scene_digest},
                "asked": self.asked,
                "warnings": self.warnings,
                "stages": stages,
                "files": self.files,
            },
        )
        self._known = file_digest(self.path / RUN_NAME)


def place_of(folder: Path) -> str:
    """Name of a folder with that of the folder that holds it, for titles: `monday/run`."""
    return "/".join(folder.resolve().parts[-2:]).lstrip("/")


def link_file(source: Path, target: Path) -> None:
    """Give a file a second name, or copy it where the file system has no such names."""
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def _is_fixed(place: Path) -> bool:
    """Whether a folder must stay where it is: it is mounted, or a working directory."""
    if not place.is_dir():
        return False
    if place.is_mount() or not os.access(place.parent, os.W_OK):
        return True
    with suppress(FileNotFoundError):
        return place in (Path.cwd(), *Path.cwd().parents)
    return False


def _matches(file: str, *patterns: str) -> bool:
    return any(fnmatchcase(file, pattern) for pattern in patterns)


def _find_files(folder: Path, patterns: Iterable[str]) -> list[Path]:
    return [
        p
        for p in sorted(require_no_links(folder))
        if _matches(p.relative_to(folder).as_posix(), *patterns)
    ]


def stage_key(**inputs: Any) -> str:
    """Hash of everything a stage depends on: text, numbers, arrays, frozen dataclasses."""
    text = json.dumps({name: _plain(value) for name, value in inputs.items()}, sort_keys=True)
    return bytes_digest(text.encode())


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
