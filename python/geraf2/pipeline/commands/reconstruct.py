"""From a capture and the outside of its box to a run folder with the surface of the content."""

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any
from weakref import finalize

import numpy as np

from geraf2 import __version__
from geraf2._types import Progress
from geraf2.calibration.driver import CALIBRATION_VERSION
from geraf2.echoes.prior_check import require_echoes_inside
from geraf2.errors import UserError
from geraf2.imaging.peaks import KeptPeaks
from geraf2.io.belt_file import MOTION_KEY
from geraf2.io.outputs import require_consent
from geraf2.io.planes import ScannedPlanes, save_planes
from geraf2.io.run_folder import (
    CALIBRATION_NAME,
    CONFIG_NAME,
    PLANES_NAME,
    PRIOR_NAME,
    REPORT_FILES,
    REPORT_NAME,
    RUN_NAME,
    SAMPLES_NAME,
    RunFolder,
    stage_key,
)
from geraf2.ops._threads import limit_blas_threads
from geraf2.pipeline.box_check import (
    BOX_STAGE,
    BoxCheck,
    box_from_radar,
    checked_prior,
    require_determined,
)
from geraf2.pipeline.estimates import require_reconstructable
from geraf2.pipeline.events import Listener
from geraf2.pipeline.planes import keep_planes, planes_at
from geraf2.pipeline.posterior import require_posterior
from geraf2.pipeline.presets import STAGE_NAMES, PresetConfig, preset_type, stages_of
from geraf2.pipeline.prior import PriorSource, save_prior, with_walls
from geraf2.pipeline.prior_stage import PRIOR_STAGE, PriorJob, find_prior_job, heat_map, made_prior
from geraf2.pipeline.reconstruction import Reconstruction
from geraf2.pipeline.run_log import RunListener, logging_to
from geraf2.pipeline.run_record import RunOptions, RunRecord
from geraf2.pipeline.sign_check import naming_the_sign, require_sign
from geraf2.pipeline.stages.calibration import (
    CALIBRATION,
    CALIBRATION_STAGE,
    COARSE_CALIBRATION,
    calibrated,
)
from geraf2.pipeline.stages.stage import Job, Stage, kept_peaks, peak_memory_bytes
from geraf2.scene import Capture, LosPrior, load_capture
from geraf2.scene.aperture import Aperture
from geraf2.scene.checks import Finding, require_plausible
from geraf2.scene.los_checks import require_prior_in_view
from geraf2.scene.store import capture_digest
from geraf2.scene.summary import CaptureSummary, summarize_capture
from geraf2.surfaces.samples import SurfaceSamples

SAMPLES_STAGE = "samples"
"""Name of the stage that `RunOptions.samples` asks for."""


@limit_blas_threads
def reconstruct(
    capture: Capture | Path | str,
    prior: LosPrior | PriorSource | Path | str | tuple[float, float, float] | None = None,
    preset: PresetConfig | str = "best",
    out: Path | str | None = None,
    *,
    options: RunOptions | None = None,
    resume: bool = False,
    overwrite: bool = False,
    report: bool = False,
    num_threads: int | None = None,
    listener: Listener | None = None,
) -> Reconstruction:
    """Reconstruct the surface of what is hidden in the box.

    capture: scene folder, or a capture in memory.
    prior: outside of the box: a prior, three outer side lengths about the origin [m], a closed mesh
    in metres in the capture's frame, a folder that `geraf2 los` made, or photos with poses; None:
    found by radar (`geraf2.find_box`). A cuboid that is off by millimetres or degrees is corrected.
    A prior without walls takes those that the capture knows.
    preset: its name, or its constants: best, fast, paper, or a method to compare with.
    out: run folder; a temporary one when not given, which goes with the result.
    options: planes left out, whether to calibrate, seed, how photos are meant.
    resume: keep stages in `out` that are done and would come out the same.
    overwrite: replace a finished result in `out` that has other settings or is of another scene.
    report: also draw pictures and write `report.html`.
    num_threads: all when None.
    listener: hears progress and warnings.

    Returns meshes [m], signed distance [m], glints and numbers, as they lie in the run folder.
    Raises UserError where capture and prior do not go together, no box is found, echoes come from
    outside the box, or `out` holds something else or is being written into.

    >>> from geraf2.surfaces import FitConfig
    >>> coarse = geraf2.FastPreset(fit=FitConfig(spacing_m=0.01, distance_rounds=1))
    >>> capture, truth = geraf2.examples.small_capture()
    >>> prior = geraf2.LosPrior.from_box(geraf2.examples.BOX_M)
    >>> result = geraf2.reconstruct(capture, prior, coarse, "out")
    >>> bool(result.content.extents.max() < 0.1)  # [m]
    True
    """
    options = options or RunOptions()
    config = preset_type(preset)() if isinstance(preset, str) else preset
    if options.samples:
        require_posterior(config, options.samples)
    scene = None if isinstance(capture, Capture) else Path(capture)
    loaded = capture if isinstance(capture, Capture) else load_capture(capture)
    record = RunRecord(scene=scene, prior=PriorSource.of(prior), options=options, config=config)
    given = prior if isinstance(prior, LosPrior) else None
    digest, name = capture_digest(loaded), scene.resolve().name if scene else "capture"
    if out is not None and not overwrite:
        _require_replaceable(Path(out), digest, name, record)
    request = Request.of(loaded, given, record, listener or Listener(), num_threads)
    folder = temporary_folder() if out is None else Path(out)
    run = RunFolder.open(folder, scene_digest=digest, scene_name=name, overwrite=overwrite)
    if out is None:
        finalize(run, rmtree, folder, ignore_errors=True)
    with run.locked("mesh", request.key, overwrite=overwrite):
        run_request(request, run, resume=resume, report=report)
    return Reconstruction(run)


