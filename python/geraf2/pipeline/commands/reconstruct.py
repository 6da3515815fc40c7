"""From a capture and the outside of its box to a run folder with the surface of the content."""

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from weakref import finalize

import numpy as np

from geraf2 import __version__
from geraf2.calibration.corrections import Corrections, with_turn_reversed
from geraf2.calibration.free_air import content_region
from geraf2.echoes.prior_check import require_echoes_inside
from geraf2.errors import UserError, attempt
from geraf2.imaging.peaks import KeptPeaks
from geraf2.io.belt_file import MOTION_KEY
from geraf2.io.outputs import require_consent
from geraf2.io.planes import ScannedPlanes, save_planes
from geraf2.io.run_folder import (
    CALIBRATION_NAME,
    CHECKPOINT_NAME,
    CONFIG_NAME,
    PLANES_NAME,
    PRIOR_NAME,
    SAMPLES_NAME,
    RunFolder,
    StageRecord,
    place_of,
    stage_key,
)
from geraf2.io.toml import to_table
from geraf2.ops._threads import limit_blas_threads
from geraf2.pipeline.box_check import (
    BOX_STAGE,
    BY_RADAR,
    BoxCheck,
    box_from_radar,
    check_prior,
    require_determined,
    stated_box,
)
from geraf2.pipeline.estimates import require_reconstructable
from geraf2.pipeline.events import Listener
from geraf2.pipeline.plane_check import check_planes, is_turn_reversed
from geraf2.pipeline.planes import keep_planes, planes_at
from geraf2.pipeline.presets import PresetConfig, is_trained, preset_type, run_preset, versions_of
from geraf2.pipeline.prior import PriorSource, add_walls, save_prior
from geraf2.pipeline.prior_stage import PRIOR_STAGE, PriorJob, find_prior_job, heat_map, make_prior
from geraf2.pipeline.reconstruction import Reconstruction
from geraf2.pipeline.run_log import RunListener, record_logs
from geraf2.pipeline.run_record import RunOptions, RunRecord
from geraf2.pipeline.sign_check import explain_sign_errors, require_sign
from geraf2.pipeline.stages.calibration import calibrate_job
from geraf2.pipeline.stages.job import Job, for_planes, kept_peaks, peak_memory_bytes
from geraf2.pipeline.surface_samples import require_samples
from geraf2.pipeline.verdict import judge, with_cause
from geraf2.scene import Capture, LosPrior, load_capture
from geraf2.scene.aperture import Aperture
from geraf2.scene.checks import Finding, require_plausible
from geraf2.scene.los_checks import require_prior_in_view
from geraf2.scene.store import capture_digest
from geraf2.scene.summary import CaptureSummary, summarize_capture


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

    Parameters
    ----------
    capture
        Scene folder, or a capture in memory.
    prior
        Outside of the box: a prior, three outer side lengths about the origin [m], a closed mesh in
        metres in the capture's frame, a folder that `geraf2 los` made, or photos with poses. The
        capture's own outer walls when None, and without them the box is found by radar
        (`geraf2.find_box`). A cuboid that is off by millimetres or degrees is corrected, and a
        prior without walls takes those of the capture.
    preset
        Name of a preset, or its constants: best, fast, paper, or a method to compare with.
    out
        Result folder, which is written whole or not at all. When None it is a temporary one, which
        is removed together with the result.
    options
        Planes left out, calibration, seed, samples of the surface, interpretation of photos.
    resume
        Continue the training that a stopped run of this preset left in `out`.
    overwrite
        Replace a finished result in `out` that has other settings or is of another scene.
    report
        Also draw pictures and write `report.html`.
    num_threads
        Threads of the kernels; all when None.
    listener
        Receives progress and warnings.

    Returns
    -------
    Reconstruction
        Meshes [m], signed distance [m], glints and numbers, read from the folder on first use.

    Raises
    ------
    UserError
        If capture and prior contradict each other, no box is found, echoes come from outside the
        box, `out` holds something else or is being written into, or `resume` is asked of a preset
        that trains nothing.

    Examples
    --------
    >>> from geraf2.surfaces import FitConfig
    >>> coarse = geraf2.FastPreset(fit=FitConfig(spacing_m=0.01))
    >>> capture, truth = geraf2.examples.small_capture()
    >>> prior = geraf2.LosPrior.from_box(geraf2.examples.BOX_M)
    >>> result = geraf2.reconstruct(capture, prior, coarse, "out")
    >>> bool(result.content.extents.max() < 0.1)  # [m]
    True
    """
    options = options or RunOptions()
    config = preset_type(preset)() if isinstance(preset, str) else preset
    if options.samples:
        require_samples(config, options.samples)
    if resume and not is_trained(config):
        raise UserError(
            what="--resume continues a training, and this preset trains nothing",
            expected="the preset paper, paper-corrected or geraf1",
            got=config.preset,
            hint="leave it out: the run starts again and takes seconds",
        )
    scene = None if isinstance(capture, Capture) else Path(capture)
    loaded = capture if isinstance(capture, Capture) else load_capture(capture)
    record = RunRecord(
        scene=scene, prior=PriorSource.from_argument(prior), options=options, config=config
    )
    given = prior if isinstance(prior, LosPrior) else None
    folder = temporary_folder() if out is None else Path(out)
    run = RunFolder.open(
        folder,
        scene_digest=capture_digest(loaded),
        scene_name=scene.resolve().name if scene else "capture",
        overwrite=overwrite,
    )
    if out is None:
        finalize(run, rmtree, folder, ignore_errors=True)
    run.require_same("mesh", _settings_key(record), "mesh", overwrite=overwrite)
    if (folder / CHECKPOINT_NAME).is_file() and not resume:
        require_consent(folder, "a training that --resume would finish", overwrite=overwrite)
    request = Request.check(loaded, given, record, listener or Listener(), num_threads)
    run.require_same("box", request.outside, "mesh", overwrite=overwrite)
    with run.replace_whole() as new:
        run_request(request, new, resume=resume, report=report)
    return Reconstruction(run)


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
    outside: str
    """Hash of the outside of the box, or of what it is made of."""
    listener: Listener
    num_threads: int | None
    started: float
    """Time of its begin, of `time.perf_counter` [s]."""
    peaks: KeptPeaks | None = None
    """Peaks around the prior, where planes were imaged."""
    corrections: Corrections = field(default_factory=Corrections)
    """Corrections that the capture already has."""

    @classmethod
    def check(
        cls,
        capture: Capture,
        given: LosPrior | None,
        record: RunRecord,
        listener: Listener,
        num_threads: int | None,
        summary: CaptureSummary | None = None,
    ) -> "Request":
        """Check capture, prior and angles; UserError where one of them cannot be used.

        A turntable that surely ran in the other sense is corrected, unless the options say no.

        given: prior in memory; else the record names its source, or none.
        summary: of the capture, if already computed.
        """
        others, options = (given, record, listener, num_threads), record.options
        if options.reverse_turn:
            return cls._check(with_turn_reversed(capture), *others).reversed()
        found, failure = attempt(lambda: cls._check(capture, *others, summary))
        if options.calibrate == "auto":
            prior = found.prior[0] if found is not None and found.prior else None
            if failure is not None:
                prior, _ = attempt(lambda: content_region(capture, num_threads=num_threads))
            config = for_planes(record.config, capture)
            peaks = None if prior is None else kept_peaks(prior, config, num_threads)
            seen = capture if found is None else found.capture
            if peaks is not None and is_turn_reversed(seen, peaks.of(seen)):
                return cls._check(with_turn_reversed(capture), *others).reversed()
            if failure is not None and peaks is not None:
                failure = with_cause(failure, check_planes(seen, peaks.of(seen)))
            found = None if found is None else replace(found, peaks=peaks)
        if found is None:
            raise failure or AssertionError
        return found

    @classmethod
    def _check(
        cls,
        capture: Capture,
        given: LosPrior | None,
        record: RunRecord,
        listener: Listener,
        num_threads: int | None,
        summary: CaptureSummary | None = None,
    ) -> "Request":
        begin = time.perf_counter()
        where, options, source = record.scene or "capture", record.options, record.prior
        summary = summary or summarize_capture(capture)
        findings = require_plausible(summary, where)
        listener.findings(findings)
        making = find_prior_job(source.los, options.photos, summary, listener)
        found, box = None, None
        start, cpu_start = time.perf_counter(), time.process_time()
        others, keep_delay = (summary, listener, num_threads), options.calibrate == "no"
        with explain_sign_errors(capture, where, num_threads):
            if making is None and (given is not None or source.is_given):
                last = options.trust_los
                found = _prior(given or source, capture, summary, listener, is_last=last)
            elif making is None:
                found = stated_box(capture)
            if found and not options.trust_los:
                box = check_prior(capture, found[0], found[1], *others, keep_delay=keep_delay)
            elif making is None and not found:
                box = box_from_radar(capture, *others, keep_delay=keep_delay)
        if box is not None:
            if box.found is None:  # no wall is seen where it is
                require_sign(capture, where, num_threads)
            found = box.prior, box.name
        box_seconds = time.perf_counter() - start, time.process_time() - cpu_start
        if found:
            require_reconstructable(summary, record.config, found[0].size_m, where)
        keep_planes(capture, options.hold_out, where)
        corrections = Corrections(delay_m=box.delay_m if box else 0.0)
        return cls(
            capture=corrections.applied(capture if box is None else box.place(capture)),
            summary=summary,
            findings=findings,
            prior=found,
            box=box,
            box_seconds=box_seconds,
            making=making,
            record=record,
            outside=_prior_key(found[0]) if found else making.key if making else "",
            listener=listener,
            num_threads=num_threads,
            started=begin,
            corrections=corrections,
        )

    def reversed(self) -> "Request":
        """Return the same for a capture whose turntable was turned in the other sense."""
        return replace(self, corrections=replace(self.corrections, reversed_turn=1))

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
    """Do all steps of a request in a new run folder.

    peaks: of the capture's planes, where they are known; collected when None.
    """
    options = request.record.options
    with log_run(run, resume=resume):
        peaks = request.peaks if peaks is None else peaks
        job, prior_name = start_job(request, run, peaks=peaks, resume=resume)
        if options.calibrate == "auto":
            has_motion = MOTION_KEY in request.capture.provenance
            job, _ = calibrate_job(job, with_positions=not has_motion, before=request.corrections)
        elif not request.corrections.are_none:
            request.corrections.save(run.path / CALIBRATION_NAME)
        job = replace(job, capture=keep_planes(job.capture, options.hold_out, request.where))
        left_out = planes_at(request.capture, options.hold_out, request.where)
        keep_inputs(job, [p for n, p in enumerate(request.summary.planes) if n not in left_out])
        with explain_sign_errors(request.capture, request.where, request.num_threads):
            make_surface(job, prior_name, options, report=report)
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
    """Job in a new run folder, with its prior; and the prior's name.

    peaks: of planes that were imaged before; kept if the prior moved by at most `tolerance_m` [m].
    """
    heard, record = RunListener(run, request.listener), request.record
    for finding in request.findings:
        run.warn(str(finding), finding.severity)
    run.asked = {"mesh": _settings_key(record), "box": request.outside}
    record.write(run.path / CONFIG_NAME, seen_from=run.place)
    if request.prior is None:
        assert request.making is not None  # or there would be a prior
        source = PriorSource(los=make_prior(run, request.making, heard))
        prior, name = _prior(source, request.capture, request.summary, heard)
    else:
        prior, name = request.prior
    key = _prior_key(prior)
    if request.box is not None:
        box = request.box
        seconds, cpu = (round(value, 3) for value in request.box_seconds)
        record_of = StageRecord(seconds=seconds, cpu_seconds=cpu, numbers=box.numbers())
        run.stages[BOX_STAGE] = record_of
        (heard if box.is_warning else request.listener).note(box.text)
    config = for_planes(record.config, request.capture)
    job = Job(
        run=run,
        capture=request.capture,
        prior=prior,
        config=config,
        seed=record.options.seed,
        inputs={"scene": run.scene_digest, "prior": key, "hold_out": record.options.hold_out},
        listener=heard,
        peaks=peaks.about(prior, tolerance_m)
        if peaks is not None
        else kept_peaks(prior, config, request.num_threads),
        num_threads=request.num_threads,
        resume=resume,
        has_walls=request.box is None or request.box.found is not None or name != BY_RADAR,
        made_from={
            "scene": run.scene_digest,
            "prior": key,
            "command": record.command(run.scene_name),
        },
    )
    return job, name


def keep_inputs(job: Job, planes: Sequence[Aperture]) -> None:
    """Write the prior and the planes that the run reads."""
    run = job.run
    save_prior(job.prior, run.path / PRIOR_NAME)
    scanned = ScannedPlanes(
        corners_m=np.array([plane.corners_m for plane in planes]).reshape(-1, 4, 3),
        wavelength_m=job.capture.waveform.center_wavelength_m,
    )
    save_planes(scanned, run.path / PLANES_NAME)


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
        prior = add_walls(prior, capture.walls, listener if is_last else None)
    require_prior_in_view(prior, summary, name)
    return prior, name


def _settings_key(record: RunRecord) -> str:
    """Hash of all that the meshes depend on besides the scene and the outside of its box."""
    options, config = record.options, to_table(record.config)
    if is_trained(record.config):
        config["paper"].pop("device", None)
    return stage_key(
        hold_out=options.hold_out,
        reverse_turn=options.reverse_turn,
        calibrate=options.calibrate,
        seed=options.seed if is_trained(record.config) else 0,
        versions=versions_of(record.config),
        config=config,
    )


def _prior_key(prior: LosPrior) -> str:
    certain = {} if prior.certain is None else {"certain": prior.certain}
    return stage_key(vertices=prior.vertices, faces=prior.faces, walls=prior.walls, **certain)


def make_surface(
    job: Job, prior_name: object, options: RunOptions, *, report: bool = False
) -> None:
    """Do the steps of a job's preset, and those that the options ask for."""
    run, threads = job.run, job.num_threads
    if not options.trust_los:
        with job.listener.step("prior"):
            peaks = job.peaks.of(job.capture)
            try:
                require_echoes_inside(
                    job.capture, job.prior, peaks, prior_name, num_threads=threads
                )
            except UserError as error:
                if prior_name != BY_RADAR:  # that is the best there is
                    raise
                job.listener.warning(str(error))
    run_preset(job)
    judge(job, is_turn_stated=options.reverse_turn)
    if prior_name == BY_RADAR:
        require_determined(run)
    run.take_over()
    run.record_files()
    if options.samples:
        with job.step("samples") as step:
            samples = Reconstruction(run).samples(options.samples, seed=job.seed)
            samples.save(run.path / SAMPLES_NAME)
            step.numbers |= {"n_samples": len(samples), **samples.size_numbers()}
    if report:
        from geraf2.report import write_report  # noqa: PLC0415 - matplotlib takes 0.5 s

        with job.step("report"):
            is_made = PRIOR_STAGE in run.stages
            write_report(
                run.path,
                name=place_of(run.place),
                heatmap=heat_map(job.capture, job.prior, threads) if is_made else None,
                provenance=job.capture.provenance,
                num_threads=threads,
            )


@contextmanager
def log_run(run: RunFolder, *, resume: bool) -> Iterator[None]:
    """Log start and stop of a run, and all log records between."""
    with record_logs(run):
        python = sys.version.split()[0]
        run.log("start", level="info", version=__version__, python=python, resume=resume)
        try:
            yield
        except BaseException as error:
            text = " ".join(str(error).split())
            text = "interrupted" if isinstance(error, KeyboardInterrupt) else text
            with suppress(OSError):  # a full disk must not hide the error itself
                run.log(f"the run stopped: {text}", level="error")
            raise
