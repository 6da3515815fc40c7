"""Options of work on several processes, which do not change its results."""

from dataclasses import dataclass
from typing import Annotated

from geraf2._bounds import Arg, Bounded, Rounds, ThreadCount
from geraf2.errors import UserError


@dataclass(frozen=True, kw_only=True)
class BatchOptions(Bounded):
    """Workers and retries; UserError for numbers out of range."""

    workers: ThreadCount | None = None
    """Processes on this machine; as many as cores and free memory allow when not given."""
    scheduler: str | None = None
    """Address of a running dask scheduler instead, tcp://HOST:PORT, whose workers have the same
    files and the same geraf2."""
    threads: Annotated[ThreadCount | None, Arg(hidden=True)] = None
    """Threads of each job; the cores' share on this machine, 1 on a scheduler's workers."""
    retries: Annotated[Rounds, Arg(hidden=True)] = 2
    """Number of repetitions of a job after lost files, lack of memory or a killed process."""
    report: bool = False
    """Also write the report of each run, with its pictures."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.workers is not None and self.scheduler is not None:
            raise UserError(
                what="give either --workers or --scheduler",
                got="both",
                hint="a scheduler has workers of its own",
            )
