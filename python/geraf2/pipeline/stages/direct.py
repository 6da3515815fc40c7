"""Stages of the presets fast and best, and the mesh stage of every preset."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from geraf2._types import Floats, Ints, Progress
from geraf2.echoes import Glints
from geraf2.echoes.glints import GLINTS_VERSION, find_echoes
from geraf2.echoes.labels import Label, LabelledPeaks
from geraf2.echoes.reflectivity import MetalLevel
from geraf2.echoes.transparency import SeenThrough, describe, first_surfaces
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.freespace.silhouettes import Silhouettes
from geraf2.io.atomic import write_bytes_atomic
from geraf2.io.mesh import ply_bytes, write_mesh
from geraf2.io.run_folder import (
    BACK_NAME,
    BOX_NAME,
    CONTENT_NAME,
    FIT_NAME,
    GHOSTS_NAME,
    GLINTS_NAME,
    MESH_NAME,
    PEAKS_NAME,
    RIM_NAME,
    SDF_NAME,
    SILHOUETTES_NAME,
)
from geraf2.pipeline.stages.calibration import common_sigma_m
from geraf2.pipeline.stages.stage import Job, Stage, Stages
from geraf2.surfaces.expected_error import quality_numbers
from geraf2.surfaces.extraction import (
    MESH_VERSION,
    ExtractedMeshes,
    extract_cropped_meshes,
    extract_meshes,
)
from geraf2.surfaces.fit import FIT_VERSION, Evidence, FitConfig, fit_sdf, zero_level
from geraf2.surfaces.isosurface import redistance
from geraf2.surfaces.pieces import piece_numbers, pieces_of
from geraf2.surfaces.refinement import SELECTION_VERSION, SelectedGlints, evidence_of, select_glints

# Fit through first surfaces, which only has to block lines of sight.
_FIRST_SURFACE = FitConfig(spacing_m=0.006, distance_rounds=1)


class FoundGlints(NamedTuple):
    """Glints of a capture for the fits."""

    glints: Glints
    """Glints of first surfaces."""
    seen_through: SeenThrough | None = None
    """Body whose back faces were dropped; None for metal, and for a stage that was read back."""
    labelled: LabelledPeaks | None = None
    """All peaks at the ranges of the box; None for a stage that was read back."""
    back: Glints | None = None
    """Glints seen through the body; None for metal, and for a stage that was read back."""
    metal: MetalLevel | None = None
    """Strength of metal by the walls' flashes; None for a stage that was read back, too."""

    def numbers(self) -> dict[str, Any]:
        """Entry of run.json."""
        found: dict[str, Any] = {"n_glints": len(self.glints)}
        if self.labelled is not None:
            found["labels"] = self.labelled.counts()
        if self.metal is not None:
            found |= self.metal.numbers()
        return found if self.seen_through is None else found | self.seen_through.numbers()


def _find(job: Job, progress: Progress) -> FoundGlints:
    capture, prior, threads = job.capture, job.prior, job.num_threads
    glints, labelled, index, metal = find_echoes(
        capture,
        prior,
        job.config.glints,
        peaks=job.peaks.of(capture, progress=progress),
        num_threads=threads,
        note=job.listener.note,
    )

    def surface_through(first: Glints) -> tuple[Floats, Ints]:
        return zero_level(fit_sdf(first, _FIRST_SURFACE, num_threads=threads))

    first, body = first_surfaces(glints, surface_through, num_threads=threads)
    labelled = labelled.relabelled(index[~first], Label.SEEN_THROUGH)
    back = None if first.all() else glints.select(~first)
    found = FoundGlints(glints.select(first), body, labelled, back, metal)
    if found.seen_through is not None:
        job.listener.note(describe(found.seen_through.numbers()))
    return found


