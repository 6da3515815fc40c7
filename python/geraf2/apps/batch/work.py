"""Reconstruction of one scene by a worker."""

import logging
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from geraf2.apps.batch.folder import DONE, JobPaths, JobResult
from geraf2.apps.batch.jobs import BatchJob
from geraf2.io.locks import BusyFolderError
from geraf2.io.objects import is_file, local_folder
from geraf2.io.run_folder import REPORT_NAME, RunFolder
from geraf2.pipeline.events import LOGGER
from geraf2.pipeline.presets import is_trained
from geraf2.pipeline.stages.job import peak_memory_bytes

_WAIT_S = 1.0
# The record has the warnings of a run: the worker does not print them.
_QUIET = logging.NullHandler()


def do_job(
    job: BatchJob,
    paths: JobPaths,
    num_threads: int = 1,
    report: bool = False,
    numbers: Mapping[str, float] | None = None,
) -> JobResult:
    """Reconstruct a scene and write its record, unless that is there.

    report: also write the run's report. numbers: are added to those of the mesh.
    """
    while True:
        known = paths.read()
        if known is not None and is_answer(known, paths, report=report):
            return known  # by another client
        try:
            with local_folder(paths.run) as run:
                result = _make_result(job, paths, run, num_threads, report)
        except BusyFolderError:  # another client does it
            time.sleep(_WAIT_S)
            continue
        result = replace(result, numbers={**(numbers or {}), **result.numbers})
        paths.write(result)
        return result


def is_answer(result: JobResult, paths: JobPaths, *, report: bool) -> bool:
    """Whether a record is the final result of a job."""
    if not result.is_final:
        return False
    return result.state != DONE or not report or is_file(paths.run / REPORT_NAME)


def _make_result(
    job: BatchJob, paths: JobPaths, run: Path, num_threads: int, report: bool
) -> JobResult:
    with suppress(OSError):  # the peak of the resident set is that of this job
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    wall, cpu = time.perf_counter(), time.process_time()
    scores = _reconstruct(job, run, num_threads, report)
    record = RunFolder.read(run)
    judged = record.verdict
    cause = judged.causes[0] if judged is not None and judged.causes else None
    return JobResult(
        key=paths.key,
        scene=paths.scene,
        preset=job.config.preset,
        state=DONE,
        worker=_worker(),
        seconds=round(time.perf_counter() - wall, 3),
        cpu_seconds=round(time.process_time() - cpu, 3),
        peak_memory_mib=round(_peak_bytes() / 2**20, 1),
        scores=scores,
        numbers=_mesh_numbers(record),
        verdict="" if judged is None else str(judged.trust),
        probability_of_failure=None if judged is None else judged.probability_of_failure,
        because="" if cause is None else cause.text,
        do="" if cause is None else cause.action,
        warnings=tuple(record.warnings),
    )


def _worker() -> str:
    from distributed import get_worker  # noqa: PLC0415 - an extra

    try:
        return str(get_worker().address)
    except ValueError:
        return "no worker"


def _mesh_numbers(run: RunFolder) -> dict[str, float]:
    """Return what is known of a mesh without its truth; empty where its preset has no errors."""
    known = run.numbers.get("mesh", {})
    if "evidence_shares" not in known:
        return {}
    found = {"not_seen_percent": round(100.0 * known["evidence_shares"].get("not_seen", 0.0), 2)}
    if "expected_error_median_mm" in known:
        found["typical_error_mm"] = float(known["expected_error_median_mm"])
    return found


def _reconstruct(job: BatchJob, run: Path, num_threads: int, report: bool) -> dict[str, float]:
    from geraf2.pipeline.commands.evaluate import evaluate  # noqa: PLC0415 - torch, 2 s, on workers only
    from geraf2.pipeline.commands.reconstruct import reconstruct  # noqa: PLC0415 - as above

    LOGGER.addHandler(_QUIET)
    result = reconstruct(
        job.scene,
        job.prior,
        job.config,
        run,
        options=job.options,
        resume=is_trained(job.config),
        overwrite=True,
        report=report and job.truth is None,
        num_threads=num_threads,
    )
    if job.truth is None:
        return {}
    metrics = evaluate(result, job.truth, report=report, num_threads=num_threads)
    return {name: round(score, 6) for name, score in metrics.headline().items()}


def _peak_bytes() -> float:
    with suppress(OSError):
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return 1024.0 * float(line.split()[1])
    return float(peak_memory_bytes())
