"""Many scenes on many processes: `geraf2 batch`, on dask.distributed.

The state is kept in files (`geraf2.apps.batch.folder`): after a crash of scheduler, client or
workers the same call continues. Lengths in metres.

>>> import geraf2.apps.batch
>>> geraf2.save_capture(geraf2.examples.small_capture()[0], "scene")
True
>>> (job,) = geraf2.apps.batch.read_jobs(["scene"], box=(0.16, 0.16, 0.16))
>>> job.scene.name, job.config.preset
('scene', 'best')
"""

from geraf2.apps.batch.folder import BatchFolder, JobResult
from geraf2.apps.batch.jobs import BatchJob, read_jobs
from geraf2.apps.batch.options import BatchOptions
from geraf2.apps.batch.running import run

__all__ = [
    "BatchFolder",
    "BatchJob",
    "BatchOptions",
    "JobResult",
    "read_jobs",
    "run",
]
