from dataclasses import replace

import numpy as np
import pytest

import geraf2
from geraf2.calibration.channel_phase import interleaved_channels, with_channel_phases
from geraf2.io.digests import file_digest
from geraf2.io.run_folder import CALIBRATION_NAME, RunFolder
from geraf2.pipeline.stages.calibration import corrected
from geraf2.surfaces import FitConfig
from helpers.carton import PRIOR, carton_capture

COARSE = geraf2.FastPreset(fit=FitConfig(spacing_m=0.02, distance_rounds=1))


@pytest.fixture(scope="module")
def capture():
    return carton_capture(n_poses=6)


@pytest.fixture(scope="module")
def wrong(capture):
    channels = [interleaved_channels(pose, 4) for pose in capture.poses]
    wrong = with_channel_phases(capture, channels, np.deg2rad([-40.0, 35.0, 20.0, -15.0]))
    named = (replace(pose, angle_deg=60.0 * n) for n, pose in enumerate(wrong.poses))
    return replace(wrong, poses=tuple(named))


def run(capture, out, calibrate="auto", *, resume=False):
    held_out = () if capture.poses[0].angle_deg is None else (120.0,)
    options = geraf2.RunOptions(calibrate=calibrate, hold_out=held_out)
    return geraf2.reconstruct(
        capture, PRIOR, COARSE, out, options=options, resume=resume, overwrite=True
    )


def digests(result):
    return {name: record.files for name, record in result.run.stages.items()}


def test_corrections_are_reported_stored_and_read_back(wrong, tmp_path):
    first = run(wrong, tmp_path / "out")
    stated = first.numbers["calibration"]
    assert [text.split(":")[0] for text in stated["applied"]] == ["channels"]
    assert stated["channels_n"] == 4
    assert any("calibrated channels: 4 interleaved" in text for text in first.run.warnings)
    # planes that were left out, too
    seen = corrected(RunFolder.read(tmp_path / "out"), wrong)
    for one, other in zip(seen.poses, wrong.poses, strict=True):
        assert not np.allclose(one.signal, other.signal)
    again = run(wrong, tmp_path / "out", resume=True)
    assert digests(again) == digests(first)
    assert again.run.warnings == first.run.warnings
    log = (tmp_path / "out" / "log.jsonl").read_text()
    assert log.count('"event": "reused"') == 4
    # and switched off, the scan is as it is
    asked = run(wrong, tmp_path / "out", "no", resume=True)
    assert "calibration" not in asked.run.stages
    assert not (tmp_path / "out" / CALIBRATION_NAME).exists()
    assert asked.run.warnings == []
    assert corrected(asked.run, wrong) is wrong
    assert digests(asked)["glints"] != digests(first)["glints"]


def test_without_errors_nothing_changes(capture, tmp_path):
    found, plain = run(capture, tmp_path / "auto"), run(capture, tmp_path / "no", "no")
    assert found.numbers["calibration"]["applied"] == []
    # Of a scan without errors, the walls' middles remain, one-way.
    assert 0.1 < found.numbers["calibration"]["common_offset_sigma_mm"] < 0.5
    kept, others = digests(found), digests(plain)
    del kept["calibration"]
    # Files of meshes say which command made them.
    (mesh, other), surfaces = (kept.pop("mesh"), others.pop("mesh")), (found.content, plain.content)
    assert kept == others
    assert mesh["sdf.npz"] == other["sdf.npz"]
    assert (surfaces[0].vertices == surfaces[1].vertices).all()
    keys = {name: found.run.stages[name].key for name in plain.run.stages}
    assert keys == {name: record.key for name, record in plain.run.stages.items()}
    assert file_digest(found.path / "prior.npz") == file_digest(plain.path / "prior.npz")


def test_a_box_without_echoes_is_refused_in_one_line(tmp_path):
    capture, _ = geraf2.examples.small_capture()
    tiny = geraf2.LosPrior.from_box((0.01, 0.01, 0.01))
    with pytest.raises(geraf2.UserError, match="the box does not contain the scene"):
        geraf2.reconstruct(capture, tiny, COARSE, tmp_path / "out")