def _require_replaceable(folder: Path, digest: str, name: str, record: RunRecord) -> None:
    """Raise UserError, before any work, where a folder holds a finished result of another request.

    Another prior is noticed only when the folder is locked: a found one is not known before.
    """
    if not (folder / RUN_NAME).is_file():
        return
    run = RunFolder.open(folder, scene_digest=digest, scene_name=name)
    try:
        stored = RunRecord.read(folder / CONFIG_NAME)
    except UserError:  # a broken record is replaced
        return
    key, asked = (_request_key("", one.options, one.config) for one in (stored, record))
    if "mesh" in run.stages and key != asked:
        require_consent(folder, "a finished mesh of other settings", overwrite=False)


BY_RADAR = "the box by radar"
"""Name of a found box in messages."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Request:
    """A request whose inputs were checked, before its run folder is touched."""

    capture: Capture
    summary: CaptureSummary
    findings: Sequence[Finding]
    """Warnings about the capture."""
    prior: tuple[LosPrior, str] | None
    """Prior and its name in errors; None where it is first made of photos."""
    box: BoxCheck | None
    """Comparison with the box by radar; None where the prior is trusted, or made of photos."""
    box_seconds: tuple[float, float]
    """Time and processor time that it took [s]."""
    making: PriorJob | None
    """Job that makes it."""
    record: RunRecord
    key: str
    """Hash of all that the meshes depend on."""
    listener: Listener
    num_threads: int | None
    started: float
    """Time of its begin, of `time.perf_counter` [s]."""

    @classmethod
    def of(
        cls,
        capture: Capture,
        given: LosPrior | None,
        record: RunRecord,
        listener: Listener,
        num_threads: int | None,
        summary: CaptureSummary | None = None,
    ) -> "Request":
        """Check capture, prior and angles; UserError where one of them cannot be used.

        given: prior in memory; else the record names its source, or none.
        summary: of the capture, if already computed.
        """
        begin = time.perf_counter()
        where, options, source = record.scene or "capture", record.options, record.prior
        summary = summary or summarize_capture(capture)
        findings = require_plausible(summary, where)
        listener.findings(findings)
        making = find_prior_job(source.los, options.photos, summary, listener)
        found, box = None, None
        start, cpu_start = time.perf_counter(), time.process_time()
        if making is None and (given is not None or source.is_given):
            last = options.trust_los
            found = _prior(given or source, capture, summary, listener, is_last=last)
            if not options.trust_los:
                with naming_the_sign(capture, where, num_threads):
                    box = checked_prior(capture, *found, summary, listener, num_threads)
        elif making is None:
            with naming_the_sign(capture, where, num_threads):
                box = box_from_radar(capture, summary, listener, num_threads)
        if box is not None:
            if box.found is None:  # no wall is seen where it is
                require_sign(capture, where, num_threads)
            found = box.prior, found[1] if found else BY_RADAR
        box_seconds = time.perf_counter() - start, time.process_time() - cpu_start
        if found:
            require_reconstructable(summary, record.config, found[0].size_m, where)
        keep_planes(capture, options.hold_out, where)
        outside = _prior_key(found[0]) if found else making.key if making else ""
        return cls(
            capture=capture if box is None else box.placed(capture),
            summary=summary,
            findings=findings,
            prior=found,
            box=box,
            box_seconds=box_seconds,
            making=making,
            record=record,
            key=_request_key(outside, options, record.config),
            listener=listener,
            num_threads=num_threads,
            started=begin,
        )

    @property
    def where(self) -> Path | str:
        """The capture in messages."""
        return self.record.scene or "capture"


def run_request(
    request: Request,
    run: RunFolder,
    *,
    peaks: KeptPeaks | None = None,
    resume: bool = False,
    report: bool = False,
) -> None:
    """Run all stages of a request in a locked run folder.

    peaks: of the capture's planes, where they are known; collected when None.
    """
    options = request.record.options
    with logged(run, resume=resume):
        job, prior_name = start_job(request, run, peaks=peaks, resume=resume)
        has_motion = MOTION_KEY in request.capture.provenance
        stage = COARSE_CALIBRATION if has_motion else CALIBRATION
        job = calibrated_job(job, options, request.where, stage)
        left_out = planes_at(request.capture, options.hold_out, request.where)
        keep_inputs(job, [p for n, p in enumerate(request.summary.planes) if n not in left_out])
        with naming_the_sign(request.capture, request.where, request.num_threads):
            run_stages(job, prior_name, options, report=report)
        seconds = round(time.perf_counter() - request.started, 2)
        memory = round(peak_memory_bytes() / 2**20)
        run.log("finished", level="info", seconds=seconds, peak_memory_mib=memory)


def start_job(
    request: Request,
    run: RunFolder,
    *,
    peaks: KeptPeaks | None = None,
    tolerance_m: float = 0.0,
    resume: bool = False,
) -> tuple[Job, str]:
    """Job of the stages in the run folder, with its prior; and the prior's name.

    peaks: of planes that were imaged before; kept if the prior moved by at most `tolerance_m` [m].
    """
    run.restart()
    heard = RunListener(run, request.listener)
    for finding in request.findings:
        run.warn(str(finding), finding.severity)
    run.release(CONFIG_NAME, PRIOR_NAME, PLANES_NAME)
    record = request.record
    record.write(run.path / CONFIG_NAME)
    if request.prior is None:
        assert request.making is not None  # or there would be a prior
        source = PriorSource(los=made_prior(run, request.making, heard))
        prior, name = _prior(source, request.capture, request.summary, heard)
    else:
        prior, name = request.prior
        run.forget([PRIOR_STAGE])  # of an earlier prior; its files stay for its photos
    key = _prior_key(prior)
    run.forget([BOX_STAGE])
    if request.box is not None:
        box = request.box
        numbers = {"by_radar": box.text, **(box.found.numbers() if box.found else {})}
        seconds, cpu = (round(value, 3) for value in request.box_seconds)
        run.mark_done(BOX_STAGE, key, [], seconds, cpu_seconds=cpu, numbers=numbers)
        (heard if box.is_warning else request.listener).note(box.text)
    job = Job(
        run=run,
        capture=request.capture,
        prior=prior,
        config=record.config,
        seed=record.options.seed,
        inputs={"scene": run.scene_digest, "prior": key, "hold_out": record.options.hold_out},
        listener=heard,
        peaks=peaks.about(prior, tolerance_m)
        if peaks is not None
        else kept_peaks(prior, record.config, request.num_threads),
        num_threads=request.num_threads,
        resume=resume,
        asked=request.key,
        made_from={
            "scene": run.scene_digest,
            "prior": key,
            "command": record.command(run.scene_name),
        },
    )
    return job, name


def keep_inputs(job: Job, planes: Sequence[Aperture]) -> None:
    """Write the prior and the planes that the run reads, and note them in its record."""
    run = job.run
    save_prior(job.prior, run.path / PRIOR_NAME)
    scanned = ScannedPlanes(
        corners_m=np.array([plane.corners_m for plane in planes]).reshape(-1, 4, 3),
        wavelength_m=job.capture.waveform.center_wavelength_m,
    )
    save_planes(scanned, run.path / PLANES_NAME)
    run.keep(CONFIG_NAME, PRIOR_NAME, PLANES_NAME)


def temporary_folder() -> Path:
    """Make the folder of a run whose caller names none."""
    try:
        return Path(mkdtemp(prefix="geraf2-"))
    except OSError as error:
        raise UserError(
            what="there is no folder for temporary files", got=str(error), hint="give `out`"
        ) from None


def _prior(
    source: LosPrior | PriorSource,
    capture: Capture,
    summary: CaptureSummary,
    listener: Listener,
    *,
    is_last: bool = True,
) -> tuple[LosPrior, str]:
    """Prior, checked to lie in view, and its name in errors.

    is_last: whether it is used as it is; a warning states a size that the scene contradicts.
    """
    prior, name = (source, "prior") if isinstance(source, LosPrior) else source.load((), listener)
    if not prior.walls:
        prior = with_walls(prior, capture.walls, listener if is_last else None)
    require_prior_in_view(prior, summary, name)
    return prior, name


def _request_key(outside: str, options: RunOptions, config: PresetConfig) -> str:
    """Hash of all that the meshes of a scene depend on, known before the work."""
    return stage_key(
        prior=outside,
        hold_out=options.hold_out,
        calibration=CALIBRATION_VERSION if options.calibrate == "auto" else None,
        preset=config.preset,
        stages=[
            [stage.name, stage.version, stage.settings(config), options.seed if stage.seeded else 0]
            for stage in stages_of(config)
        ],
    )


def _prior_key(prior: LosPrior) -> str:
    certain = {} if prior.certain is None else {"certain": prior.certain}
    return stage_key(vertices=prior.vertices, faces=prior.faces, walls=prior.walls, **certain)


def calibrated_job(
    job: Job, options: RunOptions, where: object, stage: Stage[Any] = CALIBRATION
) -> Job:
    """Job on the planes that are not left out, corrected by the calibration of all planes."""
    more: dict[str, str] = {}
    if options.calibrate == "no":
        job.run.forget([CALIBRATION_STAGE])
        (job.run.path / CALIBRATION_NAME).unlink(missing_ok=True)
    else:
        capture, prior, more = calibrated(job, stage)
        job = replace(job, capture=capture, prior=prior)
    kept = keep_planes(job.capture, options.hold_out, where)
    return replace(job, capture=kept, inputs={**job.inputs, **more})


def run_stages(job: Job, prior_name: object, options: RunOptions, *, report: bool = False) -> None:
    """Run the stages of a job's preset, and those that the options ask for."""
    stages, run = stages_of(job.config), job.run
    if options.samples:
        stages = (*stages, _samples_stage(stages[-1], options.samples))
    kept = {stage.name for stage in stages} if job.resume else set()
    run.forget((STAGE_NAMES | {SAMPLES_STAGE}) - kept, stale=True)
    if not job.resume:
        run.forget(["report"])
    if not (options.trust_los or run.is_done(stages[0].name, job.key(stages[0]))):
        with job.listener.step("prior"):
            peaks = job.peaks.of(job.capture)
            try:
                require_echoes_inside(
                    job.capture, job.prior, peaks, prior_name, num_threads=job.num_threads
                )
            except UserError as error:
                if prior_name != BY_RADAR:  # that is the best there is
                    raise
                job.listener.warning(str(error))
    for stage in stages:
        job.do(stage)
    if prior_name == BY_RADAR:
        require_determined(run)
    run.drop_stale()
    if report:
        job.do(_report_stage(stages_of(job.config)[-1]))
        run.keep(*REPORT_FILES)


