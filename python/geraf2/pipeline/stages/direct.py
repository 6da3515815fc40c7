"""Steps of the presets fast and best, and the meshes of every preset."""

from dataclasses import replace
from typing import Any

import numpy as np

from geraf2._types import Floats, Ints
from geraf2.echoes import Glints
from geraf2.echoes.detectability import Detector
from geraf2.echoes.faces import LEAST_PROBABILITY, Scan, likeliest_index
from geraf2.echoes.glints import find_echoes
from geraf2.echoes.labels import Clutter
from geraf2.echoes.ruled_out import region_numbers, rule_out
from geraf2.echoes.transparency import describe, place_on_faces
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.freespace.silhouettes import find_silhouettes
from geraf2.io.atomic import write_bytes_atomic
from geraf2.io.mesh import TriangleMesh, write_mesh
from geraf2.io.run_folder import (
    BACK_NAME,
    BOX_NAME,
    CONTENT_NAME,
    FIT_NAME,
    GHOSTS_NAME,
    GLINTS_NAME,
    MESH_NAME,
    PEAKS_NAME,
    SDF_NAME,
    SILHOUETTES_NAME,
    RunFolder,
)
from geraf2.ops.visibility import MeshScene
from geraf2.pipeline.stages.calibration import common_sigma_m
from geraf2.pipeline.stages.job import Job, Step
from geraf2.scene.aperture import Aperture
from geraf2.surfaces.expected_error import quality_numbers
from geraf2.surfaces.extraction import ExtractedMeshes, extract_cropped_meshes, extract_meshes
from geraf2.surfaces.fit import Evidence, FitConfig, fit_sdf, zero_level
from geraf2.surfaces.isosurface import redistance
from geraf2.surfaces.pieces import piece_numbers, pieces_of
from geraf2.surfaces.refinement import evidence_of

# Fit through first surfaces, which only has to block lines of sight.
_FIRST_SURFACE = FitConfig(spacing_m=0.006)


def reconstruct_fast(job: Job) -> None:
    """Fit a surface to the glints."""
    glints, config = find_glints(job), job.config.fit
    sdf = _fit(job, glints, config)
    evidence = Evidence(glints=glints, common_sigma_m=common_sigma_m(job.run))
    draw_surface(job, sdf, evidence)


def reconstruct_best(job: Job) -> None:
    """Fit a surface to the glints and the outlines on the far walls."""
    config, outlines = job.config.refine, None
    glints = find_glints(job)
    with job.step("outlines") as step:
        if config.shadows:
            outlines = find_silhouettes(job.capture, config.silhouettes)
            outlines.save(job.run.path / SILHOUETTES_NAME)
            step.numbers |= outlines.numbers()
    evidence = evidence_of(glints, outlines, config, common_sigma_m(job.run))
    draw_surface(job, _fit(job, evidence, config.fit), evidence)


def find_glints(job: Job) -> Glints:
    """Find the glints of first surfaces, and write them with all labelled peaks."""
    capture, threads, folder = job.capture, job.num_threads, job.run.path

    def surface_through(first: Glints) -> tuple[Floats, Ints]:
        return zero_level(fit_sdf(first, _FIRST_SURFACE, num_threads=threads))

    with job.step("glints") as step:
        found = find_echoes(
            capture,
            job.prior,
            job.config.glints,
            peaks=job.peaks.of(capture, progress=step.progress),
            num_threads=threads,
        )
        glints, labelled, body = found.glints, found.labelled, None
        every, index = found.likelier_than(LEAST_PROBABILITY)
        scan = Scan(
            glints=every,
            surface_through=surface_through,
            cell_m=capture.waveform.range_cell_m,
            volume_m3=float(np.prod(job.prior.size_m)),
            num_threads=threads,
        )
        medium = likeliest_index(glints, scan)
        placed = None if medium is None else place_on_faces(scan, medium)
        if placed is not None:
            faces, body = placed
            glints, (front, back) = faces.glints, faces.of_glints(len(every))
            every.select(back).save(folder / BACK_NAME)  # seen through a dielectric
            labelled = labelled.on_faces(index, front, back)
        glints.save(folder / GLINTS_NAME)
        write_bytes_atomic(folder / PEAKS_NAME, labelled.cloud_bytes())
        step.numbers |= {"n_glints": len(glints), "labels": labelled.counts()}
        if found.metal is not None:
            step.numbers |= found.metal.numbers() | found.clutter.numbers()
        step.numbers |= {} if body is None else body.numbers()
        if body is not None:
            job.listener.note(describe(body.numbers()))
    return glints


