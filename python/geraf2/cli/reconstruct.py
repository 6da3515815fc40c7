"""`geraf2 reconstruct`: the surface of what is hidden in the box."""

import resource
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import tomli_w
import tyro

from geraf2 import __version__
from geraf2.baselines import BaselineConfig, matched_filter_surface
from geraf2.cli._baselines import BASELINES, Baseline, open_meshes, settings_of
from geraf2.cli._console import (
    CONSOLE,
    Positional,
    Threads,
    print_findings,
    progress_bar,
    require_threads,
    rows,
    say,
)
from geraf2.cli._geraf1 import at_best_level, cropped_prior, geraf1_config
from geraf2.cli._hybrid import (
    MOVED_NAME,
    HeatmapJob,
    load_second_look,
    move_to_heatmaps,
    save_second_look,
)
from geraf2.cli._logging import logging_to
from geraf2.cli._paper import PaperJob, train
from geraf2.cli._planes import keep_planes
from geraf2.cli._prior import Triple, load_prior
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.glints import Glints, find_glints
from geraf2.glints.prior_check import require_echoes_inside
from geraf2.io.atomic import write_text_atomic
from geraf2.io.run_folder import (
    CONFIG_NAME,
    CONTENT_NAME,
    LOG_NAME,
    REPORT_NAME,
    RunFolder,
    stage_key,
)
from geraf2.paper.config import PaperConfig
from geraf2.pipeline.los import LOS_STAGE, heat_map, photos_of_los, trained_los
from geraf2.pipeline.los_options import LosOptions
from geraf2.scene import Capture, LosPrior, load_capture
from geraf2.scene.checks import Finding, require_plausible
from geraf2.scene.los_checks import require_prior_in_view
from geraf2.scene.store import capture_digest
from geraf2.scene.summary import CaptureSummary, summarize_capture
from geraf2.surfaces import FitConfig, ReconstructConfig, fit_sdf
from geraf2.surfaces.config import HeatmapFitConfig
from geraf2.surfaces.hybrid import HybridConfig, SecondLook, fit_hybrid, look_again

if TYPE_CHECKING:
    from geraf2.surfaces.extraction import ExtractedMeshes

# Raised when a stage computes something else from the same inputs.
STAGE_VERSIONS = {
    "glints": 6,
    "second_look": 3,
    "sdf": 10,
    "heatmaps": 1,
    "train": 1,
    "baseline": 2,
    "level": 2,
    "mesh": 2,
}

Preset = Literal["glint", "hybrid", "paper", "geraf1"] | Baseline

PRESET_STAGES: dict[str, tuple[str, ...]] = {
    "glint": ("glints", "sdf", "mesh"),
    "hybrid": ("glints", "second_look", "sdf", "heatmaps", "mesh"),
    "paper": ("train", "mesh"),
    "geraf1": ("train", "mesh"),
    **dict.fromkeys(BASELINES, ("baseline", "mesh")),
    "normal-field": ("baseline", "level", "mesh"),
}
"""Stages that each preset runs, as in STAGE_VERSIONS; "level" is a part of "baseline"."""

MESH_NAMES = ("mesh", "mesh_box", "mesh_content")
FIT_NAME = "sdf_fit.npz"  # as fitted: its gradient is below 1 and it holds every fragment
SDF_NAME = "sdf.npz"  # distance to the content's mesh

_T = TypeVar("_T")


