"""What all commands share: --json, --quiet, --verbose, one bar over all steps."""

import json
import webbrowser

import numpy as np
import pytest

from geraf2.cli._console import CONSOLE
from geraf2.cli.main import main
from helpers.small_scene import BOX, FAST


def test_json_is_one_object_on_stdout_and_the_rest_goes_to_stderr(told_run, scene, capsys):
    found = json.loads(told_run.out)
    assert told_run.out.count("\n") == 1
    assert (found["command"], found["exit_code"]) == ("reconstruct", 0)
    assert found["n_pieces"] >= 1
    extents = json.loads((told_run.path / "run.json").read_text())["stages"]["mesh"]["numbers"]
    assert found["extents_m"] == pytest.approx(1e-3 * np.array(extents["extents_mm"]))
    assert found["box"]["size_m"] == pytest.approx([0.2, 0.2, 0.2], abs=0.003)
    is_withdrawn = found["verdict"]["verdict"] == "not to be trusted"
    assert (found["expected_error_median_m"] is None) == is_withdrawn
    assert any("Nyquist" in text for text in found["warnings"])
    assert found["report"] == str(told_run.path / "report.html")
    assert "typical error" in told_run.err
    assert "samples" in told_run.err
    assert "finding echoes of the content ..." in told_run.err
    assert main(["info", str(scene)]) == 0  # the next command prints as before
    assert "planes" in capsys.readouterr().out


def test_an_error_is_a_json_object_too(tmp_path, capsys):
    assert main(["info", str(tmp_path / "none"), "--json"]) == 2
    printed = capsys.readouterr()
    found = json.loads(printed.out)
    assert found["command"] == "info"
    assert found["exit_code"] == 2
    assert printed.err == f"geraf2: {found['error']}\n"


def test_the_state_of_the_machine_is_given_as_rows_and_numbers(capsys):
    assert main(["doctor", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["rows"]["threads"].startswith(f"{found['n_threads']} ")
    assert 0 < found["free_memory_bytes"] <= found["memory_bytes"]


def test_a_quiet_run_prints_warnings_alone_and_opens_its_page(scene, tmp_path, capsys, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda url: opened.append(url) or True)
    monkeypatch.chdir(tmp_path)
    arguments = ["reconstruct", str(scene), *BOX, *FAST, "--trust-los", "--quiet", "--open"]
    assert main([*arguments, "--no-report"]) == 2
    assert main(arguments) == 0
    printed = capsys.readouterr()
    assert printed.out == ""
    assert all(line.startswith("warning: ") for line in printed.err.splitlines()[1:])
    assert opened == [(tmp_path / "out" / "report.html").as_uri()]  # the folder that is the default


@pytest.mark.parametrize("words", [["--threads", "2"], ["--threads=2"]])
def test_all_commands_take_threads(words, scene, tmp_path, monkeypatch, capsys):
    asked = []
    monkeypatch.setattr(
        "geraf2.cli.image.image_scene",
        lambda *_, num_threads, **__: asked.append(num_threads) or 1 / 0,
    )
    assert main([*words, "image", str(scene), str(tmp_path / "out")]) == 1
    assert main(["image", str(scene), str(tmp_path / "out"), "--threads", "many"]) == 2
    assert "--threads: must be a whole number" in capsys.readouterr().err
    assert asked == [2]


def test_steps_of_a_run_say_how_much_of_all_is_done(capsys):
    with CONSOLE.show_as_one({"glints": ("finding echoes", 1.0), "mesh": ("drawing", 3.0)}):
        with CONSOLE.step("glints"):
            pass
        with CONSOLE.step("mesh (done before)"):
            pass
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "finding echoes ..."
    assert lines[1].startswith("finding echoes: 0.0 s; 25 % of all, about 0 s left")
    assert lines[3].startswith("drawing (done before): 0.0 s; 100 % of all")
    with CONSOLE.step("later"):
        pass
    assert "later ..." in capsys.readouterr().err
