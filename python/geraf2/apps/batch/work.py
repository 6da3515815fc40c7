"""Execution of one job, on a worker and in a process of its own."""

import io
import os
import shutil
import socket
import tempfile
import time
import traceback
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from geraf2 import __version__
from geraf2.apps.batch.child import TIMEOUT_NAME, ChildEndedError, child
from geraf2.apps.batch.folder import (
    BAD_INPUT,
    BUSY,
    DONE,
    FAILED,
    KILLED,
    LOST,
    MEMORY,
    TIMEOUT,
    JobPaths,
    JobResult,
    asked_of,
)
from geraf2.apps.batch.jobs import BatchJob
from geraf2.errors import UserError
from geraf2.io.atomic import write_bytes_atomic
from geraf2.io.mesh import TriangleMesh
from geraf2.io.objects import is_file, local_folder
from geraf2.io.regular import RECORD_BYTES, TEXT_BYTES, read_regular
from geraf2.io.run_folder import LOCK_NAME, LOG_NAME, REPORT_NAME, RUN_NAME, RunFolder
from geraf2.io.toml import from_table
from geraf2.pipeline.stages.stage import peak_memory_bytes

# Age at which a lock of another host is stale [s]: its holder touches it every 5 s.
_LOCK_DEAD_S = 30.0
_N_TAIL = 10
_THUMBNAIL_PIXELS = 288


def do_job(
    table: dict[str, Any],
    out: str,
    key: str,
    *,
    attempt: int = 1,
    num_threads: int = 1,
    timeout_s: float | None = None,
    report: bool = False,
    version: str = __version__,
) -> dict[str, str]:
    """Do a job on a worker and write its record, results/KEY.json.

    table: the job as plain values. out: folder of the batch. key: the job's. version: of the
    client's geraf2; another one on the worker is an error.

    Returns the state and an error line.
    """
    job = from_table(table, BatchJob, "the job")
    paths, worker = JobPaths(Path(out), key, job.scene.name), _worker()
    known = paths.read()
    if known is not None and is_answer(known, job, paths, report=report):
        return {"state": known.state, "error": known.error}  # by another client
    about: dict[str, Any] = {
        "key": key,
        "scene": job.scene.name,
        "preset": job.config.preset,
        "worker": worker,
    }
    # Attempts include those whose worker died.
    about |= {"asked": asked_of(job), "attempts": attempt + len(paths.begins())}
    if version != __version__:
        line = f"worker {worker} has geraf2 {__version__}, the batch {version}"
        return _written(paths, {**about, "state": FAILED, "error": line})
    paths.begin(worker)
    start = time.perf_counter()
    with local_folder(paths.run) as run:
        _remove_stale(run)
        answer = _in_child(table, paths, run, num_threads, timeout_s, report=report)
        if answer["state"] == BAD_INPUT and (run / LOCK_NAME).exists():
            paths.forget_begins()
            return {"state": BUSY, "error": answer["error"]}
    seconds = round(time.perf_counter() - start, 3)
    return _written(paths, {**about, "seconds": seconds, **answer})


def is_answer(result: JobResult, job: BatchJob, paths: JobPaths, *, report: bool) -> bool:
    """Whether a record is the final result of a job."""
    if not result.is_final or result.asked != asked_of(job):
        return False
    return result.state != DONE or not report or is_file(paths.run / REPORT_NAME)


def _in_child(
    table: dict[str, Any],
    paths: JobPaths,
    run: Path,
    num_threads: int,
    timeout_s: float | None,
    *,
    report: bool,
) -> dict[str, Any]:
    """Answer of the job's process, or the reason of its end; run: its folder, on the disk."""
    lock, printed = run / LOCK_NAME, list[str]()

    def tick() -> None:
        with suppress(OSError):
            os.utime(lock, follow_symlinks=False)

    arguments = (table, str(run), str(paths.picture), num_threads, report)
    try:
        with child(num_threads) as process:
            try:
                answer = process.call(reconstruct_job, *arguments, timeout_s=timeout_s, tick=tick)
            finally:
                printed = process.tail()
    except ChildEndedError as error:
        state, line = KILLED, f"its process was ended: {error}"
        if str(error) == TIMEOUT_NAME:
            state, line = TIMEOUT, f"took longer than {timeout_s:g} s"
        answer = {"state": state, "error": line}
    if answer["state"] != DONE:
        answer["log_tail"] = [*_last_lines(run / LOG_NAME), *printed]
    return answer


def _written(paths: JobPaths, record: dict[str, Any]) -> dict[str, str]:
    result = from_table(record, JobResult, "the answer")
    paths.write(result)
    return {"state": result.state, "error": result.error}


def _worker() -> str:
    from distributed import get_worker  # noqa: PLC0415 - an extra

    try:
        return str(get_worker().address)
    except ValueError:
        return "no worker"


def _remove_stale(run: Path) -> None:
    """Remove an unfinished folder and the lock of a lost process or host."""
    lock = run / LOCK_NAME
    if run.is_dir() and not (run / RUN_NAME).exists() and not lock.exists():
        shutil.rmtree(run, ignore_errors=True)  # killed before its first record
    try:
        host = read_regular(lock, RECORD_BYTES).decode(errors="replace").split("\n")[1].strip()
        with tempfile.NamedTemporaryFile(dir=run.parent, prefix=".now-") as now:
            age = os.fstat(now.fileno()).st_mtime - lock.stat().st_mtime  # by the same clock
    except (OSError, IndexError):
        return
    # Locking itself checks whether a process of this host is alive.
    if host != socket.gethostname() and age > _LOCK_DEAD_S:
        lock.unlink(missing_ok=True)


