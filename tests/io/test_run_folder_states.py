"""Run folder and records of a batch under any order of results, kills, losses and deletions."""

import shutil
import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from geraf2.apps.batch.engine import FAILED
from geraf2.apps.batch.folder import DONE, JobPaths, JobResult
from geraf2.errors import UserError
from geraf2.io.run_folder import RUN_NAME, RunFolder, StageRecord
from geraf2.pipeline.commands.verify import verify

CONTENTS = st.binary(max_size=3)


class Folders(RuleBasedStateMachine):
    """A run folder and a job's records beside a model of what was written into them."""

    def __init__(self):
        super().__init__()
        self.position = Path(tempfile.mkdtemp())
        self.path = self.position / "run"
        self.recorded = {}  # content of each file when it was recorded
        self.files = {}  # content on the disk
        self.job = JobPaths(self.position / "batch", "k" * 16, "scene")
        self.result = None

    def teardown(self):
        shutil.rmtree(self.position)

    def _open(self):
        return RunFolder.open(self.path, scene_digest="d", scene_name="scene")

    @rule(content=CONTENTS, grows=st.booleans(), fails=st.booleans())
    def replace(self, content, grows, fails):
        try:
            with self._open().replace_whole(grows=grows) as new:
                (new.path / "mesh.ply").write_bytes(content)
                new.stages["mesh"] = StageRecord(seconds=1.0)
                new.take_over()
                if fails:
                    raise KeyboardInterrupt
        except KeyboardInterrupt:
            return
        self.recorded = self.files = {"mesh.ply": content}

    @rule(content=CONTENTS)
    def kill(self, content):
        """Kill the process that writes a result."""
        left = self.position / ".run-abcd1234.tmp"
        left.mkdir(exist_ok=True)
        (left / "mesh.ply").write_bytes(content)

    @precondition(lambda self: self.recorded)
    @rule(content=CONTENTS, fails=st.booleans())
    def add(self, content, fails):
        run = self._open()
        self.recorded = {k: v for k, v in self.recorded.items() if k != "notes.json"}
        try:
            with run.rewrite("notes.json"):
                (self.path / "notes.json").write_bytes(content)
                self.files = {**self.files, "notes.json": content}
                if fails:
                    raise KeyboardInterrupt
        except KeyboardInterrupt:
            return
        self.recorded = {**self.recorded, "notes.json": content}

    @precondition(lambda self: self.files)
    @rule(data=st.data(), content=st.none() | CONTENTS)
    def lose(self, data, content):
        name = data.draw(st.sampled_from(sorted(self.files)))
        if content is None:
            (self.path / name).unlink()
        else:
            (self.path / name).write_bytes(content)
        self.files = {k: v for k, v in self.files.items() if k != name}
        self.files |= {} if content is None else {name: content}

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
    def verify_names_what_is_lost(self):
        if not self.recorded:
            assert not (self.path / RUN_NAME).exists()
            return
        lost = [k for k, content in self.recorded.items() if self.files.get(k) != content]
        if lost:
            with pytest.raises(UserError) as error:
                verify(self.path)
            assert any(name in str(error.value) for name in lost)
        else:
            assert verify(self.path).n_files == len(self.recorded)

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
