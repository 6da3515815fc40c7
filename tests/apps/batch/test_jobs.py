"""Jobs of a batch: folders, patterns, tables; errors before any work."""

import shutil
import socket
from dataclasses import replace

import pytest

import geraf2
from geraf2.apps.batch import BatchFolder, cluster, read_jobs, work
from geraf2.apps.batch.engine import error_state
from geraf2.apps.batch.folder import JobPaths
from geraf2.cli.main import main
from geraf2.io.locks import BusyFolderError
from geraf2.pipeline.presets import FastPreset
from geraf2.surfaces import FitConfig
from helpers.console import the_error

BOX = (0.2, 0.3, 0.4)
FLAGS = ["--box", "0.2", "0.3", "0.4"]


@pytest.fixture
def scans(tmp_path):
    """Three stand-ins of scenes; the first has all files of one."""
    for name in ("one", "two", "three"):
        (tmp_path / "scans" / name).mkdir(parents=True)
        (tmp_path / "scans" / name / "scene.toml").write_text("")
    (tmp_path / "scans" / "one" / "los.ply").write_text("mesh")
    (tmp_path / "scans" / "one" / "truth.ply").write_text("mesh")
    return tmp_path / "scans"


def _table(scans, *lines):
    path = scans / "scans.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_folders_patterns_and_tables_name_the_same_jobs(scans):
    by_pattern = read_jobs([str(scans / "t*"), scans / "one", scans / "one"], box=BOX)
    assert [job.scene.name for job in by_pattern] == ["three", "two", "one"]
    assert [job.truth for job in by_pattern] == [None, None, scans / "one" / "truth.ply"]
    table = _table(scans, "scene,box", "three,0.2 0.3 0.4", "two,0.2x0.3x0.4", "one,")
    assert read_jobs([table], box=BOX) == by_pattern
    # By default the outside of the box is that of the scene folder, or found by radar.
    one, two = read_jobs([_table(scans, "scene", "one", "two")])
    assert one.prior.los == scans / "one" / "los.ply"
    assert not two.prior.is_given


def test_two_scenes_of_one_name_are_refused_as_one_would_hide_the_other(scans):
    shutil.copytree(scans / "one", scans / "later" / "one")
    with pytest.raises(geraf2.UserError, match=r"later/one: two scenes have the same name"):
        read_jobs([scans / "one", scans / "later" / "one"], box=BOX)


def test_columns_of_a_table_give_the_box_and_the_truth(scans):
    lines = ["scene, prior, truth", "two, one/los.ply, one/truth.ply", "three,,", "one,,"]
    base = FastPreset(fit=FitConfig(spacing_m=0.01))
    two, three, one = read_jobs([_table(scans, *lines)], box=BOX, config=base)
    assert (two.prior.los, two.truth) == (scans / "one" / "los.ply", scans / "one" / "truth.ply")
    assert (three.prior.box, three.truth) == (BOX, None)
    assert (one.config, one.prior.box, one.truth) == (base, BOX, scans / "one" / "truth.ply")


def test_a_scheduler_that_does_not_answer_is_one_line(scans, capsys, monkeypatch):
    monkeypatch.setattr(cluster, "_CONNECT_S", 0.5)
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{closed.getsockname()[1]}"
        command = ["batch", str(scans / "one"), str(scans / "out"), "--scheduler", address]
        assert main(command) == 2
    assert f"{address}: no dask scheduler answers" in the_error(capsys)
    assert not (scans / "out").exists()


def test_a_folder_of_something_else_is_refused_and_a_batch_may_grow(scans, capsys):
    out, marker = BatchFolder(scans / "out", "best"), scans / "out" / "batch.json"
    for names in ("one", "two"), ("one",):
        out.require_own()
        out.add(dict.fromkeys(names, "a-key"))
    assert [paths.scene for paths in out.all_paths()] == ["one", "two"]
    before = marker.read_bytes()
    with pytest.raises(geraf2.UserError, match="out: holds a batch of other settings"):
        BatchFolder(scans / "out", "fast").require_own()
    # A scan that was mended is another one of the same batch.
    out.add({"one": "another-key"})
    assert marker.read_bytes() != before
    for name in ("one", "one/los.ply"):
        assert main(["batch", str(scans / "two"), str(scans / name), *FLAGS]) == 2
        error = the_error(capsys)
        assert "holds files but no batch" in error or "is a file" in error


def test_a_key_follows_scene_prior_truth_and_settings(scans):
    (job,) = read_jobs([scans / "one"])
    assert job.key == read_jobs([scans / "one"])[0].key
    other = [
        replace(job, config=FastPreset()),
        replace(job, options=geraf2.RunOptions(seed=1)),
        replace(job, prior=replace(job.prior, los=None, box=BOX)),
        replace(job, truth=None),
    ]
    assert len({job.key, *(changed.key for changed in other)}) == 5
    before = job.key
    (scans / "one" / "los.ply").write_text("hsem, longer")
    after = job.key
    assert after != before
    (scans / "one" / "scene.toml").write_text("changed")
    assert job.key != after


def test_a_run_that_another_process_writes_is_waited_for(scans, monkeypatch):
    geraf2.save_capture(geraf2.examples.small_capture()[0], scans / "two", overwrite=True)
    tiny = (0.01, 0.01, 0.01)  # refused once it is looked at
    (job,) = read_jobs([scans / "two"], box=tiny, options=geraf2.RunOptions(calibrate="no"))
    paths, waited = JobPaths(scans / "out", job.key, "two"), []
    calls = iter([BusyFolderError("another command is writing"), geraf2.UserError("the box")])

    def refuse(*_):
        raise next(calls)

    monkeypatch.setattr(work, "_reconstruct", refuse)
    monkeypatch.setattr(work.time, "sleep", waited.append)
    with pytest.raises(geraf2.UserError, match="box"):
        work.do_job(job, paths)
    assert waited == [1.0]


@pytest.mark.parametrize(
    ("error", "state"),
    [
        (geraf2.UserError("no such thing"), "bad input"),
        (MemoryError(), "out of memory"),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory"), "out of memory"),
        (OSError(5, "Input/output error"), "lost files"),
        (OSError("a parser's"), "failed"),
        (ZeroDivisionError(), "failed"),
    ],
)
def test_errors_have_their_states(error, state):
    assert error_state(error) == state
    raised = geraf2.UserError("cannot be read")
    raised.__context__ = error  # as after `raise ... from None` within `except`
    is_repeated = state in ("out of memory", "lost files")
    assert error_state(raised) == (state if is_repeated else "bad input")
