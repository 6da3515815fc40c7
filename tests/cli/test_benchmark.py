"""`geraf2 benchmark` on a suite small enough for a test: rows, caches, failures, pages."""

import json
import tomllib
from functools import partial

import numpy as np
import pytest
from scipy.spatial import KDTree

from geraf2.apps.benchmark import making
from geraf2.apps.benchmark.runner import Runner, time_call
from geraf2.cli.main import main
from geraf2.evaluation import oracle_matched_filter

SUITE = """
[base]
figure = { name = "llama", height_m = 0.11 }
walls = [{ size_m = [0.20, 0.20, 0.20] }]
scan = { n_poses = 6, spacing_m = 0.006, aperture_m = [0.12, 0.14] }
numerics = { wall_patch_m = 0.02, antenna_block_m = 0.07 }
[scenes.llama]
[scenes.giant]
figure = { height_m = 0.5 }

[methods.fast]
title = "geraf2"
options = { trust_los = true }
settings.fit = { spacing_m = 0.012 }
[methods.back-projection]
title = "points"
preset = "back-projection"
options = { trust_los = true }
quick.back_projection = { spacing_m = 0.01 }
settings.back_projection = { spacing_m = 0.006 }

[methods.oracle]
title = "best threshold"
kind = "oracle"
preset = "matched-filter"
settings.matched_filter = { spacing_m = 0.015 }

[experiments.objects]
title = "Objects"
scenes = ["llama", "giant"]
methods = ["fast", "back-projection", "oracle"]
quick = true
quick_methods = ["fast"]
[experiments.objects.published]
llama = { back-projection = { F1 = 0.9 } }

[experiments.walls]
title = "Walls"
scenes = ["llama"]
methods = ["fast"]
cases = [
  { label = "known" },
  { label = "unknown", given_permittivity = "none" },
  { label = "moved", prior_shift_m = [0.001, 0.0, 0.0] },
]
"""


@pytest.fixture(scope="module")
def suite(tmp_path_factory):
    path = tmp_path_factory.mktemp("suite") / "suite.toml"
    path.write_text(SUITE)
    return path


@pytest.fixture(scope="module")
def finished(suite, tmp_path_factory):
    """Made in this process: others are for tests/apps/benchmark and the workers below."""
    out = tmp_path_factory.mktemp("benchmark") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Runner, "_call", lambda _, *call: time_call(*call))
        few = partial(oracle_matched_filter, levels=(0.3, 0.5))  # of 17
        patch.setattr(making, "oracle_matched_filter", few)
        # The giant does not fit into its box: its rows fail, the others continue.
        assert main(["benchmark", str(out), "--suite", str(suite)]) == 2
    return out


def read_table(out, name):
    text = (out / "benchmark.md").read_text(encoding="utf-8")
    (section,) = [part for part in text.split("\n## ") if part.lower().startswith(name)]
    lines = [line for line in section.splitlines() if line.startswith("|")]
    head, _, *rows = ([cell.strip() for cell in line[1:-1].split("|")] for line in lines)
    return [dict(zip(head, row, strict=True)) for row in rows]


def test_each_row_has_its_figures_and_failures_are_named(finished):
    table = read_table(finished, "objects")
    assert [row["scene"] for row in table] == ["llama"] * 3 + ["giant"] * 3
    assert [row["method"] for row in table] == ["geraf2", "points", "best threshold"] * 2
    assert float(table[2]["F1 5 mm"]) > 0.0
    assert float(table[0]["F1 15 mm"]) > 0.74  # 0.777 from 9 planes at 6 mm
    assert table[3]["F1 15 mm"] == "failed"
    assert table[0]["F1 (real data, published)"] == ""
    assert table[1]["F1 (real data, published)"] == "0.900"
    text = (finished / "benchmark.md").read_text(encoding="utf-8")
    assert "does not fit into its box" in text
    page = (finished / "benchmark.html").read_text(encoding="utf-8")
    assert '<h2 id="objects">Objects</h2>' in page
    assert "<script" not in page


def glints_and_settings(out, row):
    results = [json.loads(path.read_text()) for path in (out / "runs").glob("*/result.json")]
    (folder,) = [out / result["folder"] for result in results if result["row"] == row]
    config = tomllib.loads((folder / "config.toml").read_text())
    return np.load(folder / "glints.npz")["positions"], config["box_center"]


