"""Run folder and records of a batch under any order of writing, kills, resumes and deletions."""

import shutil
import tempfile
from contextlib import ExitStack
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from geraf2.apps.batch.engine import FAILED
from geraf2.apps.batch.folder import DONE, JobPaths, JobResult
from geraf2.errors import UserError
from geraf2.io.atomic import write_bytes_atomic
from geraf2.io.run_folder import LOCK_NAME, RunFolder
from geraf2.pipeline.commands.verify import verify

NO_PROCESS = 2**22 + 1
"""Above the largest number that Linux gives to a process."""
STAGES, KEYS = st.sampled_from("abc"), st.sampled_from(["one", "two"])
CONTENTS = st.binary(max_size=3)


class Folders(RuleBasedStateMachine):
    """A run folder and a job's records beside a model of what was written into them."""

    def __init__(self):
        super().__init__()
        self.position = Path(tempfile.mkdtemp())
        self.path, self.held = self.position / "run", ExitStack()
        self.run = None
        self.records = {}  # stage: key and content when it was done
        self.files = {}  # stage: content on the disk
        self.job = JobPaths(self.position / "batch", "k" * 16, "scene")
        self.result = None

    def teardown(self):
        self.held.close()
        shutil.rmtree(self.position)

    def _file(self, stage):
        return self.path / f"{stage}.npz"

    @initialize()
    def first(self):
        self.resume()

    @precondition(lambda self: self.run is None)
    @rule()
    def resume(self):
        self.run = RunFolder.open(self.path, scene_digest="d", scene_name="scene")
        self.held.enter_context(self.run.locked())
        assert not list(self.path.rglob(".*.tmp*"))  # what a killed process left is swept

    @precondition(lambda self: self.run is not None)
    @rule(stage=STAGES, key=KEYS, content=CONTENTS)
    def do(self, stage, key, content):
        write_bytes_atomic(self._file(stage), content)
        self.run.mark_done(stage, key, [f"{stage}.npz"], 1.0)
        self.records[stage], self.files[stage] = (key, content), content

    @precondition(lambda self: self.run is not None)
    @rule(stage=STAGES)
    def forget(self, stage):
        self.run.forget([stage])
        self.records.pop(stage, None)

    @precondition(lambda self: self.run is not None)
    @rule()
    def leave(self):
        self.held.close()
        self.run = None

    @precondition(lambda self: self.run is not None)
    @rule(stage=STAGES, content=CONTENTS, renamed=st.booleans())
    def kill(self, stage, content, renamed):
        """Kill the process while it writes a stage: before its rename, or before its record."""
        if renamed:
            write_bytes_atomic(self._file(stage), content)
            self.files[stage] = content
        else:
            (self.path / f".{stage}-abcd1234.tmp.npz").write_bytes(content)
        lock = (self.path / LOCK_NAME).read_text()
        self.held.close()
        pid, rest = lock.split("\n", 1)
        assert pid.isdigit()
        (self.path / LOCK_NAME).write_text(f"{NO_PROCESS}\n{rest}")
        self.run = None

    @rule(stage=STAGES)
    def delete(self, stage):
        self._file(stage).unlink(missing_ok=True)
        self.files.pop(stage, None)

    @rule(state=st.sampled_from([DONE, FAILED]))
    def finish_job(self, state):
        self.result = JobResult(key=self.job.key, scene="scene", preset="fast", state=state)
        self.job.write(self.result)

    @rule(cut=st.booleans())
    def lose_result(self, cut):
        if cut and self.job.result.exists():
            self.job.result.write_bytes(self.job.result.read_bytes()[:-3])
        else:
            self.job.result.unlink(missing_ok=True)
        self.result = None

    @invariant()
    def stages_are_done_where_their_files_are_what_was_written(self):
        if not self.path.exists():
            return
        stored = RunFolder.read(self.path)
        for stage in "abc":
            key, content = self.records.get(stage, (None, None))
            is_whole = key is not None and self.files.get(stage) == content
            assert [stored.is_done(stage, k) for k in ("one", "two")] == [
                is_whole and key == k for k in ("one", "two")
            ]

    @invariant()
    def verify_names_what_is_lost(self):
        if not self.path.exists():
            return
        lost = [s for s, (_, content) in self.records.items() if self.files.get(s) != content]
        if lost:
            with pytest.raises(UserError) as error:
                verify(self.path)
            assert any(f"{stage}.npz" in str(error.value) for stage in lost)
        else:
            assert verify(self.path).n_files == len(self.records)

    @invariant()
    def a_job_is_in_the_state_of_its_last_whole_record(self):
        assert self.job.read() == self.result


Folders.TestCase.settings = settings(
    max_examples=40,
    stateful_step_count=15,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)
TestFolders = pytest.mark.slow(Folders.TestCase)
