"""Options of a batch, which do not change its results."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from geraf2._bounds import Bounded, Rounds, Seconds, Sides, ThreadCount
from geraf2.apps.batch.jobs import BatchJob, read_jobs
from geraf2.errors import UserError
from geraf2.pipeline.presets import PresetConfig
from geraf2.pipeline.run_record import RunRecord


@dataclass(frozen=True, kw_only=True)
class BatchOptions(Bounded):
    """Workers, retries and time limits of a batch; UserError for numbers out of range."""

    workers: ThreadCount | None = None
    """Processes on this machine; as many as cores and free memory allow when not given."""
    scheduler: str | None = None
    """Address of a running dask scheduler instead, tcp://HOST:PORT, whose workers have the same
    files and the same geraf2."""
    threads: ThreadCount | None = None
    """Threads of each job; the cores' share on this machine, 1 on a scheduler's workers."""
    retries: Rounds = 2
    """Number of repetitions of a job after lost files, lack of memory or a killed process."""
    timeout_s: Seconds | None = None
    """Ends a job that takes longer [s]."""
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


@dataclass(frozen=True, kw_only=True)
class BatchRequest(BatchOptions):
    """Settings of a command line for all scenes."""

    los: Path | None = None
    """Outside of all boxes, as of `geraf2 reconstruct`. When not given, it is a scene's own
    los.ply, or else found by radar."""
    box: Sides | None = None
    """Or the outer side lengths of all boxes [m]."""
    preset: str = "best"
    """As of `geraf2 reconstruct`, and so are its constants."""
    config: Path | None = None
    """config.toml of a run, for all settings but its scene; flags override it."""
    list: bool = False
    """List finished and remaining jobs with the remaining processor time, and stop."""

    def jobs(self, scenes: Sequence[str], settings: PresetConfig) -> Sequence[BatchJob]:
        """Jobs of scenes (:func:`geraf2.apps.batch.read_jobs`); settings: constants of a preset."""
        options = None if self.config is None else RunRecord.read(self.config).options
        return read_jobs(scenes, los=self.los, box=self.box, config=settings, options=options)