@dataclass(frozen=True, kw_only=True)
class Config:
    """Reconstruct the surface of what is hidden in the box; box and content in metres."""

    scene: Positional[Annotated[Path, tyro.conf.arg(metavar="SCENE")]]
    """Scene folder."""
    out: Positional[Annotated[Path, tyro.conf.arg(metavar="OUT")]]
    """Run folder for meshes, fields, report, log."""
    los: Annotated[Path | None, tyro.conf.arg(metavar="MESH|PHOTOS")] = None
    """Outside of the box: a closed mesh in metres in the frame of the scene, a folder that
    `geraf2 los` made, or photos with poses, from which a surface is trained first."""
    box: Annotated[Triple | None, tyro.conf.arg(metavar="X Y Z")] = None
    """Or the outer side lengths of the box, axes along the frame's [m]."""
    box_center: Annotated[Triple, tyro.conf.arg(metavar="X Y Z")] = (0.0, 0.0, 0.0)
    """Where the middle of --box lies [m]."""
    preset: Preset = "glint"
    """"glint": oriented points and a linear fit, seconds. "hybrid": finer, and for scatterers and
    few planes: a second look from the rim of the planes, shadows on the far walls, and a fit of
    heat maps; a minute or two. "paper": the learned method of the paper, minutes to an hour
    (docs/method.md). The others are there to be compared with (docs/benchmark.md)."""
    hold_out: Annotated[tuple[float, ...], tyro.conf.arg(metavar="DEG ...")] = ()
    """Turntable angles of planes that are left out, for `geraf2 render` [degrees]."""
    trust_los: bool = False
    """Go on even if most of the echoes come from outside the box."""
    resume: bool = False
    """Keep the stages in OUT that are done and would come out the same."""
    no_report: bool = False
    """Leave out the report and its pictures."""
    seed: int = 0
    """Seed of the samples that `evaluate` draws, of training and of the fit to heat maps."""
    threads: Threads = None
    """Threads to use; all when not given."""
    photos: LosOptions = field(default_factory=LosOptions)
    """How the photos of --los are meant."""
    settings: Annotated[ReconstructConfig, tyro.conf.arg(name="")] = field(
        default_factory=ReconstructConfig
    )
    """Constants of the method."""
    hybrid: HybridConfig = field(default_factory=HybridConfig)
    """Constants of `--preset hybrid`, which reads --glints too, and its own fit for --fit."""
    heatmaps: HeatmapFitConfig = field(default_factory=HeatmapFitConfig)
    """How `--preset hybrid` is fitted to heat maps at last; --heatmaps.n-rounds 0: not at all."""
    paper: PaperConfig = field(default_factory=PaperConfig)
    """Constants of `--preset paper`."""
    baseline: BaselineConfig = field(default_factory=BaselineConfig)
    """Constants of the presets to compare with."""


@dataclass(frozen=True, kw_only=True)
class _Job:
    """What every stage needs."""

    run: RunFolder
    capture: Capture
    prior: LosPrior
    settings: ReconstructConfig
    hybrid: HybridConfig | None
    """None for another preset."""
    heatmaps: HeatmapFitConfig
    paper: PaperConfig
    baseline: BaselineConfig
    seed: int
    num_threads: int | None
    trust_los: bool
    resume: bool
    inputs: dict[str, Any]
    """Scene, prior and planes, for the keys of the stages."""


def main(config: Config) -> int:
    """Run the command."""
    run = reconstruct_scene(config)
    _print_outcome(run)
    return 0


def reconstruct_scene(config: Config) -> RunFolder:
    """Run all stages that are not done yet."""
    num_threads = require_threads(config.threads)
    if config.seed < 0:
        raise UserError(what="--seed must not be negative", got=config.seed)
    start = time.perf_counter()
    capture = load_capture(config.scene)
    summary = summarize_capture(capture)
    findings = require_plausible(summary, config.scene)
    print_findings(findings)
    photos = None if config.box else photos_of_los(config.los, config.photos, summary, CONSOLE)
    if photos is None:  # a wrong prior is refused before the run folder is touched
        prior, prior_name = _prior(config, config.los, capture, summary)
    run = RunFolder.open(
        config.out, scene_digest=capture_digest(capture), scene_name=config.scene.resolve().name
    )
    capture = keep_planes(capture, config.hold_out, config.scene)
    with logging_to(run):
        _log_start(run, config, findings)
        try:
            if photos is None:
                run.forget([LOS_STAGE])  # of an earlier prior; its files stay for its photos
            else:
                prior, prior_name = _prior(
                    config, trained_los(run, photos, CONSOLE), capture, summary
                )
            _run_all(_job(config, run, capture, prior, num_threads), config, prior_name)
        except BaseException as error:
            _log_stop(run, error)
            raise
        run.log(
            "finished",
            level="info",
            seconds=round(time.perf_counter() - start, 2),
            peak_memory_mib=round(_peak_memory_bytes() / 2**20),
        )
    return run


