"""How a batch is run; what comes out does not depend on it."""

from dataclasses import dataclass

from geraf2.errors import UserError


@dataclass(frozen=True, kw_only=True)
class BatchOptions:
    """Where the jobs run, and what is done about faults; UserError for numbers out of range."""

    workers: int | None = None
    """Processes on this machine; as many as cores and free memory allow when not given."""
    scheduler: str | None = None
    """Address of a running dask scheduler instead, tcp://HOST:PORT, whose workers see the same
    files and have the same geraf2."""
    threads: int | None = None
    """Threads of each job; the cores' share on this machine, 1 on a scheduler's workers."""
    retries: int = 2
    """How often a job is tried again after lost files, memory or a killed process."""
    timeout_s: float | None = None
    """Ends a job that takes longer [s]."""
    report: bool = False
    """Also write the report of each run, with its pictures."""

    def __post_init__(self) -> None:
        for name in ("workers", "threads", "timeout_s"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise UserError(what=f"--{name.replace('_', '-')} must be positive", got=value)
        if self.retries < 0:
            raise UserError(what="--retries must not be negative", got=self.retries)
        if self.workers is not None and self.scheduler is not None:
            raise UserError(
                what="give either --workers or --scheduler",
                got="both",
                hint="a scheduler has workers of its own",
            )