def _save_glints(job: Job, found: FoundGlints) -> list[str]:
    folder, names = job.run.path, [GLINTS_NAME]
    found.glints.save(folder / GLINTS_NAME)
    (folder / BACK_NAME).unlink(missing_ok=True)
    if found.back is not None:
        found.back.save(folder / BACK_NAME)
        names.append(BACK_NAME)
    if found.labelled is not None:
        write_bytes_atomic(folder / PEAKS_NAME, found.labelled.cloud_bytes())
        names.append(PEAKS_NAME)
    return names


GLINTS = Stage(
    name="glints",
    version=GLINTS_VERSION,
    settings=lambda config: config.glints,
    compute=_find,
    save=_save_glints,
    load=lambda job: FoundGlints(Glints.load(job.run.path / GLINTS_NAME)),
    numbers=FoundGlints.numbers,
)


def saver(name: str) -> Callable[[Job, SdfGrid], list[str]]:
    """Return a function that writes a stage's field to a file with this name."""

    def save(job: Job, sdf: SdfGrid) -> list[str]:
        sdf.save(job.run.path / name)
        return [name]

    return save


def loader(name: str) -> Callable[[Job], SdfGrid]:
    """Return a function that reads a stage's field."""
    return lambda job: SdfGrid.load(job.run.path / name)


def _fitted_stage(
    inputs: tuple[Stage[Any], ...],
    settings: Callable[[Any], Any],
    fit: Callable[[Job, Progress], SdfGrid],
) -> Stage[SdfGrid]:
    """Stage of a surface fit."""
    return Stage(
        name="sdf",
        version=FIT_VERSION,
        inputs=inputs,
        settings=settings,
        compute=fit,
        save=saver(FIT_NAME),
        load=loader(FIT_NAME),
    )


SDF = _fitted_stage(
    (GLINTS,),
    lambda config: config.fit,
    lambda job, progress: fit_sdf(
        job[GLINTS].glints, job.config.fit, num_threads=job.num_threads, progress=progress
    ),
)


def _save_selection(job: Job, found: SelectedGlints) -> list[str]:
    folder = job.run.path
    found.rim.save(folder / RIM_NAME)
    if found.silhouettes is None:
        (folder / SILHOUETTES_NAME).unlink(missing_ok=True)
        return [RIM_NAME]
    found.silhouettes.save(folder / SILHOUETTES_NAME)
    return [RIM_NAME, SILHOUETTES_NAME]


def _load_selection(job: Job) -> SelectedGlints:
    folder = job.run.path
    shadows = Silhouettes.load(folder / SILHOUETTES_NAME) if job.config.refine.shadows else None
    return SelectedGlints(job[GLINTS].glints, Glints.load(folder / RIM_NAME), shadows)


def _selection_settings(config: Any) -> list[Any]:
    refine = config.refine
    return [refine.rim, refine.silhouettes if refine.shadows else None]


SELECTION = Stage(
    name="selection",
    version=SELECTION_VERSION,
    inputs=(GLINTS,),
    settings=_selection_settings,
    compute=lambda job, progress: select_glints(
        job.capture,
        job.prior,
        job[GLINTS].glints,
        job.config.refine,
        job.config.glints,
        kept=job.peaks,
        num_threads=job.num_threads,
        progress=progress,
    ),
    save=_save_selection,
    load=_load_selection,
    numbers=SelectedGlints.numbers,
)

REFINED_SDF = _fitted_stage(
    (SELECTION,),
    lambda config: config.refine,
    lambda job, progress: fit_sdf(
        _selected_evidence(job),
        job.config.refine.fit,
        num_threads=job.num_threads,
        progress=progress,
    ),
)


