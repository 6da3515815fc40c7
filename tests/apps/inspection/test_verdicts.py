"""What an inspection and a comparison still state of scans that may be wrong."""

import json
import shutil
from dataclasses import replace

import pytest

import geraf2
from geraf2.apps.inspection.material import UNKNOWN, Measured
from geraf2.cli.main import main
from geraf2.io.text import NOT_DETERMINED
from geraf2.io.verdict import Trust
from helpers.run_folders import CAUSE, VERDICTS, judge

WHY = f"not determined, because {CAUSE.text}"


@pytest.fixture
def run(listed, tmp_path):
    return shutil.copytree(listed / "run", tmp_path / "run")


@pytest.mark.parametrize(
    ("trust", "intervals", "exists"),
    [
        (Trust.RELIABLE, "± holds 95 %", 1.0),
        (Trust.DOUBTFUL, "± holds 57 %", 0.6),
        (Trust.NOT_TO_BE_TRUSTED, WHY, None),
    ],
)
def test_an_inspection_inherits_the_verdict(run, capsys, trust, intervals, exists):
    judge(run, trust)
    assert main(["inspect", str(run)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"2 in the box  ({intervals})"
    assert lines[-1].startswith("do " if trust is not Trust.RELIABLE else "verdict ")
    found = json.loads((run / "inspection.json").read_text())
    part = found["parts"][0]
    assert part["probability"] == (None if exists is None else pytest.approx(exists))
    assert (part["volume_m3"]["sigma"] is None) == (exists is None)
    assert part["material"]["kind"] == NOT_DETERMINED
    assert found["verdict"] == VERDICTS[trust].numbers()
    assert f"\nverdict,,{trust},probability of failure," in (run / "inspection.csv").read_text()
    page = (run / "inspection.html").read_text()
    assert page.index('class="verdict ') < page.index("In the box")
    code = 3 if exists is None else 0
    assert main(["inspect", str(run), "--strict"]) == code


def test_nothing_passes_on_a_scan_that_is_not_to_be_trusted(run, listed, capsys):
    judge(run, Trust.NOT_TO_BE_TRUSTED)
    for flags in (["--expect", "2"], ["--expect", "3"], ["--cad", str(listed / "wedge.stl")]):
        assert main(["inspect", str(run), *flags]) == 3
        assert "result   not determined" in capsys.readouterr().out
    found = json.loads((run / "inspection.json").read_text())
    assert (found["result"], found["models"], found["failures"]) == (NOT_DETERMINED, [], [])
    assert found["not_determined"] == CAUSE.text


@pytest.mark.parametrize("trust", Trust)
def test_a_comparison_is_as_good_as_its_worst_run(packed, robbed, tmp_path, capsys, trust):
    other = judge(shutil.copytree(robbed, tmp_path / "run"), trust)
    out, withdrawn = tmp_path / "out", trust is Trust.NOT_TO_BE_TRUSTED
    assert main(["compare", str(other), str(packed), "--out", str(out)]) == 3
    shown = capsys.readouterr().out
    assert (f"result   not determined, because in {other}, {CAUSE.text}" in shown) == withdrawn
    found = json.loads((out / "comparison.json").read_text())
    assert found["changed"] is (None if withdrawn else True)
    assert (found["changes"] is None) == withdrawn
    if trust is Trust.DOUBTFUL:
        assert found["changes"][0]["probability"] <= 0.6
        assert "changed, if the scan is right (40 % likely wrong)" in shown
    assert geraf2.compare(packed, [packed], write=False).verdict is None


def test_a_material_of_a_doubtful_scan_is_named_only_if_it_stays_certain():
    metal = replace(
        UNKNOWN,
        kind="metal",
        metal_probability=0.99,
        reflectivity_db=Measured(value=-2.0, sigma=1.0),
    )
    assert metal.weighed(1.0) == metal
    assert metal.weighed(0.97).kind == "metal"
    assert metal.weighed(0.6).kind == NOT_DETERMINED
    assert metal.weighed(0.0) == UNKNOWN
