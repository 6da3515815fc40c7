"""Folder of a batch: its jobs, their results, and the run folders.

    OUT/
        batch.json          jobs of this batch
        runs/SCENE-KEY/     run folders, as of `geraf2 reconstruct`
        results/KEY.json    result of a job, written whole and last
        results/KEY.png     small picture of the mesh
        results/KEY.begun   a line for each start by a worker; removed at the end
        batch.html, batch.csv

results/ alone determines which jobs are done, so that scheduler, client and workers may die.
"""

import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from geraf2 import __version__
from geraf2.apps.batch.jobs import BatchJob, fingerprint
from geraf2.errors import UserError
from geraf2.io.atomic import write_json_atomic, write_text_atomic
from geraf2.io.digests import inside
from geraf2.io.objects import is_remote, read_bytes, remove
from geraf2.io.outputs import require_folder
from geraf2.io.regular import RECORD_BYTES
from geraf2.io.run_folder import stage_key
from geraf2.io.text import parse_json
from geraf2.io.toml import from_table

MARKER_NAME, RESULTS_FOLDER, RUNS_FOLDER = "batch.json", "results", "runs"
PAGE_NAME, TABLE_NAME = "batch.html", "batch.csv"
_FORMAT, _VERSION = "geraf2-batch", 1

DONE, BAD_INPUT = "done", "bad input"
FAILED, TIMEOUT, KILLED, LOST, MEMORY, BUSY = (
    *("failed", "timeout", "killed", "lost files"),
    *("out of memory", "busy"),
)
TRIED_AGAIN = (KILLED, LOST, MEMORY)
"""States after which a job is repeated."""


@dataclass(frozen=True, kw_only=True)
class JobResult:
    """Result of a job: results/KEY.json."""

    key: str
    """Of the job."""
    scene: str
    """Name of the scene."""
    preset: str
    state: str
    """done, bad input, failed, timeout, killed, lost files, or out of memory."""
    asked: str = ""
    """Hash of the truth of its scores, see `asked_of`."""
    error: str = ""
    """Reason of a failure, one line."""
    attempts: int = 1
    worker: str = ""
    """Address of the worker that did it."""
    seconds: float = 0.0
    """Wall time of the last attempt [s]."""
    cpu_seconds: float = 0.0
    """Processor time of the last attempt [s]."""
    peak_memory_mib: float = 0.0
    """Largest resident set of the job's process [MiB]."""
    scores: dict[str, float] = field(default_factory=dict)
    """Against the truth, where it is known, as of `MeshMetrics.headline`."""
    numbers: dict[str, float] = field(default_factory=dict)
    """Of the mesh: typical expected error, and how much of it was not seen."""
    warnings: tuple[str, ...] = ()
    log_tail: tuple[str, ...] = ()
    """Last lines printed by a failed job."""
    version: str = __version__
    """Of geraf2."""

    @property
    def is_final(self) -> bool:
        """Whether a repetition would give the same: done, or bad input."""
        return self.state in (DONE, BAD_INPUT)

    @property
    def line(self) -> str:
        """Scene, state and error."""
        return ": ".join(filter(None, (self.scene, self.state, self.error)))


