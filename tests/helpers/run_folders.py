"""Record of a run folder whose files a test wrote itself."""

from geraf2.io.run_folder import RunFolder, StageRecord


def record_run(path, name="scene", *, numbers=None, warnings=()):
    """Record all files of a folder as those of a run; numbers: of its steps, by name."""
    path.mkdir(parents=True, exist_ok=True)
    run = RunFolder(path, "digest", name)
    run.warnings += warnings
    add_steps(run, {"mesh": {}} if numbers is None else numbers)
    return run


def add_steps(run, numbers):
    """Record steps with these numbers, and all files that are there now."""
    for step, found in numbers.items():
        run.stages[step] = StageRecord(seconds=1.0, numbers=found)
    run.record_files()
