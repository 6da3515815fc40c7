"""Inputs of a reconstruction, and its steps, each with progress and time."""

import resource
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

from geraf2._types import Progress
from geraf2.imaging.peaks import DETECTION_DB, KeptPeaks
from geraf2.io.run_folder import RunFolder, StageRecord
from geraf2.pipeline.events import Listener
from geraf2.scene import Capture, LosPrior
from geraf2.scene.aperture import Aperture


@dataclass(kw_only=True, eq=False)
class Step:
    """A step that is being done."""

    progress: Progress
    """Called with the fraction that is done."""
    numbers: dict[str, Any] = field(default_factory=dict)
    """Numbers of its result, for run.json."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Job:
    """Inputs of one reconstruction."""

    run: RunFolder
    """Folder that the results are written into."""
    capture: Capture
    prior: LosPrior
    config: Any
    """Config of the preset."""
    inputs: Mapping[str, Any]
    """Hashes of scene, prior and calibration, and the planes left out, for a training's key."""
    listener: Listener
    peaks: KeptPeaks
    """Peaks of the capture's planes, imaged on first use."""
    seed: int = 0
    num_threads: int | None = None
    resume: bool = False
    """Whether a training continues from its checkpoint."""
    has_walls: bool = True
    """Whether the prior may be a box: not so for the region of content in free air."""
    is_growing: bool = False
    """Whether further planes follow: what the scan rules out is stated at its end."""
    made_from: Mapping[str, str] = field(default_factory=dict)
    """Inputs and command, written to the meshes."""

    @contextmanager
    def step(self, name: str) -> Iterator[Step]:
        """Context of one step, which is logged and recorded with its time, memory and numbers."""
        run = self.run
        run.log("started", level="info", stage=name)
        start, cpu_start = time.perf_counter(), time.process_time()
        with self.listener.step(name) as progress:
            step = Step(progress=progress)
            yield step
        record = StageRecord(
            seconds=round(time.perf_counter() - start, 3),
            cpu_seconds=round(time.process_time() - cpu_start, 3),
            peak_memory_mib=round(peak_memory_bytes() / 2**20),
            numbers=step.numbers,
        )
        run.stages[name] = record
        run.log("done", level="info", stage=name, **vars(record))


def for_planes(config: Any, capture: Capture) -> Any:
    """Return the settings of a preset with the sub-apertures of a capture's planes."""
    if not hasattr(config, "glints"):
        return config
    planes = [Aperture.from_pose(pose) for pose in capture.poses]
    return replace(config, glints=config.glints.for_planes(planes))


def kept_peaks(prior: LosPrior, config: Any, num_threads: int | None) -> KeptPeaks:
    """Peaks of a run, collected with the settings of its preset's glints, or with the defaults."""
    glints = getattr(config, "glints", None)
    if glints is None:
        return KeptPeaks(prior, None, DETECTION_DB, num_threads=num_threads)
    return KeptPeaks(prior, glints.subaperture, glints.noise_margin_db, num_threads=num_threads)


def peak_memory_bytes() -> int:
    """Largest resident set of this process so far [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024  # Linux counts KiB