def _job(
    config: Config, run: RunFolder, capture: Capture, prior: LosPrior, num_threads: int | None
) -> _Job:
    inputs: dict[str, Any] = {"scene": run.scene_digest}
    inputs["prior"] = stage_key(vertices=prior.vertices, faces=prior.faces, walls=prior.walls)
    if config.hold_out:
        inputs["hold_out"] = config.hold_out
    return _Job(
        run=run,
        capture=capture,
        prior=prior,
        settings=config.settings,
        hybrid=config.hybrid if config.preset == "hybrid" else None,
        heatmaps=config.heatmaps,
        paper=config.paper,
        baseline=config.baseline,
        seed=config.seed,
        num_threads=num_threads,
        trust_los=config.trust_los,
        resume=config.resume,
        inputs=inputs,
    )


def _run_all(job: _Job, config: Config, prior_name: object) -> None:
    if not config.resume:
        job.run.forget([*STAGE_VERSIONS, "report"])
    if config.preset in ("paper", "geraf1"):
        _run_paper_stages(job, prior_name, geraf1=config.preset == "geraf1")
    elif config.preset in BASELINES:
        _run_baseline_stages(job, config.preset, prior_name)
    else:
        _run_stages(job, prior_name)
    if not config.no_report:
        _run_report(job)


def _prior(
    config: Config, los: Path | None, capture: Capture, summary: CaptureSummary
) -> tuple[LosPrior, object]:
    """Prior of --box, or of a mesh or folder, where the radar looks; and its name in errors."""
    prior, name = load_prior(los, config.box, config.box_center, capture.walls)
    require_prior_in_view(prior, summary, name)
    return prior, name


def _run_stages(job: _Job, prior_name: object) -> None:
    glints_key = stage_key(
        version=STAGE_VERSIONS["glints"], **job.inputs, config=job.settings.glints
    )
    glints = _stage(
        job,
        "glints",
        glints_key,
        lambda report: _compute_glints(job, prior_name, report),
        lambda folder: Glints.load(folder / "glints.npz"),
    )
    job.run.log("glints", level="info", count=len(glints))
    fit: FitConfig | HybridConfig = job.settings.fit
    seen, look = glints, None
    inputs = {"glints": glints_key}
    if job.hybrid is not None:
        inputs["second_look"] = stage_key(
            version=STAGE_VERSIONS["second_look"],
            glints=glints_key,
            links=job.hybrid.links,
            rim=job.hybrid.rim,
            silhouettes=job.hybrid.silhouettes if job.hybrid.shadows else None,
        )
        look = _second_look(job, job.hybrid, glints, inputs["second_look"])
        fit, seen = job.hybrid, look.seen
    sdf_key = stage_key(version=STAGE_VERSIONS["sdf"], **inputs, config=fit)
    sdf = _stage(
        job,
        "sdf",
        sdf_key,
        lambda report: _compute_sdf(job, glints, look, report),
        lambda folder: SdfGrid.load(folder / FIT_NAME),
    )
    if job.hybrid is not None and job.heatmaps.n_rounds > 0:
        sdf_key = stage_key(
            version=STAGE_VERSIONS["heatmaps"],
            sdf=sdf_key,
            config=job.heatmaps,
            seed=job.seed,
        )
        heatmap_job = HeatmapJob(
            run=job.run, capture=job.capture, prior=job.prior, config=job.heatmaps, start=sdf,
            evidence=seen, seed=job.seed, num_threads=job.num_threads,
        )  # fmt: skip
        sdf = _stage(
            job,
            "heatmaps",
            sdf_key,
            lambda report: move_to_heatmaps(heatmap_job, report),
            lambda folder: SdfGrid.load(folder / MOVED_NAME),
        )
    mesh_key = stage_key(version=STAGE_VERSIONS["mesh"], sdf=sdf_key)
    _stage(
        job,
        "mesh",
        mesh_key,
        lambda report: _compute_meshes(job, sdf, seen, report),
        lambda folder: None,
    )


