"""Batches on a real LocalCluster of two processes; jobs of every fate, workers that are killed."""

import errno
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import geraf2
from geraf2.apps.batch import BatchOptions, cluster, read_jobs, run, running
from geraf2.apps.batch.cluster import local_cluster
from geraf2.apps.batch.engine import RepeatError, Task, attempt, drive
from geraf2.apps.batch.folder import JobPaths
from geraf2.apps.batch.work import do_job
from geraf2.cli.main import main
from geraf2.io import atomic
from geraf2.io.run_folder import CONTENT_NAME, file_digest
from geraf2.pipeline.presets import FastPreset
from geraf2.surfaces import FitConfig
from helpers import batch_tasks

distributed = pytest.importorskip("distributed")
# Sockets that distributed leaves to the collector when a worker was killed.
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")

BOX = geraf2.examples.BOX_M
COARSE = FastPreset(fit=FitConfig(spacing_m=0.012))
QUIET = geraf2.RunOptions(calibrate="no", trust_los=True)


@pytest.fixture(scope="module")
def client():
    with local_cluster(2, 4e9, retries=1) as workers, distributed.Client(workers) as one:
        yield one


@pytest.fixture
def named(tmp_path, monkeypatch):
    """Makes jobs whose fate is in the name of their empty scenes, done by a function of tests."""
    monkeypatch.setattr(running, "do_job", batch_tasks.job_by_name)

    def make(*names):
        for name in names:
            (tmp_path / name).mkdir(exist_ok=True)
            (tmp_path / name / "scene.toml").write_text(name)
        return read_jobs([tmp_path / name for name in names], box=BOX)

    return make


def _rows(page):
    """Texts of the cells of a page's table, a list for each row with some."""
    rows = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in page.split("<tr")]
    return [[re.sub("<[^>]*>", "", cell) for cell in row] for row in rows if row]


def test_a_batch_gives_what_single_runs_give_and_continues_where_it_stopped(
    client, small_scan, tmp_path, capsys
):
    scan, truth = small_scan
    broken = replace(scan.poses[0], signal=np.full_like(scan.poses[0].signal, np.nan))
    scans = {
        "first": scan,
        "second": replace(scan, poses=scan.poses[1:]),
        "nothing": replace(scan, poses=(broken,) * 4),
    }
    for name, content in scans.items():
        geraf2.save_capture(content, tmp_path / "scans" / name)
    geraf2.io.mesh.write_mesh(truth, tmp_path / "scans" / "first" / "truth.ply")
    sources, out, heard = [tmp_path / "scans" / "*"], tmp_path / "out", []
    jobs = read_jobs(sources, box=BOX, config=COARSE, options=QUIET)
    results = run(jobs, out, client, heard.append)
    assert {r.scene: r.state for r in results} == {
        "first": "done",
        "second": "done",
        "nothing": "bad input",
    }
    by_scene = {result.scene: result for result in results}
    assert sorted(map(str, heard)) == sorted(map(str, results))
    assert "\n" not in by_scene["nothing"].error
    assert by_scene["first"].scores["f1_15mm"] > 0.5
    assert {"f1_5mm", "f1_2mm", "volume_ratio", "extent_x_mm"} <= set(by_scene["first"].scores)
    assert 80 < by_scene["first"].peak_memory_mib < 1500
    # The bytes of one run alone.
    serial = geraf2.reconstruct(tmp_path / "scans" / "second", BOX, COARSE, options=QUIET)
    (run_folder,) = (out / "runs").glob("second-*")
    assert file_digest(run_folder / CONTENT_NAME) == file_digest(serial.path / CONTENT_NAME)
    # A row a scan, the failed one first, then those that are done.
    page = (out / "batch.html").read_text(encoding="utf-8")
    assert [row[:2] for row in _rows(page)] == [
        ["nothing", "bad input"],
        ["first", "done"],
        ["second", "done"],
    ]
    # Again: nothing is done again, and no worker is needed.
    before = {path: path.stat().st_mtime_ns for path in out.glob("r*/**/*") if path.is_file()}
    nowhere = BatchOptions(scheduler="tcp://127.0.0.1:9")
    assert run(jobs, out, options=nowhere) == results
    command = ["batch", str(*sources), str(out), "--config", str(run_folder / "config.toml")]
    capsys.readouterr()
    assert main(command) == 2  # for the one that failed
    assert "3 scenes, 2 done, 1 failed" in capsys.readouterr().out
    assert {path: path.stat().st_mtime_ns for path in before} == before