def test_unknown_walls_and_a_moved_prior_change_the_run(finished):
    table = read_table(finished, "walls")
    assert table[0]["F1 15 mm"] == read_table(finished, "objects")[0]["F1 15 mm"]  # the same run
    scores = [[text for name, text in row.items() if " mm" in name] for row in table[:2]]
    assert scores[0] != scores[1]
    known, center = glints_and_settings(finished, "objects / llama / fast")
    assert center == [0.0, 0.0, 0.0]
    near = KDTree(known)
    unknown, center = glints_and_settings(finished, "walls / llama / unknown / fast")
    assert center == [0.0, 0.0, 0.0]
    # What the unknown wall delays is learned from its echo: here to 0.1 mm, not to nothing.
    assert 3e-5 < np.median(near.query(unknown)[0]) < 3e-4
    moved, center = glints_and_settings(finished, "walls / llama / moved / fast")
    assert center == [0.001, 0.0, 0.0]
    # Known walls are where the prior has them: 1 mm beside changes what rays cross by micrometres.
    assert 1e-6 < np.median(near.query(moved)[0]) < 1e-4
    scenes = [p for p in (finished / "scenes").iterdir() if p.is_dir()]
    walls = [(p / "scene.toml").read_text().count("[[walls]]") for p in scenes]
    assert sorted(walls) == [0, 1]


def test_time_that_was_spent_is_listed(finished, suite, tmp_path, capsys):
    results = [json.loads(p.read_text()) for p in (finished / "runs").glob("*/result.json")]
    assert len(results) == 5
    assert all(0.01 < result["all_cpu_seconds"] < 300.0 for result in results)
    assert main(["benchmark", str(finished), "--suite", str(suite), "--list"]) == 0
    objects, walls = capsys.readouterr().out.splitlines()
    # The giant's rows failed, and are to be made again.
    assert "6 rows, 3 made in" in objects
    assert "3 rows, 3 made in" in walls
    assert main(["benchmark", str(tmp_path / "none"), "--suite", str(suite), "--list"]) == 0
    assert "CPU" not in capsys.readouterr().out


def test_a_second_run_makes_nothing_again_but_what_failed(finished, suite, capsys):
    files = sorted((finished / "runs").glob("*/result.json"))
    before = [file.stat().st_mtime_ns for file in files]
    arguments = ["benchmark", str(finished), "--suite", str(suite), "--jobs", "2"]
    chosen = ["--only", "walls", "--cases", "known", "mov*", "--methods", "fast"]
    assert main([*arguments, *chosen]) == 0
    assert [file.stat().st_mtime_ns for file in files] == before
    assert "2, of which 0 failed" in capsys.readouterr().out
    assert len(read_table(finished, "walls")) == 3  # that of the row that was not chosen, too
    assert "## Objects" in (finished / "benchmark.md").read_text()  # kept from the run before
    assert main([*arguments[:4], *chosen[:4], "--list"]) == 0
    assert "1 rows, 1 made in" in capsys.readouterr().out


# Sockets that distributed leaves to the collector.
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_a_broken_result_is_made_again_by_workers(finished, suite):
    pytest.importorskip("distributed")
    file = next(p for p in (finished / "runs").glob("llama-back*/result.json"))
    known = json.loads(file.read_text())
    file.write_text("{")
    command = ["benchmark", str(finished), "--suite", str(suite), "--only", "objects"]
    assert main([*command, "--scenes", "llama", "--jobs", "2"]) == 0
    again = json.loads(file.read_text())
    times = {"cpu_seconds": 0, "all_cpu_seconds": 0}
    assert again | times == known | times
    assert len(read_table(finished, "objects")) == 3  # of the scene that was chosen
    assert main([*command, "--jobs", "2", "--scheduler", "tcp://127.0.0.1:9"]) == 2


NOTHING = ("", "")


@pytest.mark.parametrize(
    ("change", "flags", "message"),
    [
        (('methods = ["fast"]\ncases', 'methods = ["fasst"]\ncases'), "", "no such method"),
        (('label = "moved"', 'labels = "moved"'), "", "label"),
        (("walls = [{ size_m = [0.20, 0.20, 0.20] }]", ""), "", "no walls"),
        (("spacing_m", "spacings_m"), "", "did you mean 'spacing_m'?"),
        (('moved"', 'moved", settings = { fit = { cap_slop = 0 } }'), "", "in case 'moved'"),
        (('preset = "back-projection"', 'preset = "back"'), "", "unknown name 'back'"),
        (
            ('preset = "matched-filter"\nsettings.matched_filter', "options = {}\n#"),
            "",
            "an oracle",
        ),
        (NOTHING, "--only walls --cases unknown other", "expected some of known; unknown; moved"),
        (NOTHING, "--only walls --scenes jug", "no such scene, expected some of llama, got jug"),
        (NOTHING, "--only walls --methods *raw", "no such method, expected some of fast, got *raw"),
        (NOTHING, "--quick --only objects --cases a", "no case has a name"),
        (NOTHING, "--scenes giant --cases known", "no row matches scene, case and method together"),
    ],
)
def test_a_wrong_suite_or_choice_is_one_line(change, flags, message, tmp_path, capsys):
    assert change[0] in SUITE
    path, out = tmp_path / "suite.toml", tmp_path / "out"
    path.write_text(SUITE.replace(*change))
    assert main(["benchmark", str(out), "--suite", str(path), *flags.split()]) == 2
    stated = capsys.readouterr().err
    assert message in stated
    assert stated.count("\n") == 1
    assert not out.exists()
