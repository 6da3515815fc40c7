"""Stages as data: inputs, computation and stored result of each, and their execution in a run."""

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
    """One step of a reconstruction, whose result is stored in the run folder."""

    name: str
    """Name in run.json, in the log and on the terminal."""
    version: int
    """Version of the algorithm, increased when the same inputs give another result."""
    compute: Callable[["Job", Progress], T]
    """Computes the result; `job[stage]` gives the results of `inputs`."""
    save: Callable[["Job", T], Sequence[str]]
    """Writes the result to the run folder and returns the names of the files."""
    load: Callable[["Job"], T]
    """Reads the result back."""
    inputs: tuple["Stage[Any]", ...] = ()
    """Stages whose results are used."""
    settings: Callable[[Any], Any] = lambda _: None
    """Part of the preset's config that the result depends on."""
    seeded: bool = False
    """Whether the result depends on the seed."""
    numbers: Callable[[T], Mapping[str, Any]] = lambda _: {}
    """Numbers of the result, for run.json."""


Stages: TypeAlias = tuple[Stage[Any], ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class Job:
    """Inputs and state of all stages of one run."""

    run: RunFolder
    capture: Capture
    prior: LosPrior
    config: Any
    """Config of the preset."""
    inputs: Mapping[str, Any]
    """Inputs of the first stages besides their config: scene, prior, planes left out."""
    listener: Listener
    peaks: KeptPeaks
    """Peaks of the capture's planes, imaged on first use."""
    seed: int = 0
    num_threads: int | None = None
    resume: bool = False
    asked: str = ""
    """Hash of the run's request."""
    made_from: Mapping[str, str] = field(default_factory=dict)
    """Inputs and command, written to the meshes."""
    _done: dict[str, tuple[str, Any]] = field(default_factory=dict)

    def __getitem__(self, stage: Stage[T]) -> T:
        return cast("T", self._done[stage.name][1])

    def key(self, stage: Stage[Any]) -> str:
        """Hash of all inputs of a stage's result."""
        return stage_key(
            version=stage.version,
            config=stage.settings(self.config),
            seed=self.seed if stage.seeded else None,
            **({} if stage.inputs else dict(self.inputs)),
            **{f"stage {entry.name}": self._done[entry.name][0] for entry in stage.inputs},
        )

    def do(self, stage: Stage[Any]) -> None:
        """Load the result of a stage if it is done, else compute, save and record it."""
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
    """Peaks of a run, collected with the settings of its preset's glints, or with the defaults."""
    return KeptPeaks(prior, *peak_settings(config), num_threads=num_threads)


def peak_settings(config: Any) -> tuple[SubapertureConfig | None, float]:
    """Sub-apertures and detection threshold [dB] of a preset; the defaults without glints."""
    glints = getattr(config, "glints", None)
    if glints is None:
        return None, DETECTION_DB
    return glints.subaperture, glints.noise_margin_db


def peak_memory_bytes() -> int:
    """Largest resident set of this process so far [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024  # Linux counts KiB
