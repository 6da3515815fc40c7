"""What is done of a batch, what is left, and what that will take."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

from geraf2.apps.batch.folder import DONE, PAGE_NAME, BatchFolder, JobResult, Place
from geraf2.apps.batch.jobs import BatchJob
from geraf2.apps.batch.page import write_pages
from geraf2.apps.batch.work import is_answer


@dataclass
class Plan:
    """Jobs of a batch by key, and what became of them."""

    folder: BatchFolder
    jobs: dict[str, BatchJob]
    """By key, in the order of the request."""
    known: dict[str, JobResult]
    """Results that hold, by key."""
    ended: dict[str, JobResult]
    """These, and those of jobs that failed and would be tried again."""
    _drawn: float = field(default_factory=time.monotonic)
    _draw_s: float = 0.0

    @classmethod
    def of(cls, jobs: Sequence[BatchJob], folder: BatchFolder, *, report: bool = False) -> "Plan":
        """Look up what a folder holds of some jobs."""
        by_key = {job.key: job for job in jobs}
        known, ended = {}, {}
        for key, job in by_key.items():
            place = folder.place(key, job)
            result = place.read()
            if result is not None:
                ended[key] = result
                if is_answer(result, job, place, report=report):
                    known[key] = result
        return cls(folder, by_key, known, ended)

    def left(self) -> dict[str, BatchJob]:
        """Jobs to be done."""
        return {key: job for key, job in self.jobs.items() if key not in self.known}

    def place(self, key: str) -> Place:
        """Where a job's files lie."""
        return self.folder.place(key, self.jobs[key])

    def seconds_left(self) -> float:
        """Processor time of what is left: as long as what the preset did, else by size [s]."""
        spent: dict[str, list[float]] = {}
        for result in self.known.values():
            if result.state == DONE:
                spent.setdefault(result.preset, []).append(result.cpu_seconds)
        total = 0.0
        for job in self.left().values():
            own = spent.get(job.config.preset)
            estimate = job.estimate
            total += sum(own) / len(own) if own else estimate.seconds if estimate else 0.0
        return total

    @property
    def n_failed(self) -> int:
        """Jobs that ended and are not done."""
        return sum(result.state != DONE for result in self.ended.values())

    def listed(self) -> list[tuple[str, str]]:
        """Lines of `--list`: each scene and its state, and what all that is left will take."""
        lines = []
        for key, job in self.jobs.items():
            _, _, state = (self.ended[key].line if key in self.ended else "").partition(": ")
            lines.append((job.scene.name, state or "to do"))
        n_done = sum(result.state == DONE for result in self.known.values())
        text = f"{len(self.jobs)} scenes, {n_done} done, {self.n_failed} failed"
        if left := self.left():
            text += f", {len(left)} to do in about {self.seconds_left() / 60.0:.1f} CPU minutes"
        return [*lines, ("all", text)]

    def outcome(self) -> list[tuple[str, str]]:
        """Lines after a batch."""
        return [*self.listed()[-1:], ("page", str(self.folder.out / PAGE_NAME))]

    def draw(self, share: float = 1.0) -> None:
        """Write the page and the table, unless that would take more than a share of the time."""
        start = time.monotonic()
        if share < 1.0 and self._draw_s > share * (start - self._drawn):
            return
        write_pages(self.folder, self.known)
        self._drawn = time.monotonic()
        self._draw_s = self._drawn - start