def mesh_stage(
    inputs: tuple[Stage[Any], ...],
    field: Callable[[Job], SdfGrid],
    evidence: Callable[[Job], Evidence | float],
    settings: Callable[[Any], Any] = lambda _: None,
    fit: Callable[[Any], FitConfig | None] = lambda _: None,
) -> Stage[Any]:
    """Stage of the meshes of a field.

    evidence: data of the field's fit; for a field without glints, the margin by which its box is
        cropped [m].
    fit: settings of the fit, from the preset's config.
    """

    def compute(job: Job, progress: Progress) -> tuple[ExtractedMeshes, SdfGrid]:
        sdf, seen, threads = field(job), evidence(job), job.num_threads
        if isinstance(seen, Evidence):
            meshes = extract_meshes(sdf, seen, job.prior, fit(job.config), num_threads=threads)
        else:
            meshes = extract_cropped_meshes(sdf, job.prior, seen, num_threads=threads)
        if meshes.mesh_content.faces.shape[0]:  # drop the same pieces from the field
            sdf = redistance(sdf, meshes.mesh_content, num_threads=threads)
        return meshes, sdf

    def save(job: Job, found: tuple[ExtractedMeshes, SdfGrid]) -> Sequence[str]:
        meshes, sdf = found
        names = write_meshes(job, meshes)
        return [*saver(SDF_NAME)(job, sdf), *names]

    return Stage(
        name="mesh",
        version=MESH_VERSION,
        inputs=inputs,
        settings=settings,
        compute=compute,
        save=save,
        load=lambda job: None,
        numbers=lambda found: mesh_numbers(found[0]),
    )


def mesh_numbers(meshes: ExtractedMeshes) -> dict[str, Any]:
    """Size, evidence and expected error of the content's mesh, and its likely ghosts."""
    content = meshes.mesh_content
    numbers: dict[str, Any] = {"n_vertices": len(content.vertices), "n_faces": len(content.faces)}
    sizes = meshes.samples.size_numbers() if meshes.samples is not None else {}
    if meshes.ghosts is not None:
        numbers["likely_ghosts"] = [piece.numbers() for piece in pieces_of(meshes.ghosts)]
    return numbers | piece_numbers(content) | quality_numbers(content) | sizes


def write_meshes(job: Job, meshes: ExtractedMeshes) -> list[str]:
    """Write box, content and both; files derived from another content are removed first.

    Raises UserError, and writes nothing, if there is no content.
    """
    run, frame = job.run, job.capture.frame
    if not len(meshes.mesh_content.faces):
        glints = run.stages["glints"].numbers.get("n_glints") if "glints" in run.stages else None
        size = " x ".join(f"{1e3 * side:.0f}" for side in job.prior.size_m)
        raise UserError(
            what="no surface was found inside the box",
            where=run.path,
            got=(f"{glints} glints and " if glints else "") + f"a box of {size} mm without content",
            hint="is the box empty, do the voxels fit it, is the scene sound ('geraf2 info')?",
        )
    run.forget_derived(ply_bytes(meshes.mesh_content, frame, job.made_from))
    names = []
    for name, mesh in zip((MESH_NAME, BOX_NAME, CONTENT_NAME), meshes[:3], strict=True):
        for file in (name, name.removesuffix(".ply") + ".glb"):
            write_mesh(mesh, run.path / file, frame=frame, made_from=job.made_from)
            names += [file, file + ".json"]
    if meshes.ghosts is not None and len(meshes.ghosts.faces):
        write_mesh(meshes.ghosts, run.path / GHOSTS_NAME, frame=frame, made_from=job.made_from)
        names += [GHOSTS_NAME, GHOSTS_NAME + ".json"]
    return names


def _selected_evidence(job: Job) -> Evidence:
    return evidence_of(job[SELECTION], job.config.refine, common_sigma_m(job.run))


FAST_MESH = mesh_stage(
    (SDF, GLINTS),
    lambda job: job[SDF],
    lambda job: Evidence(glints=job[GLINTS].glints, common_sigma_m=common_sigma_m(job.run)),
    fit=lambda config: config.fit,
)
BEST_MESH = mesh_stage(
    (REFINED_SDF, SELECTION),
    lambda job: job[REFINED_SDF],
    _selected_evidence,
    fit=lambda config: config.refine.fit,
)
FAST_STAGES: Stages = (GLINTS, SDF, FAST_MESH)
BEST_STAGES: Stages = (GLINTS, SELECTION, REFINED_SDF, BEST_MESH)
