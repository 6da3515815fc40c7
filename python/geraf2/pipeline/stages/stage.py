"""Stages as data: what each reads, computes and keeps, and how a run goes through them."""

import resource
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeAlias, TypeVar, cast

from geraf2._types import Progress
from geraf2.imaging import SubapertureConfig
from geraf2.imaging.peaks import DETECTION_DB, KeptPeaks
from geraf2.io.run_folder import RunFolder, stage_key
from geraf2.pipeline.events import Listener
from geraf2.scene import Capture, LosPrior

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True, eq=False)
class Stage(Generic[T]):
    """One step of a reconstruction, whose result is kept in the run folder."""

    name: str
    """Of the stage in run.json, in the log and on the terminal."""
    version: int
    """Of the algorithm; raised when the same inputs give another result."""
    compute: Callable[["Job", Progress], T]
    """Makes the result; reads results of `inputs` by `job[stage]`."""
    save: Callable[["Job", T], Sequence[str]]
    """Writes it into the run folder; names of the files."""
    load: Callable[["Job"], T]
    """Reads it back."""
    inputs: tuple["Stage[Any]", ...] = ()
    """Stages whose results are read."""
    settings: Callable[[Any], Any] = lambda _: None
    """What of the preset's config the result depends on."""
    seeded: bool = False
    """Whether it depends on the seed."""
    numbers: Callable[[T], Mapping[str, Any]] = lambda _: {}
    """Numbers of the result, for run.json."""


Stages: TypeAlias = tuple[Stage[Any], ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class Job:
    """What every stage of one run is given."""

    run: RunFolder
    capture: Capture
    prior: LosPrior
    config: Any
    """Of the preset."""
    inputs: Mapping[str, Any]
    """What the first stages depend on besides their config: scene, prior, planes left out."""
    listener: Listener
    peaks: KeptPeaks
    """Of the capture's planes, imaged when a stage first asks."""
    seed: int = 0
    num_threads: int | None = None
    resume: bool = False
    asked: str = ""
    """Hash of the request that the run is to answer."""
    made_from: Mapping[str, str] = field(default_factory=dict)
    """Inputs and command, for the meshes."""
    _done: dict[str, tuple[str, Any]] = field(default_factory=dict)

    def __getitem__(self, stage: Stage[T]) -> T:
        return cast("T", self._done[stage.name][1])

    def key(self, stage: Stage[Any]) -> str:
        """Hash of all that a stage's result depends on."""
        return stage_key(
            version=stage.version,
            config=stage.settings(self.config),
            seed=self.seed if stage.seeded else None,
            **({} if stage.inputs else dict(self.inputs)),
            **{f"stage {entry.name}": self._done[entry.name][0] for entry in stage.inputs},
        )

    def do(self, stage: Stage[Any]) -> None:
        """Read the result of a stage if it is done, else compute, save and record it."""
        key, run = self.key(stage), self.run
        if run.is_done(stage.name, key):
            run.log("reused", level="info", stage=stage.name)
            run.confirm(stage.name, self.asked)
            with self.listener.step(f"{stage.name} (done before)"):
                self._done[stage.name] = key, stage.load(self)
            return
        run.forget([stage.name], stale=True)  # its files are replaced one by one
        run.log("started", level="info", stage=stage.name)
        start, cpu_start = time.perf_counter(), time.process_time()
        with self.listener.step(stage.name) as progress:
            result = stage.compute(self, progress)
            files = stage.save(self, result)
        measured = {
            "cpu_seconds": round(time.process_time() - cpu_start, 3),
            "peak_memory_mib": round(peak_memory_bytes() / 2**20),
            "numbers": dict(stage.numbers(result)),
        }
        seconds = round(time.perf_counter() - start, 3)
        run.mark_done(stage.name, key, files, seconds, asked=self.asked, **measured)
        run.log("done", level="info", stage=stage.name, seconds=seconds, **measured)
        self._done[stage.name] = key, result


def kept_peaks(prior: LosPrior, config: Any, num_threads: int | None) -> KeptPeaks:
    """Peaks of a run, collected as a preset's glints ask for; as by default where it has none."""
    return KeptPeaks(prior, *peak_settings(config), num_threads=num_threads)


def peak_settings(config: Any) -> tuple[SubapertureConfig | None, float]:
    """Sub-apertures and detection threshold [dB] of a preset; the usual ones without glints."""
    glints = getattr(config, "glints", None)
    if glints is None:
        return None, DETECTION_DB
    return glints.subaperture, glints.noise_margin_db


def peak_memory_bytes() -> int:
    """Largest resident set of this process so far [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024  # Linux counts KiB