def _second_look(job: _Job, hybrid: HybridConfig, glints: Glints, key: str) -> SecondLook:
    def compute(report: Callable[[float], None]) -> tuple[SecondLook, list[str]]:
        found = look_again(
            job.capture, job.prior, glints, hybrid, job.settings.glints,
            num_threads=job.num_threads, progress=report,
        )  # fmt: skip
        return found, save_second_look(found, job.run)

    found = _stage(
        job,
        "second_look",
        key,
        compute,
        lambda folder: load_second_look(folder, hybrid),
    )
    job.run.log("second look", level="info", **found.counts())
    return found


def _run_paper_stages(job: _Job, prior_name: object, *, geraf1: bool) -> None:
    config = geraf1_config(job.paper) if geraf1 else job.paper
    inputs = {**job.inputs, **({"preset": "geraf1"} if geraf1 else {})}
    train_key = stage_key(version=STAGE_VERSIONS["train"], **inputs, config=config, seed=job.seed)
    crop_m = config.crop_m
    paper = PaperJob(
        run=job.run,
        capture=job.capture,
        prior=cropped_prior(job.prior, crop_m) if geraf1 else job.prior,
        config=config,
        seed=job.seed,
        num_threads=job.num_threads,
        resume=job.resume,
        key=train_key,
    )

    def compute(report: Callable[[float], None]) -> tuple[SdfGrid, list[str]]:
        if not job.trust_los:
            require_echoes_inside(job.capture, job.prior, prior_name, num_threads=job.num_threads)
        return train(paper, report)

    def compute_meshes(report: Callable[[float], None]) -> tuple[None, list[str]]:
        field_at_level = sdf
        if geraf1:
            field_at_level = at_best_level(
                sdf, job.capture, job.prior, crop_m, job.baseline.geraf1_level, job.num_threads
            )
        return _compute_meshes(job, field_at_level, crop_m, report)

    sdf = _stage(job, "train", train_key, compute, lambda folder: SdfGrid.load(folder / FIT_NAME))
    mesh_key = stage_key(
        version=STAGE_VERSIONS["mesh"],
        sdf=train_key,
        level=job.baseline.geraf1_level if geraf1 else None,
    )
    _stage(job, "mesh", mesh_key, compute_meshes, lambda folder: None)


