from dataclasses import replace

import numpy as np
import pytest

import geraf2
from geraf2.calibration.channel_phase import interleaved_channels, with_channel_phases
from geraf2.io.run_folder import CALIBRATION_NAME, RunFolder
from geraf2.pipeline.stages.calibration import correct_capture
from geraf2.surfaces import FitConfig
from helpers.carton import PRIOR, carton_capture

COARSE = geraf2.FastPreset(fit=FitConfig(spacing_m=0.02))


@pytest.fixture(scope="module")
def capture():
    return carton_capture(n_poses=6)


@pytest.fixture(scope="module")
def wrong(capture):
    channels = [interleaved_channels(pose, 4) for pose in capture.poses]
    wrong = with_channel_phases(capture, channels, np.deg2rad([-40.0, 35.0, 20.0, -15.0]))
    named = (replace(pose, angle_deg=60.0 * n) for n, pose in enumerate(wrong.poses))
    return replace(wrong, poses=tuple(named))


def run(capture, out, calibrate="auto"):
    held_out = () if capture.poses[0].angle_deg is None else (120.0,)
    options = geraf2.RunOptions(calibrate=calibrate, hold_out=held_out)
    return geraf2.reconstruct(capture, PRIOR, COARSE, out, options=options, overwrite=True)


def test_corrections_are_reported_stored_and_read_back(wrong, tmp_path):
    first = run(wrong, tmp_path / "out")
    stated, files = first.numbers["calibration"], dict(first.run.files)
    assert [text.split(":")[0] for text in stated["applied"]] == ["channels"]
    assert stated["channels_n"] == 4
    assert any("calibrated channels: 4 interleaved" in text for text in first.run.warnings)
    # planes that were left out, too
    seen = correct_capture(RunFolder.read(tmp_path / "out"), wrong)
    for one, other in zip(seen.poses, wrong.poses, strict=True):
        assert not np.allclose(one.signal, other.signal)
    # and switched off, the scan is as it is
    asked = run(wrong, tmp_path / "out", "no")
    assert "calibration" not in asked.run.stages
    assert not (tmp_path / "out" / CALIBRATION_NAME).exists()
    # with wrong phases this metal may be taken for plastic; nothing else is said of it
    assert all("the content is a dielectric" in text for text in asked.run.warnings)
    assert correct_capture(asked.run, wrong) is wrong
    assert asked.run.files["glints.npz"] != files["glints.npz"]


def test_without_errors_nothing_changes(capture, tmp_path):
    found, plain = run(capture, tmp_path / "auto"), run(capture, tmp_path / "no", "no")
    assert found.numbers["calibration"]["applied"] == []
    # Of a scan without errors, the walls' middles remain, one-way.
    assert 0.1 < found.numbers["calibration"]["common_offset_sigma_mm"] < 0.5
    # Files of meshes say which command made them.
    same = ("glints.npz", "peaks.ply", "sdf_fit.npz", "sdf.npz", "prior.npz")
    assert {n: found.run.files[n] for n in same} == {n: plain.run.files[n] for n in same}
    assert (found.content.vertices == plain.content.vertices).all()
