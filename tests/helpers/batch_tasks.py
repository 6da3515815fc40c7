"""Functions that workers execute in tests of batches."""

import errno
import os
import signal
import time
from pathlib import Path

from geraf2.apps.batch.folder import JobResult
from geraf2.errors import UserError


def square(x):
    return x * x


def kill_self():
    os.kill(os.getpid(), signal.SIGKILL)


def hang_and_clean_up(begun, cleaned):
    Path(begun).touch()
    try:
        time.sleep(600.0)
    finally:
        Path(cleaned).touch()


def job_by_name(job, paths, num_threads=1, report=False):
    """Stand-in for geraf2.apps.batch.work.do_job: the name of a scene is the fate of its job."""
    known, fate = paths.read(), job.scene.name.split("-")[0]
    if known is not None and known.is_final:  # a worker that is lost loses its answers, too
        return known
    calls = Path(paths.out) / "calls.txt"
    with calls.open("a") as handle:
        handle.write(f"{job.scene.name} {os.getpid()}\n")
    if fate == "killer":
        kill_self()
    if fate == "hangs" and calls.read_text().count("hangs") == 1:
        time.sleep(600.0)
    if fate == "bad":
        raise UserError(what="because of bad")
    if fate == "raises":
        msg = "a bug"
        raise ZeroDivisionError(msg)
    if fate == "lost" or (fate == "once" and calls.read_text().count("once") == 1):
        raise OSError(errno.EIO, "Input/output error")
    result = JobResult(key=paths.key, scene=paths.scene, preset="fast", state="done")
    paths.write(result)
    return result
