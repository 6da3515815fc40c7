"""`geraf2 belt` from a stream to rows and run folders, also with workers that die."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from geraf2.apps.batch import cluster
from geraf2.apps.belt.running import BeltOptions, run_belt
from geraf2.errors import UserError
from helpers.belt_stream import stream_planes, write_stream
from helpers.one_process import in_threads

pytest.importorskip("distributed")


def run(stream, out):
    """Outcome and lines; the worker is a thread."""
    lines, options = [], BeltOptions(workers=1, idle_s=0.5, threads=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cluster, "local_cluster", in_threads)
        return run_belt(stream, out, "fast", options=options, on_line=lines.append), lines


def meshes(out):
    """Bytes of each parcel's mesh, by its name."""
    return {
        path.parent.name.rpartition("-")[0]: path.read_bytes()
        for path in sorted((out / "runs").glob("*/mesh_content.ply"))
    }


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A stream of two parcels, of which the first is damaged, and the run of the second."""
    folder = tmp_path_factory.mktemp("belt")
    planes = stream_planes(2)
    shorter = [p for p in planes if not p.name.startswith("above") or int(p.name[6:]) > 5]
    stream = write_stream(folder / "stream", shorter)
    return stream, folder / "out", *run(stream, folder / "out")


@pytest.mark.slow
def test_each_parcel_is_a_row_and_a_good_one_a_run(done):
    _, out, outcome, lines = done
    assert (outcome.n_done, outcome.n_failed) == (1, 1)
    assert outcome.cores == pytest.approx(outcome.cpu_seconds * 6000 / 3600)
    records = [json.loads(path.read_text()) for path in (out / "results").glob("*.json")]
    bad, good = sorted(records, key=lambda record: record["scene"])
    assert (bad["scene"], bad["state"]) == ("parcel-00001", "bad input")
    assert "frames of array above are missing" in bad["error"]
    assert f"parcel-00001: bad input: {bad['error']}" in lines
    assert (good["scene"], good["state"]) == ("parcel-00002", "done")
    assert good["numbers"]["position_m"] == pytest.approx(-0.6, abs=0.02)
    assert abs(good["numbers"]["travel_percent"]) < 0.5
    (run_json,) = (out / "runs").glob("parcel-00002-*/run.json")
    assert (run_json.parent / "mesh_content.ply").is_file()
    # The motion was estimated from whole arrays.
    calibration = json.loads(run_json.read_text())["stages"]["calibration"]
    assert "positions" not in json.dumps(calibration)
    page = (out / "parcels.html").read_text()
    assert "geraf2 belt" in page
    assert "the latest first" in page
    assert "parcel-00002" in page


@pytest.mark.slow
def test_a_command_that_is_killed_continues_to_the_same_bytes(done, tmp_path):
    stream, out, _, _ = done
    code = "import sys; from geraf2.cli.main import main; sys.exit(main(['belt', *sys.argv[1:]]))"
    again = tmp_path / "out"
    arguments = [str(stream), str(again), "--preset", "fast", "--workers", "1"]
    command = [sys.executable, "-c", code, *arguments, "--idle-s", "2", "--threads", "1"]
    process = subprocess.Popen(command, start_new_session=True)
    while not (again / "parcels" / "parcel-00002" / "scene.toml").is_file():
        time.sleep(0.05)
        assert process.poll() is None
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    outcome, _ = run(stream, again)
    assert outcome.n_done == 1
    assert meshes(again) == meshes(out)
    assert list(meshes(again)) == ["parcel-00002"]


@pytest.mark.slow
def test_other_settings_of_one_folder_are_refused(done):
    stream, out, *_ = done
    with pytest.raises(UserError, match="holds a batch of other settings"):
        run_belt(stream, out, "best", options=BeltOptions(workers=1, idle_s=2.0, threads=1))
