"""A run is repeated by its config.toml; errors of wrong ones; a folder that another run holds."""

import hashlib
import subprocess
import sys

from geraf2.cli.main import main
from geraf2.pipeline.run_record import RunRecord
from helpers.console import the_error


def content(out):
    return hashlib.sha256((out / "mesh_content.ply").read_bytes()).hexdigest()


def test_a_run_is_repeated_by_its_config(built_run, built_scene, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # nothing in the file depends on the folder that it was made in
    config = built_run / "config.toml"
    command = ["reconstruct", str(built_scene), "again", "--config", str(config), "--no-report"]
    assert main(command) == 0
    assert content(tmp_path / "again") == content(built_run)
    record = RunRecord.read(tmp_path / "again" / "config.toml")
    assert record == RunRecord.read(config)
    assert record.config.fit.spacing_m == 0.012


def test_flags_go_before_the_config(built_run, built_scene, tmp_path):
    config, out = str(built_run / "config.toml"), tmp_path / "out"
    flags = ["--fit.distance-rounds", "0", "--seed", "3", "--box", "0.21", "0.21", "0.21"]
    command = ["reconstruct", str(built_scene), str(out), "--no-report", "--config", config]
    assert main([*command, *flags]) == 0
    record = RunRecord.read(out / "config.toml")
    assert (record.config.fit.distance_rounds, record.config.fit.spacing_m) == (0, 0.012)
    assert record.options.seed == 3
    assert record.prior.box == (0.21, 0.21, 0.21)


def test_the_constants_of_a_preset_are_a_page_of_their_own(capsys):
    assert main(["reconstruct", "--help"]) == 0
    common = capsys.readouterr().out
    assert main(["reconstruct", "--help-preset", "best"]) == 0
    constants = capsys.readouterr().out
    assert "--refine.rim.dynamic-range-db" in constants
    assert "--refine.rim.dynamic-range-db" not in common
    assert common.count("\n  --") < constants.count("\n  --")
    assert "--seed" not in constants


def test_a_second_command_is_refused_and_nothing_is_lost(finished_run, built_scene, capsys):
    script = (
        "import sys; from pathlib import Path; from geraf2.io.run_folder import RunFolder\n"
        "with RunFolder.read(Path(sys.argv[1])).lock(): print('held', flush=True); input()"
    )
    before = {p: p.read_bytes() for p in finished_run.rglob("*") if p.is_file()}
    with subprocess.Popen(
        [sys.executable, "-c", script, str(finished_run)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as holder:
        assert holder.stdout.readline() == "held\n"
        for command in (
            ["evaluate", str(finished_run), "--truth", str(built_scene / "truth.ply")],
            ["render", str(finished_run), "--angles", "0"],
            ["image", str(built_scene), str(finished_run), "--spacing-m", "0.02"],
        ):
            assert main(command) == 2
            assert f"process {holder.pid};" in the_error(capsys)
        assert {p: p.read_bytes() for p in before} == before
        holder.communicate("\n", timeout=30)
