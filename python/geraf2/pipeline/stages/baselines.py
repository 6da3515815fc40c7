"""Stages of the baselines: matched-filter, normal-field, back-projection."""

from collections.abc import Callable
from typing import Any

from geraf2._types import Progress
from geraf2.baselines import (
    BASELINE_VERSION,
    back_projection_cloud,
    cloud_as_mesh,
    normal_field_surface,
)
from geraf2.baselines.level import LEVEL_VERSION
from geraf2.baselines.matched_filter_surface import matched_filter_surface
from geraf2.io.mesh import TriangleMesh
from geraf2.io.run_folder import FIT_NAME
from geraf2.pipeline.stages.direct import loader, mesh_numbers, mesh_stage, saver, write_meshes
from geraf2.pipeline.stages.stage import Job, Stage, Stages
from geraf2.surfaces.extraction import ExtractedMeshes, box_surface

MATCHED_FILTER = Stage(
    name="baseline",
    version=BASELINE_VERSION,
    settings=lambda config: config.matched_filter,
    compute=lambda job, progress: matched_filter_surface(
        job.capture,
        job.prior,
        job.config.matched_filter,
        num_threads=job.num_threads,
        progress=progress,
    ),
    save=saver(FIT_NAME),
    load=loader(FIT_NAME),
)
MATCHED_FILTER_STAGES: Stages = (
    MATCHED_FILTER,
    mesh_stage(
        (MATCHED_FILTER,),
        lambda job: job[MATCHED_FILTER],
        lambda job: float(job.config.matched_filter.crop_m),
    ),
)


def _cloud(job: Job, progress: Progress) -> TriangleMesh:
    config = job.config.back_projection
    cloud = back_projection_cloud(
        job.capture, job.prior, config, num_threads=job.num_threads, progress=progress
    )
    return cloud_as_mesh(cloud, config.spacing_m)


def _normals(job: Job, progress: Progress) -> TriangleMesh:
    return normal_field_surface(
        job.capture,
        job.prior,
        job.config.normal_field,
        num_threads=job.num_threads,
        progress=progress,
    )


def _open_mesh_stage(
    content_of: Callable[[Job, Progress], TriangleMesh],
    version: int,
    settings: Callable[[Any], Any],
) -> Stage[Any]:
    """Stage for meshes of an open surface, for example of a cloud, without a signed distance."""

    def compute(job: Job, progress: Progress) -> ExtractedMeshes:
        content, box = content_of(job, progress), box_surface(job.prior)
        mesh = TriangleMesh.joined([box, content])
        return ExtractedMeshes(mesh=mesh, mesh_box=box, mesh_content=content)

    return Stage(
        name="mesh",
        version=version,
        settings=settings,
        compute=compute,
        save=write_meshes,
        load=lambda job: None,
        numbers=mesh_numbers,
    )


NORMAL_FIELD_STAGES: Stages = (
    _open_mesh_stage(
        _normals, 100 * BASELINE_VERSION + LEVEL_VERSION, lambda config: config.normal_field
    ),
)
BACK_PROJECTION_STAGES: Stages = (
    _open_mesh_stage(_cloud, BASELINE_VERSION, lambda config: config.back_projection),
)
