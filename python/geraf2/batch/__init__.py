"""Many scenes on many processes: `geraf2 batch`, on dask.distributed.

What is done lies in files (`geraf2.batch.folder`); scheduler, client and workers may die, and the
same call goes on. Lengths in metres.

>>> import geraf2.batch
>>> geraf2.save_capture(geraf2.examples.small_capture()[0], "scene")
True
>>> (job,) = geraf2.batch.read_jobs(["scene"], box=(0.16, 0.16, 0.16))
>>> job.scene.name, job.config.preset
('scene', 'best')
"""

from geraf2.batch.folder import BatchFolder, JobResult
from geraf2.batch.jobs import BatchJob, read_jobs
from geraf2.batch.options import BatchOptions, BatchRequest
from geraf2.batch.running import run

__all__ = [
    "BatchFolder",
    "BatchJob",
    "BatchOptions",
    "BatchRequest",
    "JobResult",
    "read_jobs",
    "run",
]