def _samples_stage(mesh: Stage[Any], n_samples: int) -> Stage[Any]:
    def save(job: Job, samples: SurfaceSamples) -> list[str]:
        samples.save(job.run.path / SAMPLES_NAME)
        return [SAMPLES_NAME]

    return Stage(
        name=SAMPLES_STAGE,
        version=1,
        inputs=(mesh,),
        settings=lambda _: n_samples,
        seeded=True,
        compute=lambda job, _: Reconstruction(job.run).samples(
            n_samples, seed=job.seed, num_threads=job.num_threads
        ),
        save=save,
        load=lambda job: None,
        numbers=lambda samples: {"n_samples": len(samples), **samples.size_numbers()},
    )


def _report_stage(mesh: Stage[None]) -> Stage[None]:
    def draw(job: Job, progress: Progress) -> None:
        from geraf2.report import write_report  # noqa: PLC0415 - matplotlib takes 0.5 s

        progress(0.0)
        heatmap = None
        if PRIOR_STAGE in job.run.stages:
            heatmap = heat_map(job.capture, job.prior, job.num_threads)
        job.run.release(*REPORT_FILES)
        write_report(
            job.run.path,
            heatmap=heatmap,
            provenance=job.capture.provenance,
            num_threads=job.num_threads,
        )

    return Stage(
        name="report",
        version=1,
        inputs=(mesh,),
        settings=lambda _: __version__,
        compute=draw,
        save=lambda job, _: [REPORT_NAME],
        load=lambda job: None,
    )


@contextmanager
def logged(run: RunFolder, *, resume: bool) -> Iterator[None]:
    """Log start and stop of a run, and all log records between."""
    with logging_to(run):
        python = sys.version.split()[0]
        run.log("start", level="info", version=__version__, python=python, resume=resume)
        try:
            yield
        except BaseException as error:
            text = " ".join(str(error).split())
            text = "interrupted" if isinstance(error, KeyboardInterrupt) else text
            with suppress(OSError):  # a full disk must not hide the error itself
                run.warn(f"the run stopped: {text}", "error")
            raise
