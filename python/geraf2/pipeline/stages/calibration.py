"""Calibration as the first stage of a run; other jobs on the run apply its corrections."""

from dataclasses import dataclass, replace
from typing import Any

from geraf2._types import Progress
from geraf2.calibration.corrections import Corrections
from geraf2.calibration.driver import CALIBRATION_VERSION, CalibrationConfig, calibrate
from geraf2.io.digests import file_digest
from geraf2.io.run_folder import CALIBRATION_NAME, RunFolder
from geraf2.pipeline.stages.stage import Job, Stage, peak_settings
from geraf2.scene import Capture, LosPrior
from geraf2.surfaces.fit import UNKNOWN_OFFSET_M

CALIBRATION_STAGE = "calibration"


def common_sigma_m(run: RunFolder) -> float:
    """Read the standard deviation of the range offset that all echoes of a run share [m]."""
    record = run.stages.get(CALIBRATION_STAGE)
    stated = None if record is None else record.numbers.get("common_offset_sigma_mm")
    return UNKNOWN_OFFSET_M if stated is None else 1e-3 * float(stated)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Found:
    corrections: Corrections
    numbers: dict[str, Any]


def _find(job: Job, progress: Progress, config: CalibrationConfig | None = None) -> _Found:
    found = calibrate(
        job.capture,
        job.prior,
        config,
        peaks=job.peaks,
        num_threads=job.num_threads,
        progress=progress,
    )
    numbers: dict[str, Any] = {"applied": [], "left": []}
    numbers["common_offset_sigma_mm"] = 1e3 * found.common_offset_sigma_m
    for judgement in found.judgements:
        numbers["applied" if judgement.applied else "left"].append(str(judgement))
        numbers |= {f"{judgement.name}_{key}": value for key, value in judgement.numbers.items()}
    return _Found(corrections=found.corrections, numbers=numbers)


def _save(job: Job, found: _Found) -> list[str]:
    found.corrections.save(job.run.path / CALIBRATION_NAME)
    return [CALIBRATION_NAME]


CALIBRATION = Stage(
    name=CALIBRATION_STAGE,
    version=CALIBRATION_VERSION,
    settings=peak_settings,
    compute=_find,
    save=_save,
    load=lambda job: _Found(
        corrections=Corrections.load(job.run.path / CALIBRATION_NAME),
        numbers=job.run.stages[CALIBRATION_STAGE].numbers,
    ),
    numbers=lambda found: found.numbers,
)
COARSE_CALIBRATION = replace(
    CALIBRATION,
    settings=lambda config: [peak_settings(config), "without positions"],
    compute=lambda job, progress: _find(job, progress, CalibrationConfig(positions=False)),
)
"""Without the slow errors of positions, which take most of the time, for a scan that grows; and for
a parcel of a belt, whose motion is known from whole arrays."""


def calibrated(
    job: Job, stage: Stage[_Found] = CALIBRATION
) -> tuple[Capture, LosPrior, dict[str, str]]:
    """Corrected capture and prior, and further inputs of the stages.

    Without corrections these are the job's own capture and prior, and {}. Applied corrections are
    reported to the listener.
    """
    if not job.resume:
        job.run.forget([CALIBRATION_STAGE])
    job.do(stage)
    found = job[stage]
    if found.corrections.are_none:
        return job.capture, job.prior, {}
    for text in found.numbers["applied"]:
        job.listener.note(f"calibrated {text}")
    digest = str(file_digest(job.run.path / CALIBRATION_NAME))
    capture, prior = (
        found.corrections.applied(job.capture),
        found.corrections.moved_prior(job.prior),
    )
    return capture, prior, {"calibration": digest}


def corrected(run: RunFolder, capture: Capture) -> Capture:
    """Capture with the corrections of a run."""
    path = run.written(CALIBRATION_NAME)
    return capture if path is None else Corrections.load(path).applied(capture)
