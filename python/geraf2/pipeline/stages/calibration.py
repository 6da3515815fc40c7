"""Calibration as the first step of a run; other jobs on the run apply its corrections."""

from dataclasses import replace

from geraf2.calibration.corrections import Corrections
from geraf2.calibration.driver import CalibrationConfig, calibrate
from geraf2.calibration.wall_alignment import AlignmentConfig
from geraf2.io.digests import file_digest
from geraf2.io.run_folder import CALIBRATION_NAME, RunFolder
from geraf2.pipeline.stages.job import Job
from geraf2.scene import Capture
from geraf2.surfaces.fit import UNKNOWN_OFFSET_M

CALIBRATION_STAGE = "calibration"


def common_sigma_m(run: RunFolder) -> float:
    """Read the standard deviation of the range offset that all echoes of a run share [m]."""
    record = run.stages.get(CALIBRATION_STAGE)
    stated = None if record is None else record.numbers.get("common_offset_sigma_mm")
    return UNKNOWN_OFFSET_M if stated is None else 1e-3 * float(stated)


def calibrate_job(
    job: Job, *, with_positions: bool = True, before: Corrections | None = None
) -> tuple[Job, Corrections]:
    """Job on the corrected capture and prior, and the corrections, which are written.

    with_positions: also estimate the slow errors of positions, which take most of the time; not for
        a scan that grows, nor for a parcel of a belt, whose motion is known from whole arrays.
    before: corrections that the job's capture has already.

    Applied corrections are reported to the listener.
    """
    before = before or Corrections()
    config = CalibrationConfig(
        positions=with_positions,
        delay=job.has_walls,
        frame=job.has_walls,
        alignment=AlignmentConfig.after(before.delay_m),
    )
    with job.step(CALIBRATION_STAGE) as step:
        found = calibrate(
            job.capture,
            job.prior,
            config,
            peaks=job.peaks,
            num_threads=job.num_threads,
            progress=step.progress,
        )
        step.numbers |= {"applied": [], "left": []}
        if before.reversed_turn:
            step.numbers["reversed_turn"] = 1
        step.numbers["common_offset_sigma_mm"] = 1e3 * found.common_offset_sigma_m
        for judgement in found.judgements:
            step.numbers["applied" if judgement.applied else "left"].append(str(judgement))
            for key, value in judgement.numbers.items():
                step.numbers[f"{judgement.name}_{key}"] = value
        path = job.run.path / CALIBRATION_NAME
        stored = replace(
            found.corrections,
            reversed_turn=before.reversed_turn,
            delay_m=before.delay_m + found.corrections.delay_m,
        )
        stored.save(path)
    if found.corrections.are_none:
        return job, stored
    for text in step.numbers["applied"]:
        job.listener.note(f"calibrated {text}")
    corrected = replace(
        job,
        capture=found.corrections.applied(job.capture),
        prior=found.corrections.moved_prior(job.prior),
        inputs={**job.inputs, "calibration": file_digest(path)},
    )
    return corrected, stored


def correct_capture(run: RunFolder, capture: Capture) -> Capture:
    """Capture with the corrections of a run."""
    path = run.find_file(CALIBRATION_NAME)
    return capture if path is None else Corrections.load(path).applied(capture)
