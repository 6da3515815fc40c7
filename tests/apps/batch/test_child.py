"""Calls in child processes."""

import os
from pathlib import Path

import pytest

from geraf2.apps.batch.child import Child, ChildEndedError, child
from geraf2.errors import UserError
from helpers import batch_tasks


def test_a_process_does_one_call_after_another(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(Path(batch_tasks.__file__).parent.parent))
    monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", "65536")  # as dask has it; too slow
    with child(1) as process:
        first = process.call(batch_tasks.answered, "one")
        assert first == process.call(batch_tasks.answered, "two") | {"text": "one"}
        assert process.tail() == ["a library prints two"]
        assert first["malloc"] == []
    with pytest.raises(ChildEndedError, match="timeout"), child(1) as same:
        same.call(batch_tasks.sleep, 60.0, timeout_s=0.2)
    assert same is process
    assert not Path(f"/proc/{first['pid']}").exists()
    with pytest.raises(ChildEndedError, match="SIGKILL"), child(1) as other:
        other.call(batch_tasks.kill_self)
    assert other is not process


def test_a_call_reports_its_error_and_the_process_continues():
    with child(1) as process:
        with pytest.raises(UserError, match=r"^ValueError: .*'no'"):
            process.call(int, "no")
        assert "ValueError" in process.tail()[-1]
        assert process.call(sum, (1, 2)) == 3
    with pytest.raises(ChildEndedError, match="exit code 3"), child(1) as process:
        process.call(os._exit, 3)


def test_the_processor_time_is_that_of_the_process():
    process = Child(None)
    process.call(int, "1")
    before = process.cpu_seconds
    process.call(sum, range(20_000_000))
    assert 0.1 <= process.cpu_seconds - before < 10.0
    process.close()
