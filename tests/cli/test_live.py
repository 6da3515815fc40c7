"""`geraf2 live`: a line a plane, and an ordinary run folder at the end."""

import re
from dataclasses import replace

import pytest

import geraf2
from geraf2 import examples
from geraf2.apps.live import session
from geraf2.cli.main import main
from geraf2.io.growing_scene import GrowingScene
from geraf2.io.mesh import write_mesh
from geraf2.io.run_folder import RunFolder
from geraf2.io.verdict import Trust
from geraf2.scene.store import manifest_of
from geraf2.surfaces import FitConfig
from helpers.run_folders import VERDICTS

BOX = ["--box", *map(str, examples.BOX_M), "--preset", "fast"]


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    """Surfaces of cells of 1 cm: the command has no flag for them."""
    fast = geraf2.FastPreset(fit=FitConfig(spacing_m=0.01))
    monkeypatch.setattr(session, "preset_type", lambda _: lambda: fast)


@pytest.fixture
def source(tmp_path):
    capture, _ = examples.small_capture()
    about = replace(capture, poses=(), provenance={**capture.provenance, "n_planes": "2"})
    scene = GrowingScene(tmp_path / "source", manifest_of(about))
    for number in (0, 3):
        scene.append(capture.poses[number])
    return scene.path


def test_each_plane_is_a_line_and_the_end_a_run(source, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(RunFolder, "verdict", property(lambda _: VERDICTS[Trust.RELIABLE]))
    out = tmp_path / "out"
    assert main(["live", str(source), str(out), *BOX]) == 0
    shown = capsys.readouterr()
    lines = re.findall(
        r"^plane +(\d)  +(\d+) peaks  expected error ([\d.]+) mm  seen (\d+) %  "
        r"F1 [\d.]+ \([\d.]+ to [\d.]+\)  reliable  [\d.]+ s$",
        shown.out,
        flags=re.MULTILINE,
    )
    assert [line[0] for line in lines] == ["1", "2"]
    assert "2 planes: all 2 planes of the scan came" in shown.out
    assert shown.err.count("Nyquist") == 1
    assert (out / "report.html").is_file()
    assert main(["info", str(out)]) == 0
    assert main(["verify", str(out)]) == 0
    assert main(["verify", str(out / "scene")]) == 0
    write_mesh(examples.small_capture()[1], tmp_path / "truth.ply")
    assert main(["evaluate", str(out), "--truth", str(tmp_path / "truth.ply")]) == 0
    capsys.readouterr()
    assert main(["live", str(source), str(out), *BOX, "--no-report"]) == 0  # all are there
    assert not re.search(r"^plane ", capsys.readouterr().out, flags=re.MULTILINE)


def test_a_scan_that_is_not_to_be_trusted_reaches_no_target_and_says_why(
    source, tmp_path, capsys, monkeypatch
):
    judged = VERDICTS[Trust.NOT_TO_BE_TRUSTED]
    monkeypatch.setattr(RunFolder, "verdict", property(lambda _: judged))
    flags = ["--until", "expected 99 mm over 50 %", "--no-report", "--strict"]
    assert main(["live", str(source), str(tmp_path / "out"), *BOX, *flags]) == 3
    lines = capsys.readouterr().out.splitlines()
    planes = [line for line in lines if line.startswith("plane")]
    assert len(planes) == 2
    assert all("expected error not determined" in line for line in planes)
    assert not any("F1" in line for line in planes)
    assert all("%  not to be trusted  " in line for line in planes)
    assert [line.split()[0] for line in lines[-3:]] == ["verdict", "because", "do"]


def test_it_stops_at_a_target(source, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(RunFolder, "verdict", property(lambda _: VERDICTS[Trust.RELIABLE]))
    target = ["--until", "expected 99 mm over 50 %", "--no-report"]
    assert main(["live", str(source), str(tmp_path / "out"), *BOX, *target]) == 0
    assert "1 planes: the target is reached" in capsys.readouterr().out
    assert len(geraf2.load_capture(tmp_path / "out" / "scene").poses) == 1
    assert not (tmp_path / "out" / "report.html").exists()


def test_a_damaged_plane_is_a_warning_and_comes_once_it_is_whole(source, tmp_path, capsys):
    chunk = source / "radar.zarr/signal/c/1/0/0"
    whole = chunk.read_bytes()
    chunk.write_bytes(bytes(len(whole)))
    assert (
        main(["live", str(source), str(tmp_path / "out"), *BOX, "--idle", "0.5", "--no-report"])
        == 0
    )
    shown = capsys.readouterr()
    assert "1 planes: no plane came for 0.5 s" in shown.out
    assert len([line for line in shown.err.splitlines() if "is not what was written" in line]) == 1
    chunk.write_bytes(whole)
    assert main(["live", str(source), str(tmp_path / "out"), *BOX, "--no-report"]) == 0
    assert re.findall(r"^plane +(\d)", capsys.readouterr().out, flags=re.MULTILINE) == ["2"]
