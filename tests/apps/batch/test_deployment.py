"""The scripts of examples/ with processes of their own over TCP, ssh and sbatch being stand-ins."""

import csv
import os
import shlex
import socket
import subprocess
import sys

import pytest

import geraf2

pytest.importorskip("distributed")
yaml = pytest.importorskip("yaml")  # of dask

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
BATCH += ["--fit.distance-rounds", "1"]


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
    with (position / "out" / "batch.csv").open() as handle:
        (row,) = csv.DictReader(handle)
    assert (row["state"], row["worker"][:6]) == ("done", "tcp://")


def _free_port():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return str(one.getsockname()[1])


@pytest.mark.slow
def test_an_array_of_slurm_does_a_batch_and_ends(project_root, position):
    _require_done(["sbatch", str(project_root / "examples" / "batch.slurm"), *BATCH], position)
    assert not list(position.glob("scheduler-*.json"))


@pytest.mark.slow
def test_machines_by_ssh_do_a_batch(project_root, position):
    script = str(project_root / "examples" / "batch_ssh.sh")
    where = {"SCHEDULER_HOST": "127.0.0.1", "SCHEDULER_PORT": _free_port()}
    _require_done([script, *BATCH], position, HOSTS="a", WORKERS="1", **where)


def test_the_manifest_of_kubernetes_runs_the_same_three_commands(project_root):
    text = (project_root / "examples" / "batch.kubernetes.yaml").read_text(encoding="utf-8")
    pods = [
        d["spec"]["template"]["spec"] for d in yaml.safe_load_all(text) if "template" in d["spec"]
    ]
    commands = [pod["containers"][0]["command"] for pod in pods]
    assert [command[:2] for command in commands] == [
        ["dask", "scheduler"],
        ["dask", "worker"],
        ["geraf2", "batch"],
    ]
    (service,) = [d for d in yaml.safe_load_all(text) if d["kind"] == "Service"]
    address = f"tcp://{service['metadata']['name']}:{service['spec']['ports'][0]['port']}"
    assert commands[1][2] == commands[2][-1] == address
    assert commands[0][commands[0].index("--port") + 1] == "8786"
    script = (project_root / "examples" / "batch_ssh.sh").read_text(encoding="utf-8")
    for flag in commands[1][5:]:
        assert flag in script or flag.isdigit()
    assert all(isinstance(word, str) for command in commands for word in command)