def _run_baseline_stages(job: _Job, preset: Baseline, prior_name: object) -> None:
    inputs = {
        **job.inputs,
        "preset": preset,
        "config": settings_of(preset, job.baseline),
        "versions": [STAGE_VERSIONS[name] for name in PRESET_STAGES[preset] if name != "mesh"],
    }
    key = stage_key(**inputs)
    mesh_key = stage_key(version=STAGE_VERSIONS["mesh"], baseline=key)
    for name in ("glints.npz", FIT_NAME, SDF_NAME):  # of another preset: the report draws them
        if not job.run.is_done("mesh", mesh_key):
            (job.run.path / name).unlink(missing_ok=True)
    if not job.trust_los:
        require_echoes_inside(job.capture, job.prior, prior_name, num_threads=job.num_threads)

    def compute_open(report: Callable[[float], None]) -> tuple[None, list[str]]:
        meshes = open_meshes(preset, job.capture, job.prior, job.baseline, job.num_threads, report)
        return None, _write_meshes(job, meshes)

    def compute_field(report: Callable[[float], None]) -> tuple[SdfGrid, list[str]]:
        sdf = matched_filter_surface(
            job.capture,
            job.prior,
            job.baseline.matched_filter,
            num_threads=job.num_threads,
            progress=report,
        )
        sdf.save(job.run.path / FIT_NAME)
        return sdf, [FIT_NAME]

    if preset != "matched-filter":  # an open surface: there is no distance to go with it
        _stage(job, "mesh", mesh_key, compute_open, lambda folder: None)
        return
    sdf = _stage(
        job, "baseline", key, compute_field, lambda folder: SdfGrid.load(folder / FIT_NAME)
    )
    crop_m = job.baseline.matched_filter.crop_m

    def compute_meshes(report: Callable[[float], None]) -> tuple[None, list[str]]:
        return _compute_meshes(job, sdf, crop_m, report)

    _stage(job, "mesh", mesh_key, compute_meshes, lambda folder: None)


def _run_report(job: _Job) -> None:
    mesh = job.run.stages["mesh"]
    _stage(
        job,
        "report",
        stage_key(mesh=mesh.files, generator=__version__),
        lambda report: _compute_report(job, report),
        lambda folder: None,
    )


def _stage(
    job: _Job,
    name: str,
    key: str,
    compute: Callable[[Callable[[float], None]], tuple[_T, list[str]]],
    load: Callable[[Path], _T],
) -> _T:
    """Read the result of a stage if it is done, else compute and record it."""
    if job.run.is_done(name, key):
        job.run.log("reused", level="info", stage=name)
        with progress_bar(f"{name} (done before)"):
            return load(job.run.path)
    start, cpu_start = time.perf_counter(), time.process_time()
    job.run.log("started", level="info", stage=name)
    with progress_bar(name) as report:
        result, files = compute(report)
    seconds, cpu_seconds = time.perf_counter() - start, time.process_time() - cpu_start
    job.run.mark_done(name, key, files, seconds)
    job.run.log(
        "done",
        level="info",
        stage=name,
        seconds=round(seconds, 3),
        cpu_seconds=round(cpu_seconds, 3),
        peak_memory_mib=round(_peak_memory_bytes() / 2**20),
    )
    return result


def _compute_glints(
    job: _Job, prior_name: object, report: Callable[[float], None]
) -> tuple[Glints, list[str]]:
    if not job.trust_los:
        require_echoes_inside(job.capture, job.prior, prior_name, num_threads=job.num_threads)
    glints = find_glints(
        job.capture,
        job.prior,
        job.settings.glints,
        num_threads=job.num_threads,
        progress=report,
    )
    glints.save(job.run.path / "glints.npz")
    return glints, ["glints.npz"]


def _compute_sdf(
    job: _Job,
    glints: Glints,
    look: SecondLook | None,
    report: Callable[[float], None],
) -> tuple[SdfGrid, list[str]]:
    if look is None:
        sdf = fit_sdf(
            glints, job.capture, job.prior, job.settings.fit,
            num_threads=job.num_threads, progress=report,
        )  # fmt: skip
    else:
        sdf = fit_hybrid(
            glints, look, job.capture, job.prior, job.hybrid,
            num_threads=job.num_threads, progress=report,
        )  # fmt: skip
    sdf.save(job.run.path / FIT_NAME)
    return sdf, [FIT_NAME]


def _compute_meshes(
    job: _Job, sdf: SdfGrid, evidence: Glints | float, report: Callable[[float], None]
) -> tuple[None, list[str]]:
    """Meshes of a field with glints, or of one without whose box is cropped by so much [m]."""
    from geraf2.surfaces.extraction import (  # noqa: PLC0415 - scikit-image takes 0.3 s
        extract_cropped_meshes,
        extract_meshes,
    )

    report(0.0)
    if isinstance(evidence, Glints):
        meshes = extract_meshes(sdf, evidence, job.prior, num_threads=job.num_threads)
    else:
        meshes = extract_cropped_meshes(sdf, job.prior, evidence, num_threads=job.num_threads)
    return None, [_save_distance(job, sdf, meshes), *_write_meshes(job, meshes)]