@dataclass(frozen=True)
class JobPaths:
    """Paths of a job's files."""

    out: Path
    key: str
    scene: str

    @property
    def run(self) -> Path:
        """Run folder."""
        return self.out / RUNS_FOLDER / f"{self.scene}-{self.key[:10]}"

    @property
    def result(self) -> Path:
        """Record of its result."""
        return self.out / RESULTS_FOLDER / f"{self.key}.json"

    @property
    def picture(self) -> Path:
        """Small picture of the mesh."""
        return self.result.with_suffix(".png")

    @property
    def begun(self) -> Path:
        """File with a line for each start by a worker."""
        return self.out / RESULTS_FOLDER / f"{self.key}.begun"

    def read(self) -> JobResult | None:
        """Read the record; None where it is missing or broken."""
        try:
            values = parse_json(read_bytes(self.result, RECORD_BYTES))
            return from_table(values, JobResult, self.result)
        except (OSError, ValueError, UserError):
            return None

    def write(self, result: JobResult) -> None:
        """Write the record, and remove the list of starts."""
        write_json_atomic(self.result, asdict(result))
        self.forget_begins()

    def begin(self, worker: str) -> None:
        """Record the start of the job by a worker."""
        if is_remote(self.begun):  # object stores cannot append
            write_text_atomic(self.begun, "".join(f"{one}\n" for one in [*self.begins(), worker]))
            return
        self.begun.parent.mkdir(parents=True, exist_ok=True)
        with self.begun.open("a", encoding="utf-8") as handle:
            handle.write(worker + "\n")

    def forget_begins(self) -> None:
        """Remove the list of starts."""
        with suppress(OSError):
            remove(self.begun)

    def begins(self) -> list[str]:
        """Workers that started the job and wrote no result."""
        try:
            return read_bytes(self.begun, RECORD_BYTES).decode().splitlines()
        except OSError:
            return []


class BatchFolder:
    """Folder of one batch."""

    def __init__(self, out: Path | str) -> None:
        self.out = Path(out)
        if not is_remote(self.out):
            self.out = Path(os.path.abspath(out))  # noqa: PTH100 - links stay unresolved

    def paths(self, key: str, job: BatchJob) -> JobPaths:
        """Paths of a job's files; key: the job's."""
        return JobPaths(self.out, key, job.scene.name)

    def merged(self, jobs: Mapping[str, BatchJob], *, is_part: bool = False) -> dict[str, str]:
        """Entries of `jobs` and of the folder; UserError where it holds another batch.

        Jobs may be a subset or a superset of those of the folder. As a part of a growing batch they
        may be others of the same settings. They are identified by the names and settings of the
        scenes. Nothing is written.
        """
        known = self.jobs()
        try:
            require_folder(self.out, "batch", own=known is not None)
        except UserError:
            known = self.jobs()  # another client may have created it
            if known is None:
                raise
            require_folder(self.out, "batch", own=True)
        names = {_name(job): key for key, job in jobs.items()}
        old, new = (
            {_settings_of(n) if is_part else n for n in part} for part in (known or {}, names)
        )
        if known and not (old <= new or new <= old):
            other = next(name for name in known if name not in names)
            raise UserError(
                what="holds another batch",
                where=self.out,
                got=f"scene {other.split('/')[0]!r}, or settings, not among the present jobs",
                hint="choose another folder",
            )
        return (known or {}) | names

    def keep(self, entries: Mapping[str, str]) -> None:
        """Write the entries into the folder."""
        if entries != self.jobs():
            marker = {"format": _FORMAT, "version": _VERSION, "jobs": dict(entries)}
            write_json_atomic(self.out / MARKER_NAME, marker)

    def jobs(self) -> dict[str, str] | None:
        """Keys of the batch's jobs, by scene and settings; None where there is no batch."""
        file = self.out / MARKER_NAME
        try:
            values: Any = parse_json(read_bytes(file, RECORD_BYTES))
            if (values["format"], values["version"]) != (_FORMAT, _VERSION):
                raise UserError(what="is a batch of another geraf2", where=self.out)
            return {inside(name): inside(key) for name, key in values["jobs"].items()}
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            raise UserError(what="cannot be read as the record of a batch", where=file) from None

    def all_paths(self) -> Iterable[JobPaths]:
        """Yield the paths of all jobs of this batch."""
        for name, key in (self.jobs() or {}).items():
            yield JobPaths(self.out, key, name.rpartition("/")[0])


def asked_of(job: BatchJob) -> str:
    """Hash of the inputs of a job's record beside its key."""
    return stage_key(truth=None if job.truth is None else fingerprint(job.truth))


def _settings_of(name: str) -> str:
    return name.rpartition("/")[2]


def _name(job: BatchJob) -> str:
    return f"{job.scene.name}/{job.settings}"
