"""State of a batch: finished and remaining jobs, and the time of the latter."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

from geraf2.apps.batch.folder import DONE, PAGE_NAME, BatchFolder, JobPaths, JobResult
from geraf2.apps.batch.jobs import BatchJob
from geraf2.apps.batch.page import write_pages
from geraf2.apps.batch.work import is_answer


@dataclass
class Plan:
    """Jobs of a batch and their results, by key."""

    folder: BatchFolder
    jobs: dict[str, BatchJob]
    """By key, in the order of the request."""
    known: dict[str, JobResult]
    """Final results, by key."""
    ended: dict[str, JobResult]
    """Final results, and those of failed jobs that would be repeated."""
    _drawn: float = field(default_factory=time.monotonic)
    _draw_s: float = 0.0

    @classmethod
    def of(cls, jobs: Sequence[BatchJob], folder: BatchFolder, *, report: bool = False) -> "Plan":
        """Plan of some jobs with their results in a folder."""
        by_key = {job.key: job for job in jobs}
        known, ended = {}, {}
        for key, job in by_key.items():
            paths = folder.paths(key, job)
            result = paths.read()
            if result is not None:
                ended[key] = result
                if is_answer(result, job, paths, report=report):
                    known[key] = result
        return cls(folder, by_key, known, ended)

    def remaining(self) -> dict[str, BatchJob]:
        """Remaining jobs."""
        return {key: job for key, job in self.jobs.items() if key not in self.known}

    def paths(self, key: str) -> JobPaths:
        """Paths of a job's files."""
        return self.folder.paths(key, self.jobs[key])

    def seconds_remaining(self) -> float:
        """Processor time of the remaining jobs: mean of finished ones, else by size [s]."""
        spent: dict[str, list[float]] = {}
        for result in self.known.values():
            if result.state == DONE:
                spent.setdefault(result.preset, []).append(result.cpu_seconds)
        total = 0.0
        for job in self.remaining().values():
            own = spent.get(job.config.preset)
            estimate = job.estimate
            total += sum(own) / len(own) if own else estimate.seconds if estimate else 0.0
        return total

    @property
    def n_failed(self) -> int:
        """Number of failed jobs."""
        return sum(result.state != DONE for result in self.ended.values())

    def listed(self) -> list[tuple[str, str]]:
        """Lines of `--list`: state of each scene, and totals with the remaining time."""
        lines = []
        for key, job in self.jobs.items():
            _, _, state = (self.ended[key].line if key in self.ended else "").partition(": ")
            lines.append((job.scene.name, state or "to do"))
        n_done = sum(result.state == DONE for result in self.known.values())
        text = f"{len(self.jobs)} scenes, {n_done} done, {self.n_failed} failed"
        if remaining := self.remaining():
            minutes = self.seconds_remaining() / 60.0
            text += f", {len(remaining)} to do in about {minutes:.1f} CPU minutes"
        return [*lines, ("all", text)]

    def outcome(self) -> list[tuple[str, str]]:
        """Lines after a batch."""
        return [*self.listed()[-1:], ("page", str(self.folder.out / PAGE_NAME))]

    def draw(self, share: float = 1.0) -> None:
        """Write page and table, unless that would exceed a share of the time."""
        start = time.monotonic()
        if share < 1.0 and self._draw_s > share * (start - self._drawn):
            return
        write_pages(self.folder, self.known)
        self._drawn = time.monotonic()
        self._draw_s = self._drawn - start
