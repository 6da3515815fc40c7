import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from geraf2.errors import UserError
from geraf2.io.run_folder import RunFolder, stage_key


@dataclass(frozen=True)
class Settings:
    size_m: float = 0.1
    count: int | None = None


@pytest.fixture
def run(tmp_path):
    return RunFolder.open(tmp_path / "out", scene_digest="abc", scene_name="scene")


def test_a_stage_is_done_while_its_key_and_files_stay(run):
    (run.path / "a.npz").write_bytes(b"one")
    assert not run.is_done("a", "key")
    run.mark_done("a", "key", ["a.npz"], 1.5)
    again = RunFolder.open(run.path, scene_digest="abc", scene_name="renamed")
    assert again.is_done("a", "key")
    assert again.stages["a"].seconds == 1.5
    assert not again.is_done("a", "other")
    (run.path / "a.npz").write_bytes(b"two")
    assert not again.is_done("a", "key")
    (run.path / "a.npz").unlink()
    assert not again.is_done("a", "key")


def test_the_key_sees_every_input():
    inputs = [
        {"a": 1},
        {"a": 2},
        {"b": 1},
        {"a": Settings()},
        {"a": Settings(size_m=0.2)},
        {"a": Settings(count=1)},
        {"a": np.zeros(3)},
        {"a": np.zeros((3, 1))},
        {"a": np.zeros(3, dtype=np.float32)},
        {"a": np.array([0.0, 0.0, 1e-12])},
        {"a": (1, 2)},
        {"a": None},
    ]
    assert len({stage_key(**each) for each in inputs}) == len(inputs)
    assert stage_key(a=Settings(), b=np.ones(2)) == stage_key(b=np.ones(2), a=Settings())


def test_a_key_of_something_unknown_is_a_programming_error():
    with pytest.raises(TypeError, match="cannot make a key of set"):
        stage_key(a={1})


def test_the_log_is_one_json_object_a_line(run):
    run.log("first", level="info", value=np.float32(0.5), path=Path("a"))
    run.log("second\nline", level="warning")
    first, second = map(json.loads, (run.path / "log.jsonl").read_text().splitlines())
    assert (first["event"], first["value"], first["path"]) == ("first", 0.5, "a")
    assert second["event"] == "second\nline"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("other", r"another scene \('scene'\), got scene 'other'"),
        ("scene", "another scene of that name, or of this one before it changed"),
    ],
)
def test_the_run_of_another_scene_is_named(name, text, tmp_path):
    RunFolder.open(tmp_path / "run", scene_digest="a", scene_name="scene")
    with pytest.raises(UserError, match=text):
        RunFolder.open(tmp_path / "run", scene_digest="b", scene_name=name)
