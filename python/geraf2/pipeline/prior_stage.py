"""First stage of a run whose prior is made first, for example from photos.

Packages register makers of priors under the entry-point group `geraf2.priors`, among them geraf2's
own for photos. The pipeline itself depends on none of them.
"""

import time
from importlib.metadata import entry_points
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from geraf2.fields.mesh_distance import grid_about
from geraf2.imaging.volume import image_volume
from geraf2.io.regular import require_no_links
from geraf2.io.run_folder import TRAINING_FOLDER, RunFolder, StageRecord, link_file
from geraf2.pipeline.events import Listener
from geraf2.pipeline.los_options import LosOptions
from geraf2.scene import Capture, Grid, LosPrior
from geraf2.scene.summary import CaptureSummary

ENTRY_POINT_GROUP = "geraf2.priors"
PRIOR_STAGE = "los"
"""Name of the stage and of its folder."""
_N_HEAT_VOXELS = 56
_N_HEAT_POSES = 8


class PriorJob(Protocol):
    """A source that was read and checked, ready to make a prior."""

    @property
    def key(self) -> str:
        """Hash of everything that the prior depends on."""

    def make(self, folder: Path, listener: Listener) -> tuple[str, ...]:
        """Make the prior in a folder, unless it already holds one with this key.

        Returns the names of its files, for :func:`geraf2.pipeline.prior.load_prior`.
        """


class PriorMaker(Protocol):
    """Maker of priors from one kind of source."""

    def read(
        self, source: Path, options: LosOptions, summary: CaptureSummary, listener: Listener
    ) -> PriorJob | None:
        """Read and check a source; None if it is of another kind, UserError if unusable."""


def find_prior_job(
    source: Path | None, options: LosOptions, summary: CaptureSummary, listener: Listener
) -> PriorJob | None:
    """Job that makes a prior from a source; None for a mesh, a finished prior, or no source."""
    if source is None or source.is_file():
        return None
    for point in entry_points(group=ENTRY_POINT_GROUP):
        maker: PriorMaker = point.load()()
        job = maker.read(source, options, summary, listener)
        if job is not None:
            return job
    return None


def make_prior(run: RunFolder, job: PriorJob, listener: Listener) -> Path:
    """Folder of the prior in a new run folder.

    It is made in that of unfinished trainings, where a failure leaves it for the next run. A prior
    of the same key that is there, or in the former run, is kept.
    """
    start, folder = time.perf_counter(), run.path / PRIOR_STAGE
    training = run.place / TRAINING_FOLDER / PRIOR_STAGE
    former = run.place / PRIOR_STAGE
    if former.is_dir() and not training.exists():
        for path in require_no_links(former):
            link_file(path, training / path.relative_to(former))
    for name in job.make(training, listener):
        link_file(training / name, folder / name)
    seconds = round(time.perf_counter() - start, 3)
    run.stages[PRIOR_STAGE] = StageRecord(seconds=seconds)
    run.log("done", level="info", stage=PRIOR_STAGE, seconds=seconds)
    return folder


def heat_map(
    capture: Capture, prior: LosPrior, num_threads: int | None
) -> tuple[NDArray[np.float32], Grid]:
    """Coarse heat map of some poses around a prior, for the report."""
    grid = grid_about(prior.bounds, _N_HEAT_VOXELS)
    n_poses = len(capture.poses)
    chosen = sorted({int(i) for i in np.linspace(0, n_poses - 1, min(n_poses, _N_HEAT_POSES))})
    return image_volume(capture, grid, poses=chosen, num_threads=num_threads), grid
