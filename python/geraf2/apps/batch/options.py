"""How a batch is run; what comes out does not depend on it."""

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
    """Where the jobs run, and what is done about faults; UserError for numbers out of range."""

    workers: ThreadCount | None = None
    """Processes on this machine; as many as cores and free memory allow when not given."""
    scheduler: str | None = None
    """Address of a running dask scheduler instead, tcp://HOST:PORT, whose workers see the same
    files and have the same geraf2."""
    threads: ThreadCount | None = None
    """Threads of each job; the cores' share on this machine, 1 on a scheduler's workers."""
    retries: Rounds = 2
    """How often a job is tried again after lost files, memory or a killed process."""
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
    """What a command line says of all scenes."""

    los: Path | None = None
    """Outside of all boxes, as of `geraf2 reconstruct`; a scene's own los.ply when not given."""
    box: Sides | None = None
    """Or the outer side lengths of all boxes [m]."""
    preset: str = "best"
    """As of `geraf2 reconstruct`, and so are its constants."""
    config: Path | None = None
    """config.toml of a run, for all that it was asked for but its scene; flags go before it."""
    list: bool = False
    """List what is done, and what is left with the processor time that it will take, and stop."""

    def jobs(self, scenes: Sequence[str], settings: PresetConfig) -> Sequence[BatchJob]:
        """Jobs of scenes (:func:`geraf2.apps.batch.read_jobs`); settings: constants of a preset."""
        options = None if self.config is None else RunRecord.read(self.config).options
        return read_jobs(scenes, los=self.los, box=self.box, config=settings, options=options)