def _last_lines(path: Path) -> list[str]:
    try:
        return read_regular(path, TEXT_BYTES).decode(errors="replace").splitlines()[-_N_TAIL:]
    except OSError:
        return []


def reconstruct_job(
    table: dict[str, Any], run: str, picture: str, num_threads: int, report: bool
) -> dict[str, Any]:
    """Do a job in the present process; arguments and result are plain values."""
    _reset_peak()
    cpu_start = time.process_time()
    answer: dict[str, Any]
    try:
        job = from_table(table, BatchJob, "the job")
        scores = _reconstruct(job, Path(run), Path(picture), num_threads, report)
        answer = {"state": DONE, "scores": scores}
    except Exception as error:
        traceback.print_exc()  # for the record's tail
        state, line = state_of(error), " ".join(str(error).split())
        what = f"internal error: {type(error).__name__}: {line}" if state == FAILED else line
        answer = {"state": state, "error": what or type(error).__name__}
    with suppress(UserError):
        record = RunFolder.read(Path(run))
        answer |= {"warnings": record.warnings, "numbers": _mesh_numbers(record)}
    answer["cpu_seconds"] = round(time.process_time() - cpu_start, 3)
    answer["peak_memory_mib"] = round(_peak_bytes() / 2**20, 1)
    return answer


def _mesh_numbers(run: RunFolder) -> dict[str, float]:
    """Return what is known of a mesh without its truth; empty where its preset has no errors."""
    known = run.stages["mesh"].numbers if "mesh" in run.stages else {}
    if "expected_error_median_mm" not in known:
        return {}
    return {
        "typical_error_mm": float(known["expected_error_median_mm"]),
        "not_seen_percent": round(100.0 * known["evidence_shares"].get("not_seen", 0.0), 2),
    }


def _reconstruct(
    job: BatchJob, run: Path, picture: Path, num_threads: int, report: bool
) -> dict[str, float]:
    from geraf2.pipeline.commands.evaluate import evaluate  # noqa: PLC0415 - torch, 2 s, in the child only
    from geraf2.pipeline.commands.reconstruct import reconstruct  # noqa: PLC0415 - as above

    result = reconstruct(
        job.scene,
        job.prior,
        job.config,
        run,
        options=job.options,
        resume=True,
        overwrite=True,
        report=report and job.truth is None,
        num_threads=num_threads,
    )
    if len(result.content_mesh.faces):
        draw_thumbnail(result.content_mesh, picture)
    if job.truth is None:
        return {}
    metrics = evaluate(result, job.truth, report=report, num_threads=num_threads)
    return {name: round(score, 6) for name, score in metrics.headline().items()}


def state_of(error: BaseException) -> str:
    """State of a job that raised an exception."""
    causes = list(_causes(error))
    if any(isinstance(e, MemoryError) or "can't allocate memory" in str(e) for e in causes):
        return MEMORY
    # Parsers may raise OSError, too; system errors have a number.
    if any(isinstance(e, OSError) and e.errno is not None for e in causes):
        return LOST
    if any(type(e).__module__.startswith("obstore") for e in causes):  # read by zarr itself
        return LOST
    return BAD_INPUT if isinstance(error, UserError) else FAILED


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def draw_thumbnail(mesh: TriangleMesh, path: Path) -> None:
    """Draw a small picture of a mesh from one side, lit from the front."""
    from PIL import Image  # noqa: PLC0415 - for jobs alone

    from geraf2.geometry.triangles import unit_normals  # noqa: PLC0415 - as above
    from geraf2.ops.visibility import MeshScene  # noqa: PLC0415 - as above
    from geraf2.report.render import View  # noqa: PLC0415 - as above

    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    x, y, z = (0.5 * (low + high)).tolist()
    half, n = 0.52 * float(np.linalg.norm(high - low)), _THUMBNAIL_PIXELS
    view = View(azimuth_deg=35.0, center_m=(x, y, z), half_width_m=half, n_pixels=n)
    right, up, toward = view.axes
    steps = ((np.arange(n) + 0.5) / n * 2.0 - 1.0) * half
    across, down = np.meshgrid(steps, -steps)
    plane = across.reshape(-1, 1) * right + down.reshape(-1, 1) * up + (x, y, z)
    scene = MeshScene(mesh.vertices, mesh.faces, num_threads=1)
    towards_mesh = np.tile(-toward, (n * n, 1))
    _, face = scene.closest_hit(plane + 2.0 * half * toward, towards_mesh)
    light = np.abs(unit_normals(mesh.corners)[face] @ toward)
    grey = np.where(face >= 0, 60.0 + 170.0 * light, 255.0).reshape(n, n)
    content = io.BytesIO()
    Image.fromarray(grey.astype(np.uint8)).save(content, format="PNG")
    write_bytes_atomic(path, content.getvalue())


def _reset_peak() -> None:
    """Reset the peak of the resident set, so that it is that of one job."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def _peak_bytes() -> float:
    with suppress(OSError):
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return 1024.0 * float(line.split()[1])
    return float(peak_memory_bytes())
