"""Baselines as presets: matched-filter, normal-field, back-projection."""

from geraf2.baselines import back_projection_cloud, cloud_as_mesh, normal_field_surface
from geraf2.baselines.matched_filter_surface import matched_filter_surface
from geraf2.io.mesh import TriangleMesh
from geraf2.io.run_folder import FIT_NAME
from geraf2.pipeline.stages.direct import draw_surface, write_meshes
from geraf2.pipeline.stages.job import Job, Step
from geraf2.surfaces.extraction import ExtractedMeshes, box_surface


def reconstruct_matched_filter(job: Job) -> None:
    """Threshold the summed heat maps, and draw a Poisson surface."""
    config = job.config.matched_filter
    with job.step("baseline") as step:
        sdf = matched_filter_surface(
            job.capture, job.prior, config, num_threads=job.num_threads, progress=step.progress
        )
        sdf.save(job.run.path / FIT_NAME)
    draw_surface(job, sdf, float(config.crop_m))


def reconstruct_back_projection(job: Job) -> None:
    """Draw the cloud of the strongest returns."""
    config = job.config.back_projection
    with job.step("mesh") as step:
        cloud = back_projection_cloud(
            job.capture, job.prior, config, num_threads=job.num_threads, progress=step.progress
        )
        _write_open(job, step, cloud_as_mesh(cloud, config.spacing_m))


def reconstruct_normal_field(job: Job) -> None:
    """Integrate the normals of voxels."""
    config = job.config.normal_field
    with job.step("mesh") as step:
        content = normal_field_surface(
            job.capture, job.prior, config, num_threads=job.num_threads, progress=step.progress
        )
        _write_open(job, step, content)


def _write_open(job: Job, step: Step, content: TriangleMesh) -> None:
    """Write an open surface, for example of a cloud, which has no signed distance."""
    box = box_surface(job.prior)
    mesh = TriangleMesh.joined([box, content])
    write_meshes(job, step, ExtractedMeshes(mesh=mesh, mesh_box=box, mesh_content=content))