def _calls(out):
    """How often each job was begun, by its name."""
    return Counter(line.split()[0] for line in (out / "calls.txt").read_text().splitlines())


def test_links_of_one_name_are_scenes_of_their_own(tmp_path):
    for day in ("monday", "tuesday"):
        (tmp_path / day / "scene").mkdir(parents=True)
        (tmp_path / day / "scene" / "scene.toml").write_text(day)
        (tmp_path / f"{day}-scan").symlink_to(tmp_path / day / "scene")
    jobs = read_jobs([tmp_path / "*-scan"], box=BOX)
    assert sorted(job.scene.name for job in jobs) == ["monday-scan", "tuesday-scan"]
    assert len({job.key for job in jobs}) == 2


def test_faults_of_one_job_are_its_own(client, named, tmp_path):
    """Lost files and killed workers are tried again, bad input never; the others continue."""
    jobs = named("good-1", "killer", "bad", "lost", "once", "raises", "good-2")
    out, options = tmp_path / "out", BatchOptions(retries=1)
    results = {r.scene: r for r in run(jobs, out, client, options=options)}
    wanted = {
        "good-1": ("done", 1, ""),
        "good-2": ("done", 1, ""),
        "killer": ("killed", 2, "its worker died 2 times while it ran"),
        "bad": ("bad input", 1, "because of bad"),
        "once": ("done", 2, ""),
        "lost": ("lost files", 2, "[Errno 5] Input/output error"),
        "raises": ("failed", 1, "internal error: ZeroDivisionError: a bug"),
    }
    assert {r.scene: (r.state, r.error) for r in results.values()} == {
        name: (state, error) for name, (state, _, error) in wanted.items()
    }
    calls = _calls(out)
    # A killed worker takes answers with it that the client has not fetched: those that are in no
    # file are asked for again.
    for name, (state, count, _) in wanted.items():
        assert count <= calls[name] <= count + 2 * (state not in ("done", "killed"))
    assert results["raises"].log_tail[-1] == "ZeroDivisionError: a bug"
    # The same again: what is done and what is bad stays, the others get another chance.
    run([job for job in jobs if job.scene.name != "killer"], out, client, options=options)
    assert _calls(out) - calls == {"lost": 2, "raises": 1}


def test_a_worker_that_is_killed_in_a_job_costs_nothing_but_time(client, named, tmp_path):
    jobs, out = named("hangs", *(f"good-{i}" for i in range(11))), tmp_path / "out"
    heard, killed = [], []

    def hear(result):
        heard.append(result.scene)
        begun = dict(line.split() for line in (out / "calls.txt").read_text().splitlines())
        if "hangs" in begun and not killed:
            killed.append(int(begun["hangs"]))
            os.kill(killed[0], signal.SIGKILL)

    results = run(jobs, out, client, hear)
    assert killed
    assert [r.state for r in results] == ["done"] * 12
    assert sorted(heard) == sorted(job.scene.name for job in jobs)
    assert _calls(out) == {job.scene.name: 1 for job in jobs} | {"hangs": 2}


def test_tasks_are_made_when_there_is_room_for_them(client):
    client.wait_for_workers(2)
    made = []

    def tasks():
        for i in range(30):
            made.append(i)
            yield Task(name=f"{i}", arguments=(i,))
            yield None  # as a stream without a parcel at present

    ahead, squares = [], {}
    for name, answer in drive(client, batch_tasks.square, tasks()):
        squares[int(name)] = answer
        ahead.append(len(made) - len(squares))
    assert squares == {i: i * i for i in range(30)}
    assert max(ahead) <= 2


