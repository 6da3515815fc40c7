"""The scripts of examples/ with processes of their own over TCP, ssh and sbatch being stand-ins."""

import json
import os
import shlex
import subprocess
import sys

import pytest

import geraf2
from helpers.ports import free_port

pytest.importorskip("distributed")

# What the scripts call, from this environment.
_COMMANDS = {
    "dask": 'exec {python} -m dask "$@"',
    "geraf2": 'exec {python} -c "from geraf2.cli.main import run; run()" "$@"',
    "python": 'exec {python} "$@"',
    "ssh": 'shift; exec "$@"',  # on this machine
    # An array of two tasks, of which scancel ends the second.
    "sbatch": """
export SLURM_ARRAY_JOB_ID=7 SLURM_ARRAY_TASK_MAX=1 SLURM_SUBMIT_DIR=$PWD SLURM_CPUS_PER_TASK=1
SLURM_ARRAY_TASK_ID=1 setsid bash "$@" & echo $! > worker.pid
SLURM_ARRAY_TASK_ID=0 bash "$@"
status=$?
wait
exit $status""",
    "scancel": '[ "$1" = "7_[1-1]" ] && kill -- -$(cat worker.pid)',
}


@pytest.fixture
def position(tmp_path, monkeypatch, small_scan):
    """Folder with a scene, and the commands of a cluster."""
    geraf2.save_capture(small_scan[0], tmp_path / "scans" / "one")
    (tmp_path / "bin").mkdir()
    for name, text in _COMMANDS.items():
        script = tmp_path / "bin" / name
        script.write_text(f"#!/bin/bash\n{text.format(python=shlex.quote(sys.executable))}\n")
        script.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:{os.environ['PATH']}")
    monkeypatch.chdir(tmp_path)
    return tmp_path


BATCH = ["scans/one", "out", "--box", *map(str, geraf2.examples.BOX_M), "--preset", "fast"]
BATCH += ["--fit.spacing-m", "0.012"]


def _require_done(command, position, **environment):
    # To a file: a process that were left behind would hold a pipe open.
    with (position / "output.txt").open("w") as output:
        done = subprocess.run(
            command,
            env={**os.environ, **environment},
            stdout=output,
            stderr=subprocess.STDOUT,
            check=False,
            timeout=900,
        )
    assert done.returncode == 0, (position / "output.txt").read_text()
    (record,) = (position / "out" / "results").glob("*.json")
    row = json.loads(record.read_text())
    assert (row["state"], row["worker"][:6]) == ("done", "tcp://")


@pytest.mark.slow
def test_an_array_of_slurm_does_a_batch_and_ends(project_root, position):
    _require_done(["sbatch", str(project_root / "examples" / "batch.slurm"), *BATCH], position)
    assert not list(position.glob("scheduler-*.json"))


@pytest.mark.slow
def test_machines_by_ssh_do_a_batch(project_root, position):
    script = str(project_root / "examples" / "batch_ssh.sh")
    where = {"SCHEDULER_HOST": "127.0.0.1", "SCHEDULER_PORT": str(free_port())}
    _require_done([script, *BATCH], position, HOSTS="a", WORKERS="1", **where)
