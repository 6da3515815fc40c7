"""What others left in the working directory, or try over the network, has no effect on a batch."""

import asyncio
import os
import shutil
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

import pytest

import geraf2

distributed = pytest.importorskip("distributed")


from geraf2.apps.batch.cluster import local_cluster  # noqa: E402
from helpers.batch_tasks import square  # noqa: E402

MODULES = ("json", "pickle", "ctypes", "signal", "subprocess", "dask", "distributed", "geraf2")
MODULES += ("multiprocessing", "sitecustomize", "usercustomize", "numpy", "yaml", "tornado", "evil")
SETTINGS = (
    "dask.yaml",
    "distributed.yaml",
    ".dask.yaml",
    "etc/dask/dask.yaml",
    ".config/dask.yaml",
)
TRAP = "import os\nos.write(os.open({!r}, os.O_CREAT | os.O_APPEND | os.O_WRONLY), b'{} ran\\n')\n"


@pytest.fixture
def trapped(tmp_path, monkeypatch):
    """Working directory with modules and settings of a stranger; the file that they would write."""
    found, folder = tmp_path / "ran.txt", tmp_path / "scans"
    folder.mkdir()
    for name in MODULES:
        (folder / f"{name}.py").write_text(TRAP.format(str(found), name))
    preload = "distributed: {worker: {preload: [evil]}, scheduler: {preload: [evil]}}\n"
    for name in SETTINGS:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(preload)
    (folder / "matplotlibrc").write_text("text.usetex: True\nbackend: module://evil\n")
    shared = tmp_path / "tmp" / "dask-scratch-space"  # that another user made before
    shutil.copytree(folder, shared)
    for name in ("zarr", "skimage", "matplotlib", "trimesh", "torch", "jinja2", "webbrowser"):
        (shared / f"{name}.py").write_text(TRAP.format(str(found), f"shared {name}"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    (tmp_path / "bin").mkdir()
    for name in ("latex", "pdflatex", "dvipng"):
        (tmp_path / "bin" / name).write_text(f"#!/bin/sh\necho {name} ran >> {found}\nexit 1\n")
        (tmp_path / "bin" / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:{os.environ['PATH']}")
    monkeypatch.chdir(folder)
    return found


def test_a_batch_runs_nothing_of_the_working_directory(trapped, small_scan):
    geraf2.save_capture(small_scan[0], Path("one"))
    command = ["batch", "one", "out", "--box", *map(str, geraf2.examples.BOX_M), "--workers", "1"]
    command += ["--preset", "fast", "--fit.spacing-m", "0.012"]
    script = "from geraf2.cli.main import run; run()"
    done = subprocess.run(
        [sys.executable, "-P", "-c", script, *command, "--report"],
        check=False,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert list(Path("out").glob("runs/*/report.html"))
    assert not trapped.exists(), trapped.read_text()


def test_a_local_cluster_answers_those_with_its_certificates_alone():
    with local_cluster(1, 1e9) as cluster:
        address = cluster.scheduler_address
        assert address.startswith("tls://127.0.0.1:")
        with distributed.Client(cluster) as client:
            assert client.submit(square, 3).result() == 9
            (worker,) = client.scheduler_info()["workers"].values()
        for one in (address, worker["nanny"], address.replace("tls", "tcp")):
            other = distributed.Security.temporary() if one.startswith("tls") else None
            with pytest.raises((OSError, TimeoutError)):
                asyncio.run(_ask(one, other))
        for port in (cluster.scheduler.http_server.port, worker["services"]["dashboard"]):
            for path in ("", "health", "json/counts.json", "info/main/workers.html", "metrics"):
                with pytest.raises(urllib.error.HTTPError, match="404"):
                    urllib.request.urlopen(f"http://127.0.0.1:{port}/{path}", timeout=10)


async def _ask(address, security):
    arguments = {} if security is None else security.get_connection_args("client")
    async with distributed.rpc(address, connection_args=arguments, timeout=2) as scheduler:
        await scheduler.identity()