SCHEDULER = """
import sys
from distributed import LocalCluster
if __name__ == "__main__":
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp", host="127.0.0.1",
        dashboard_address=None,
    ) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.readline()
"""


def test_a_lost_scheduler_is_one_line_and_the_same_call_continues(client, named, tmp_path):
    (tmp_path / "scheduler.py").write_text(SCHEDULER)
    command = [sys.executable, str(tmp_path / "scheduler.py")]
    environment = os.environ | {"PYTHONPATH": str(Path(batch_tasks.__file__).parent.parent)}
    pipe = subprocess.PIPE
    with subprocess.Popen(
        command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True, env=environment
    ) as process:
        options = BatchOptions(scheduler=process.stdout.readline().strip())
        jobs, out, heard = named(*(f"good-{i}" for i in range(20))), tmp_path / "out", []

        def hear(result):
            heard.append(result)
            if len(heard) == 3:
                process.kill()

        with pytest.raises(geraf2.UserError, match=r"scheduler was lost.*the same command"):
            run(jobs, out, on_result=hear, options=options)
    records = [r for r in (out / "results").glob("*.json") if not r.name.startswith(".")]
    done = [json.loads(record.read_text())["scene"] for record in records]
    assert 3 <= len(done) < 20
    results = run(jobs, out, client)
    assert {result.state for result in results} == {"done"}
    assert {_calls(out)[name] for name in done} == {1}


def test_a_folder_that_takes_no_records_stops_the_batch(client, named, tmp_path):
    """As of a full disk: every job would fail alike."""
    jobs, out = named("good-1", "good-2"), tmp_path / "out"
    run(jobs[:1], out, client)
    shutil.rmtree(out / "results")
    (out / "results").write_text("no folder")
    with pytest.raises(geraf2.UserError, match=r"results.*: cannot write the file"):
        run(jobs, out, client)


def test_a_full_disk_is_lost_files_in_one_line(small_scan, tmp_path, monkeypatch):
    def full(path):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    geraf2.save_capture(small_scan[0], tmp_path / "scene")
    (job,) = read_jobs([tmp_path / "scene"], box=BOX, config=COARSE, options=QUIET)
    monkeypatch.setattr(atomic, "_flush", full)
    with pytest.raises(RepeatError) as error:
        attempt(do_job, geraf2.__version__, job, JobPaths(tmp_path / "out", job.key, "scene"))
    (failure,) = error.value.args
    assert failure.state == "lost files"
    assert "No space left on device" in failure.error
    assert "\n" not in failure.error


def test_workers_without_this_geraf2_are_refused_by_name(client, named, tmp_path, monkeypatch):
    jobs = named("good-1")
    monkeypatch.setattr(cluster, "__version__", "9.9")
    with pytest.raises(geraf2.UserError, match=r"^worker tls://.* has another geraf2, expected 9"):
        run(jobs, tmp_path / "out", client)
    without = {"workers": {"tcp://a:1": {"packages": {"geraf2": None}}}}
    monkeypatch.setattr(client, "get_versions", lambda packages: without)
    with pytest.raises(geraf2.UserError, match=r"^worker tcp://a:1: has no geraf2"):
        run(jobs, tmp_path / "out", client)
    assert not (tmp_path / "out").exists()
    late = attempt(batch_tasks.square, "9.9", 2)  # of a worker that came later
    assert (late.state, "the client 9.9" in late.error) == ("failed", True)


def test_a_scene_that_no_worker_can_hold_is_one_line_and_the_others_are_done(
    client, named, tmp_path
):
    jobs = named("good-1", "huge")
    about = tmp_path / "huge" / "radar.zarr" / "signal"
    about.mkdir(parents=True)
    (about / "zarr.json").write_text('{"shape": [100, 100000, 64]}')  # 24 bytes a sample
    good, huge = run(jobs, tmp_path / "out", client)
    assert (good.state, huge.state) == ("done", "out of memory")
    assert huge.error.startswith("no worker has enough memory, expected about 19.4 GiB, got 3.7")