def _fit(job: Job, evidence: Glints | Evidence, config: FitConfig) -> SdfGrid:
    with job.step("sdf") as step:
        sdf = fit_sdf(
            evidence,
            content_fit(job.run, config),
            apertures=[Aperture.from_pose(pose) for pose in job.capture.poses],
            num_threads=job.num_threads,
            progress=step.progress,
        )
        sdf.save(job.run.path / FIT_NAME)
    return sdf


def content_fit(run: RunFolder, config: FitConfig) -> FitConfig:
    """Return the settings with which the content of a run is fitted.

    Plastic is not completed: the networks have only seen faces from outside, with free space before
    them. A run whose glints came from elsewhere says nothing of plastic.
    """
    glints = run.stages.get("glints")
    is_plastic = glints is not None and "n_back_faces" in glints.numbers
    return replace(config, completion="smooth") if is_plastic else config


def draw_surface(job: Job, sdf: SdfGrid, evidence: Evidence | float) -> None:
    """Draw the meshes of a field, and write them with the field's distance to them.

    evidence: data of the field's fit; for a field without glints, the margin by which its box is
        cropped [m].
    """
    threads = job.num_threads
    with job.step("mesh") as step:
        if isinstance(evidence, Evidence):
            meshes = extract_meshes(sdf, evidence, job.prior, num_threads=threads)
        else:
            meshes = extract_cropped_meshes(sdf, job.prior, evidence, num_threads=threads)
        if meshes.mesh_content.faces.shape[0]:  # drop the same pieces from the field
            sdf = redistance(sdf, meshes.mesh_content, num_threads=threads)
        write_meshes(job, step, meshes)
        if not job.is_growing:
            step.numbers |= _ruled_out(job, meshes.mesh_content)
        sdf.save(job.run.path / SDF_NAME)


def _ruled_out(job: Job, content: TriangleMesh) -> dict[str, Any]:
    """Smallest bodies that would have been found; empty where no wall shows the level of metal."""
    found, config = job.run.stages.get("glints"), getattr(job.config, "glints", None)
    if found is None or config is None or "metal_strength_m" not in found.numbers:
        return {}
    strength_m, support, strong = (
        found.numbers[name]
        for name in ("metal_strength_m", "support_over_clutter", "strong_magnitude")
    )
    clutter, peaks = Clutter(support=support, strong=strong), job.peaks.of(job.capture)
    detector = Detector.of(job.capture, job.prior, peaks, config, strength_m, clutter)
    scene = MeshScene(content.vertices, content.faces, num_threads=job.num_threads)
    return region_numbers(rule_out(detector, job.prior, scene))


def write_meshes(job: Job, step: Step, meshes: ExtractedMeshes) -> None:
    """Write box, content and both, each as PLY and GLB, and likely ghosts.

    Raises UserError if there is no content.
    """
    folder, frame = job.run.path, job.capture.frame
    if not len(meshes.mesh_content.faces):
        found = job.run.stages.get("glints")
        glints = found.numbers.get("n_glints") if found is not None else None
        size = " x ".join(f"{1e3 * side:.0f}" for side in job.prior.size_m)
        raise UserError(
            what="no surface was found inside the box",
            where=job.run.place,
            got=(f"{glints} glints and " if glints else "") + f"a box of {size} mm without content",
            hint="is the box empty, do the voxels fit it, is the scene sound ('geraf2 info')?",
        )
    for name, mesh in zip((MESH_NAME, BOX_NAME, CONTENT_NAME), meshes[:3], strict=True):
        for file in (name, name.removesuffix(".ply") + ".glb"):
            write_mesh(mesh, folder / file, frame=frame, made_from=job.made_from)
    if meshes.ghosts is not None and len(meshes.ghosts.faces):
        write_mesh(meshes.ghosts, folder / GHOSTS_NAME, frame=frame, made_from=job.made_from)
    step.numbers |= mesh_numbers(meshes)


def mesh_numbers(meshes: ExtractedMeshes) -> dict[str, Any]:
    """Size, evidence and expected error of the content's mesh, and its likely ghosts."""
    content = meshes.mesh_content
    numbers: dict[str, Any] = {"n_vertices": len(content.vertices), "n_faces": len(content.faces)}
    sizes = meshes.samples.size_numbers() if meshes.samples is not None else {}
    if meshes.ghosts is not None:
        numbers["likely_ghosts"] = [piece.numbers() for piece in pieces_of(meshes.ghosts)]
    return numbers | piece_numbers(content) | quality_numbers(content) | sizes