def _save_distance(job: _Job, sdf: SdfGrid, meshes: "ExtractedMeshes") -> str:
    """Write the field that goes with the mesh: dropped pieces are gone from it."""
    from geraf2.surfaces.isosurface import redistance  # noqa: PLC0415 - scikit-image takes 0.3 s

    content = meshes.mesh_content
    if content.faces.shape[0]:
        sdf = redistance(sdf, content, num_threads=job.num_threads)
    sdf.save(job.run.path / SDF_NAME)
    return SDF_NAME


def _write_meshes(job: _Job, meshes: "ExtractedMeshes") -> list[str]:
    from geraf2.io.mesh import ply_bytes, write_mesh  # noqa: PLC0415 - used here only

    job.run.forget_derived(ply_bytes(meshes.mesh_content, job.capture.frame))
    files = []
    for name, mesh in zip(MESH_NAMES, meshes, strict=True):
        for suffix in (".ply", ".glb"):
            write_mesh(mesh, job.run.path / (name + suffix), frame=job.capture.frame)
            files += [name + suffix, name + suffix + ".json"]
    return files


def _compute_report(job: _Job, report: Callable[[float], None]) -> tuple[None, list[str]]:
    from geraf2.report import write_report  # noqa: PLC0415 - matplotlib takes 0.5 s

    report(0.0)
    by_photos = LOS_STAGE in job.run.stages
    write_report(
        job.run.path,
        heatmap=heat_map(job.capture, job.prior, job.num_threads) if by_photos else None,
        provenance=job.capture.provenance,
        num_threads=job.num_threads,
    )
    return None, [REPORT_NAME]


def _log_start(run: RunFolder, config: Config, findings: tuple[Finding, ...]) -> None:
    run.log(
        "start",
        level="info",
        version=__version__,
        python=sys.version.split()[0],
        resume=config.resume,
    )
    for finding in findings:
        run.log(str(finding), level="warning")
    write_text_atomic(run.path / CONFIG_NAME, tomli_w.dumps(resolved(config)))


def resolved(config: Any) -> dict[str, Any]:
    """Every setting as it was used, for config.toml; what was left open is left out."""
    table: dict[str, Any] = {}
    for entry in fields(config):
        value = getattr(config, entry.name)
        if is_dataclass(value):
            table[entry.name] = resolved(value)
        elif isinstance(value, Path):
            table[entry.name] = str(value)
        elif isinstance(value, tuple):
            table[entry.name] = list(value)
        elif value is not None:
            table[entry.name] = value
    return table


def _log_stop(run: RunFolder, error: BaseException) -> None:
    """Say in the log why the run stopped; a full disk must not hide the error itself."""
    text = "interrupted" if isinstance(error, KeyboardInterrupt) else " ".join(str(error).split())
    try:
        run.log("stopped", level="error", message=f"the run stopped: {text}")
    except OSError:
        return


def _peak_memory_bytes() -> int:
    # Linux counts it in KiB.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _print_outcome(run: RunFolder) -> None:
    seconds = {name: record.seconds for name, record in run.stages.items()}
    say("stages   " + ", ".join(f"{name} {value:.1f} s" for name, value in seconds.items()))
    rows(
        [
            ("content", str(run.path / CONTENT_NAME)),
            ("box", str(run.path / "mesh_box.ply")),
            ("both", str(run.path / "mesh.ply")),
            *([("report", str(run.path / REPORT_NAME))] if "report" in run.stages else []),
            ("log", str(run.path / LOG_NAME)),
        ]
    )
