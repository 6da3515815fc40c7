"""Record of a run folder whose files a test wrote itself."""

from geraf2.io.run_folder import RunFolder, StageRecord
from geraf2.io.verdict import VERDICT_STAGE, Cause, Trust, Verdict

CAUSE = Cause("sense", "planes fit better in the other sense", "reconstruct with --reverse-turn")
VERDICTS = {
    trust: Verdict(trust=trust, probability_of_failure=p, causes=causes, tests={})
    for trust, p, causes in (
        (Trust.RELIABLE, 0.004, ()),
        (Trust.DOUBTFUL, 0.4, (CAUSE,)),
        (Trust.NOT_TO_BE_TRUSTED, 0.97, (CAUSE,)),
    )
}
"""A verdict of each kind."""


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


def judge(path, trust):
    """Write a verdict into the record of a run."""
    run = RunFolder.read(path)
    run.stages[VERDICT_STAGE] = StageRecord(seconds=0.0, numbers=VERDICTS[trust].numbers())
    run.save()
    return path
