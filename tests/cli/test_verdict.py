"""How each command tells how far a result can be trusted, and what it no longer states then."""

import json

import pytest

import geraf2
from geraf2.apps.batch.folder import JobResult
from geraf2.cli import batch
from geraf2.cli.main import main
from geraf2.io.run_folder import RunFolder
from geraf2.io.verdict import WITHDRAWN, Trust
from geraf2.surfaces.samples import size_lines
from helpers.run_folders import CAUSE, VERDICTS, judge
from helpers.small_scene import BOX, FAST

WHY = f"not determined, because {CAUSE.text}"
LAST = {
    Trust.RELIABLE: ["verdict  reliable (less than 1 % likely wrong)"],
    Trust.DOUBTFUL: [
        "verdict  doubtful (40 % likely wrong)",
        f"because  {CAUSE.text}",
        f"do       {CAUSE.action}",
    ],
    Trust.NOT_TO_BE_TRUSTED: [
        "verdict  not to be trusted (97 % likely wrong)",
        f"because  {CAUSE.text}",
        f"do       {CAUSE.action}",
    ],
}


def code_of(trust, strict):
    return 3 if strict and trust is Trust.NOT_TO_BE_TRUSTED else 0


@pytest.mark.parametrize("trust", Trust)
def test_a_run_ends_with_its_verdict(finished_run, capsys, trust):
    judge(finished_run, trust)
    assert main(["info", str(finished_run)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-len(LAST[trust]) :] == LAST[trust]
    error = next(line for line in lines if line.startswith("typical error"))
    withdrawn = trust is Trust.NOT_TO_BE_TRUSTED
    assert (WHY in error) == withdrawn
    assert error.endswith(", if the scan is right (40 % likely wrong)") == (trust is Trust.DOUBTFUL)
    assert main(["info", str(finished_run), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["verdict"]["verdict"] == str(trust)
    assert (found["expected_error_median_m"] is None) == withdrawn
    assert found.get("not_determined") == (CAUSE.text if withdrawn else None)
    assert (found["stated_f1_5mm"] is None) == withdrawn
    numbers = geraf2.load_run(finished_run).numbers
    assert ("expected_error_median_mm" in numbers["mesh"]) != withdrawn
    assert numbers["mesh"]["n_pieces"] == found["n_pieces"] > 0


def test_strict_is_an_exit_code_of_a_reconstruction(scene, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(RunFolder, "verdict", property(lambda _: VERDICTS[Trust.NOT_TO_BE_TRUSTED]))
    flags = [*BOX, *FAST, "--no-report", "--calibrate", "no", "--strict"]
    assert main(["reconstruct", str(scene), str(tmp_path / "out"), *flags]) == 3
    assert capsys.readouterr().out.splitlines()[-3:] == LAST[Trust.NOT_TO_BE_TRUSTED]


@pytest.mark.parametrize("strict", [False, True])
@pytest.mark.parametrize("trust", Trust)
def test_a_batch_counts_verdicts(tmp_path, monkeypatch, capsys, trust, strict):
    results = [
        JobResult(key=name, scene=name, preset="best", state="done", verdict=str(kind))
        for name, kind in (("one", Trust.RELIABLE), ("two", trust))
    ]
    monkeypatch.setattr(batch, "read_jobs", lambda *_, **__: [])
    monkeypatch.setattr(batch, "run", lambda *_, **__: results)
    command = ["batch", "scans", str(tmp_path / "out"), *["--strict"] * strict]
    assert main(command) == code_of(trust, strict)
    counts = [1 + (trust is Trust.RELIABLE), trust is Trust.DOUBTFUL, code_of(trust, True) == 3]
    text = ", ".join(f"{count:d} {kind}" for count, kind in zip(counts, Trust, strict=True))
    assert f"verdicts  {text}" in capsys.readouterr().out


def test_an_interval_holds_as_often_as_the_run_is_right_and_is_none_above_its_quantity():
    numbers = {
        "volume_cm3": 100.0,
        "volume_95_percent_cm3": [90.0, 110.0],
        "extents_mm": [0.8, 50.0, 60.0],
        "extents_95_percent_mm": [[-1997.9, 1999.5], [49.0, 51.0], [58.0, 62.0]],
        "common_offset_sigma_mm": 0.3,
    }
    sizes, volume, _ = (text for _, text in size_lines(numbers, 0.6))
    assert sizes == "not determined x 50.0 ± 1.0 x 60.0 ± 2.0 mm (57 %)"
    assert volume == "100.0 ± 10.0 cm^3 (57 %)"
    assert "volume_95_percent_cm3" in WITHDRAWN
