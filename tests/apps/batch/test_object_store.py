"""Scenes from object stores and results into them: in memory, and S3 on the loopback."""

import json
import logging
import threading
from pathlib import Path

import numpy as np
import pytest

import geraf2
from geraf2.apps.batch import BatchOptions, read_jobs, run
from geraf2.cli.main import main
from geraf2.io import objects
from geraf2.io.run_folder import CONTENT_NAME
from geraf2.pipeline.presets import FastPreset
from geraf2.surfaces import FitConfig
from helpers.one_process import in_one_process  # noqa: F401 - a fixture of the tests here

pytest.importorskip("obstore", reason="object stores need the package obstore")

BOX = geraf2.examples.BOX_M
COARSE = FastPreset(fit=FitConfig(spacing_m=0.012))
QUIET = geraf2.RunOptions(calibrate="no", trust_los=True)


@pytest.fixture(scope="module")
def scene(tmp_path_factory, small_scan):
    capture, truth = small_scan
    folder = tmp_path_factory.mktemp("scans") / "scan"
    geraf2.save_capture(capture, folder)
    geraf2.io.mesh.write_mesh(truth, folder / "truth.ply")
    return folder


class _Unsteady:
    """S3 that answers 503 to some of the next requests, two of three."""

    def __init__(self, application):
        self.application, self.n_asked, self.n_refused = application, 0, 0

    def __call__(self, environ, start_response):
        self.n_asked += 1
        if self.n_refused and self.n_asked % 3:
            self.n_refused -= 1
            start_response("503 Slow Down", [("Content-Length", "0")])
            return [b""]
        return self.application(environ, start_response)


@pytest.fixture(scope="module")
def s3():
    moto_server = pytest.importorskip("moto.server", reason="S3 on the loopback needs moto[server]")
    serving = pytest.importorskip("werkzeug.serving")
    unsteady = _Unsteady(moto_server.DomainDispatcherApplication(moto_server.create_backend_app))
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = serving.make_server("127.0.0.1", 0, unsteady, threaded=True)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    environment = {
        "AWS_ACCESS_KEY_ID": "nobody",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{server.port}",
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, value in environment.items():
            patch.setenv(name, value)
        objects._store.cache_clear()
        _make_bucket(environment["AWS_ENDPOINT_URL"])
        yield unsteady
        objects._store.cache_clear()
    server.shutdown()
    thread.join()
    server.server_close()


def _make_bucket(endpoint):
    from urllib.request import Request, urlopen  # noqa: PLC0415 - for this alone

    with urlopen(Request(f"{endpoint}/scans", method="PUT")) as answer:
        assert answer.status == 200


@pytest.mark.parametrize("store", ["memory://some", "file://"])
def test_files_of_a_store_are_read_written_and_listed(store, tmp_path):
    folder = Path(f"{store}{tmp_path}/where")
    assert not objects.exists(folder)
    objects.write_bytes(folder / "a" / "b.txt", b"one")
    objects.write_bytes(folder / "c", memoryview(b"three"))
    assert objects.read_bytes(folder / "a" / "b.txt") == b"one"
    assert {name: size for name, (size, _) in objects.list_files(folder).items()} == {
        "a/b.txt": 3,
        "c": 5,
    }
    assert (objects.exists(folder / "a"), objects.is_file(folder / "a")) == (True, False)
    with pytest.raises(FileNotFoundError):
        objects.read_bytes(folder / "d")
    assert not objects.list_files(Path("memory://other/where"))


def test_a_scene_in_memory_is_the_scene_on_the_disk(scene):
    there = Path("memory://scenes/scan")
    objects.push(scene, there)
    ours, theirs = geraf2.load_capture(scene), geraf2.load_capture(there)
    for one, other in zip(ours.poses, theirs.poses, strict=True):
        assert one.signal.tobytes() == other.signal.tobytes()
    assert ours.waveform == theirs.waveform
    mesh = geraf2.io.mesh.read_mesh(there / "truth.ply")
    assert np.array_equal(mesh.faces, geraf2.io.mesh.read_mesh(scene / "truth.ply").faces)


@pytest.mark.usefixtures("in_one_process")
def test_a_batch_reads_from_a_store_and_writes_into_it_though_it_answers_503(s3, scene, capsys):
    for name in ("one", "two"):
        objects.push(scene, Path(f"s3://scans/today/{name}"))
    jobs = read_jobs(["s3://scans/today/*"], box=BOX, config=COARSE, options=QUIET)
    assert [job.scene.name for job in jobs] == ["one", "two"]
    jobs, out, s3.n_refused = jobs[:1], Path("s3://scans/out"), 12
    results = run(jobs, out, options=BatchOptions(workers=1))
    assert s3.n_refused == 0
    assert [r.state for r in results] == ["done"]
    assert results[0].scores["f1_15mm"] > 0.5
    files = objects.list_files(out)
    assert [name for name in files if name.endswith(CONTENT_NAME)]
    assert {"batch.json", "batch.html"} <= set(files)
    assert not [name for name in files if name.endswith((".begun", ".lock"))]
    # Nothing is done again, and no worker is needed.
    assert run(jobs, out, options=BatchOptions(scheduler="tcp://127.0.0.1:9")) == results
    capsys.readouterr()
    assert main(["info", "s3://scans/today/one"]) == 0
    assert "antennas" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("address", "line"),
    [
        ("s3://scans/nowhere", "no such scene"),
        ("s3://scans/elsewhere/*", "no scene has such a name"),
        ("s3://key:secret@scans/today/one", "credentials come from the environment"),
    ],
)
def test_what_is_not_in_the_store_is_one_line(s3, capsys, address, line, tmp_path):
    assert main(["batch", address, str(tmp_path / "out"), "--box", "0.2", "0.2", "0.2"]) == 2
    error = capsys.readouterr().err
    assert line in error
    assert "secret" not in error
    assert json.dumps(error).count("\\n") == 1
