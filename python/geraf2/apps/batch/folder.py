"""Folder of a batch: its jobs, their results, and the run folders.

    OUT/
        batch.json          jobs of this batch
        runs/SCENE-KEY/     run folders, as of `geraf2 reconstruct`
        results/KEY.json    result of a job, written whole and last
        batch.html

results/ alone determines which jobs are done, so that scheduler, client and workers may die.
"""

import os
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from geraf2 import __version__
from geraf2.apps.batch.engine import BAD_INPUT
from geraf2.errors import UserError
from geraf2.io.atomic import write_json_atomic
from geraf2.io.digests import require_inside
from geraf2.io.objects import is_remote, read_bytes
from geraf2.io.outputs import require_folder
from geraf2.io.regular import RECORD_BYTES
from geraf2.io.text import parse_json
from geraf2.io.toml import from_table

MARKER_NAME, RESULTS_FOLDER, RUNS_FOLDER = "batch.json", "results", "runs"
_FORMAT, _VERSION = "geraf2-batch", 1
DONE = "done"


@dataclass(frozen=True, kw_only=True)
class JobResult:
    """Result of a job: results/KEY.json."""

    key: str
    """Of the job."""
    scene: str
    """Name of the scene."""
    preset: str
    state: str
    """done, or that of a Failure: bad input, failed, killed, lost files, out of memory."""
    error: str = ""
    """Reason of a failure, one line."""
    worker: str = ""
    """Address of the worker that did it."""
    seconds: float = 0.0
    """Wall time [s]."""
    cpu_seconds: float = 0.0
    """Processor time [s]."""
    peak_memory_mib: float = 0.0
    """Largest resident set of the worker's process [MiB]."""
    scores: dict[str, float] = field(default_factory=dict)
    """Against the truth, where it is known, as of `MeshMetrics.headline`."""
    numbers: dict[str, float] = field(default_factory=dict)
    """Of the mesh: typical expected error, and how much of it was not seen; of a parcel: where it
    lay on its belt, and how it moved."""
    verdict: str = ""
    """How far the result can be trusted; empty where it was not judged."""
    probability_of_failure: float | None = None
    """Probability that it is wrong, 0 to 1; None where it was not judged."""
    because: str = ""
    """First cause of doubt."""
    do: str = ""
    """What to do about it."""
    warnings: tuple[str, ...] = ()
    log_tail: tuple[str, ...] = ()
    """End of the traceback of a defect."""
    version: str = __version__
    """Of geraf2."""

    @property
    def is_final(self) -> bool:
        """Whether a repetition would give the same: done, or bad input."""
        return self.state in (DONE, BAD_INPUT)

    @property
    def line(self) -> str:
        """Scene, state, error and verdict."""
        parts = (self.scene, self.state, self.error, self.verdict, self.because)
        return ": ".join(filter(None, parts))


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

    def read(self) -> JobResult | None:
        """Read the record; None where it is missing or broken."""
        try:
            values = parse_json(read_bytes(self.result, RECORD_BYTES))
            return from_table(values, JobResult, self.result)
        except (OSError, ValueError, UserError):
            return None

    def write(self, result: JobResult) -> None:
        """Write the record."""
        write_json_atomic(self.result, asdict(result))


class BatchFolder:
    """Folder of one batch, all of whose jobs have the same settings."""

    def __init__(self, out: Path | str, settings: str) -> None:
        self.out, self.settings = Path(out), settings
        if not is_remote(self.out):
            self.out = Path(os.path.abspath(out))  # noqa: PTH100 - links stay unresolved

    def require_own(self) -> None:
        """Raise UserError where the folder holds something else, or a batch of other settings."""
        found = self._read()
        require_folder(self.out, "batch", own=found is not None)
        if found is not None and found["settings"] != self.settings:
            hint = "choose another folder"
            raise UserError(what="holds a batch of other settings", where=self.out, hint=hint)

    def add(self, jobs: dict[str, str]) -> None:
        """Write jobs into the folder, beside those that it has: keys by the scenes' names."""
        found = self._read()
        known: dict[str, str] = {} if found is None else found["jobs"]
        if found is None or known | jobs != known:
            marker = {"format": _FORMAT, "version": _VERSION, "settings": self.settings}
            write_json_atomic(self.out / MARKER_NAME, {**marker, "jobs": known | jobs})

    def all_paths(self) -> list[JobPaths]:
        """Paths of all jobs of this batch."""
        found = self._read() or {"jobs": {}}
        return [JobPaths(self.out, key, name) for name, key in found["jobs"].items()]

    def _read(self) -> dict[str, Any] | None:
        """Contents of batch.json; None where there is no batch."""
        file = self.out / MARKER_NAME
        try:
            values: Any = parse_json(read_bytes(file, RECORD_BYTES))
            if (values["format"], values["version"]) != (_FORMAT, _VERSION):
                raise UserError(what="is a batch of another geraf2", where=self.out)
            jobs = {
                require_inside(name): require_inside(key) for name, key in values["jobs"].items()
            }
            return {"settings": str(values["settings"]), "jobs": jobs}
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            raise UserError(what="cannot be read as the record of a batch", where=file) from None
