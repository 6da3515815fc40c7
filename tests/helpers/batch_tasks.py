"""Functions that workers execute in tests of batches."""

import os
import signal
import time
from pathlib import Path

from geraf2.apps.batch.child import Child
from geraf2.apps.batch.folder import JobPaths, JobResult, asked_of
from geraf2.apps.batch.jobs import BatchJob
from geraf2.io.toml import from_table


def square(x):
    return x * x


def kill_self(*_):
    os.kill(os.getpid(), signal.SIGKILL)


def sleep(seconds):
    time.sleep(seconds)
    return {"slept": seconds}


def answered(text):
    os.write(1, f"a library prints {text}\n".encode())
    kept = [name for name in os.environ if name.startswith("MALLOC_")]
    return {"pid": os.getpid(), "text": text, "malloc": kept}


def start_and_hang(path):
    """Start a process that hangs, write both processes' numbers, and hang with it."""
    os.environ["PYTHONPATH"] = str(Path(__file__).parent.parent)
    process = Child(1)
    pid = process.call(answered, "")["pid"]
    Path(path).write_text(f"{os.getpid()} {pid}")
    process.call(sleep, 600.0)


def hang_and_clean_up(begun, cleaned):
    Path(begun).touch()
    try:
        time.sleep(600.0)
    finally:
        Path(cleaned).touch()


def hide_package():
    import sys  # noqa: PLC0415 - sent to a worker

    sys.modules.update({"geraf2 kept": sys.modules.get("geraf2"), "geraf2": None})


def show_package():
    import sys  # noqa: PLC0415 - as above

    kept = sys.modules.pop("geraf2 kept")
    if kept is not None:
        sys.modules["geraf2"] = kept


def job_by_name(table, out, key, **how):
    """Stand-in for geraf2.apps.batch.work.do_job: the name of a scene is the fate of its job."""
    scene = Path(table["scene"]).name
    paths, fate = JobPaths(Path(out), key, scene), scene.split("-")[0]
    known = paths.read()
    if known is not None and known.is_final:  # a worker that is lost loses its answers, too
        return {"state": known.state, "error": known.error}
    with (Path(out) / "calls.txt").open("a") as handle:
        handle.write(f"{scene}\n")
    if fate == "busy" and not paths.run.exists():
        paths.run.mkdir(parents=True)
        return {"state": "busy", "error": "another run is writing"}
    paths.begin("here")
    if fate == "killer":
        kill_self()
    state = {"lost": "lost files", "bad": "bad input", "slow": "timeout"}.get(fate, "done")
    if fate == "once" and how["attempt"] == 1:
        state = "lost files"
    if fate == "raises":
        msg = "a bug"
        raise ZeroDivisionError(msg)
    error = "" if state == "done" else f"because of {fate}"
    about = {"preset": "fast", "attempts": how["attempt"], "error": error}
    asked = asked_of(from_table(table, BatchJob, "the job"))
    paths.write(JobResult(key=key, scene=scene, state=state, asked=asked, **about))
    return {"state": state, "error": error}
