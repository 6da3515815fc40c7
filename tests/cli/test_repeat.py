"""A run is repeated by its config.toml; errors of wrong ones; a folder that another run holds."""

import hashlib
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from geraf2.apps.viewing.server import scene_of
from geraf2.cli._flags import parse
from geraf2.cli.main import main
from geraf2.cli.reconstruct import Config, defaults
from geraf2.errors import UserError
from geraf2.pipeline.los_options import LosOptions
from geraf2.pipeline.prior import PriorSource
from geraf2.pipeline.run_record import RunRecord
from geraf2.report import write_report
from helpers.console import the_error
from helpers.small_scene import BOX


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


def test_flags_go_before_the_config(built_run, built_scene):
    flags = ["--fit.completion", "smooth", "--seed", "3", "--box", "0.21", "0.21", "0.21"]
    words = [str(built_scene), "out", "--config", str(built_run / "config.toml"), *flags]
    config = parse(Config, words, prog="geraf2 reconstruct", default=defaults(words))
    assert (config.settings.fit.completion, config.settings.fit.spacing_m) == ("smooth", 0.012)
    assert (config.seed, config.samples) == (3, 6)
    assert config.box == (0.21, 0.21, 0.21)


def test_the_constants_of_a_preset_are_a_page_of_their_own(capsys):
    assert main(["reconstruct", "--help"]) == 0
    common = capsys.readouterr().out
    assert main(["reconstruct", "--help-preset", "best"]) == 0
    constants = capsys.readouterr().out
    assert "--refine.silhouettes.max-tilt-deg" in constants
    assert "--refine.silhouettes.max-tilt-deg" not in common
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


@pytest.fixture
def asked(monkeypatch):
    """Object stores that were asked, none of which answers."""
    urls = []

    def store(url):
        urls.append(url)
        raise UserError(what="a request was made", where=url)

    monkeypatch.setattr("geraf2.io.objects._store", store)
    return urls


@pytest.fixture
def strange_run(finished_run):
    """Run whose config.toml names object stores, and files here that were moved along."""
    config = finished_run / "config.toml"
    record = replace(RunRecord.read(config), prior=PriorSource(los=Path("s3://bucket/los.ply")))
    photos = LosOptions(masks=Path("s3://bucket/masks"), to_radar=Path("gs://bucket/to.txt"))
    scene = Path("az://bucket/scene")
    replace(record, scene=scene, options=replace(record.options, photos=photos)).write(config)
    positions = "".join(f"{n} = 'mesh_box.ply'\n" for n in ("scene", "los", "masks", "to_radar"))
    config.write_text(config.read_text().replace("[places]\n", "") + f"\n[places]\n{positions}")
    return finished_run


@pytest.mark.parametrize("command", ["evaluate", "render", "inspect", "verify", "view", "report"])
def test_a_run_that_is_read_makes_no_requests(strange_run, asked, command, capsys):
    assert RunRecord.read(strange_run / "config.toml").prior.los == Path("s3://bucket/los.ply")
    if command == "view":
        scene_of(strange_run)
    elif command == "report":
        write_report(strange_run)
    else:
        truth = ["--truth", str(strange_run / "mesh.ply")] if command == "evaluate" else []
        main([command, str(strange_run), *truth])
    assert asked == []


def test_addresses_of_stores_come_from_the_command_line(
    strange_run, built_scene, tmp_path, asked, capsys
):
    config = ["--config", str(strange_run / "config.toml")]
    for line in (["reconstruct", str(built_scene)], ["batch", str(built_scene)]):
        assert main([*line, str(tmp_path / "out"), *config]) == 2
        assert "config.toml: names an object store" in the_error(capsys)
    assert asked == []
    assert not (tmp_path / "out").exists()
    given = [*config, *BOX, "--no-report"]
    assert main(["reconstruct", str(built_scene), str(tmp_path / "out"), *given]) == 0
    assert main(["reconstruct", str(built_scene), "o", *config, "--los", "s3://mine/a.ply"]) == 2
    assert asked == ["s3://mine"]
