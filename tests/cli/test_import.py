"""Import from the command line: signs, faults, nothing left behind."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2 import examples
from geraf2.cli.main import main
from geraf2.scene import load_capture
from helpers.synthetic import CAPTURE_JSON, point_capture, write_geraf_sens


@pytest.fixture
def capture():
    return point_capture(4)


@pytest.fixture
def source(tmp_path, capture):
    return write_geraf_sens(tmp_path / "capture", capture)


def run_import(source, *more):
    return main(["import", "geraf-sens", str(source), str(source.parent / "scene"), *more])


@pytest.mark.parametrize("sign", ["-1", "+1"])
def test_a_capture_of_either_sign_becomes_the_same_scene(tmp_path, capture, capsys, sign):
    change = np.conj if sign == "+1" else np.array
    poses = tuple(replace(pose, signal=change(pose.signal)) for pose in capture.poses)
    source = write_geraf_sens(tmp_path / "capture", replace(capture, poses=poses))
    assert run_import(source) == 0
    assert ("conjugated on import" in capsys.readouterr().out) == (sign == "+1")
    loaded = load_capture(source.parent / "scene")
    assert loaded.provenance["phase_sign"] == sign
    assert "times the power" in loaded.provenance["phase_sign_evidence"]
    assert main(["info", str(source.parent / "scene")]) == 0
    assert f"phase sign exp({sign[0]}j...)" in " ".join(capsys.readouterr().out.split())
    for got, want in zip(loaded.poses, capture.poses, strict=True):
        assert np.array_equal(got.signal, want.signal)


def test_a_capture_of_the_other_sign_has_its_echoes_in_the_box(tmp_path, capsys):
    whole = examples.small_capture()[0]
    poses = tuple(replace(pose, signal=pose.signal.conj()) for pose in whole.poses)
    stated = {**CAPTURE_JSON, "box_size_m": list(examples.BOX_M)}
    capture = replace(whole, poses=poses)
    source = write_geraf_sens(tmp_path / "capture", capture, parameters=stated)
    assert run_import(source) == 0
    shown = capsys.readouterr()
    assert "conjugated on import" in shown.out
    assert "the box is empty" not in shown.err


def test_importing_again_changes_nothing_and_another_capture_is_refused(source, capture, capsys):
    assert run_import(source) == 0
    assert run_import(source) == 0
    assert "nothing changed" in capsys.readouterr().out
    louder = replace(capture, poses=tuple(replace(p, signal=2 * p.signal) for p in capture.poses))
    other = write_geraf_sens(source.parent / "other", louder)
    assert run_import(other) == 2
    assert "holds another scene" in capsys.readouterr().err
    assert np.array_equal(
        load_capture(source.parent / "scene").poses[0].signal, capture.poses[0].signal
    )
    assert run_import(other, "--overwrite") == 0


def test_a_delay_of_zero_that_is_given_is_not_warned_of(tmp_path, capture, capsys):
    for bias, warned in ((0.0, False), (None, True)):
        parameters = {**CAPTURE_JSON, "path_bias_m": bias}
        if bias is None:
            del parameters["path_bias_m"]
        source = write_geraf_sens(tmp_path / f"{bias}" / "capture", capture, parameters=parameters)
        assert run_import(source) == 0
        assert capsys.readouterr().err.count("delay") == warned
        assert main(["info", str(source.parent / "scene")]) == 0
        assert ("instrument delay (waveform.path_bias_m) is 0" in capsys.readouterr().err) == warned


def test_a_turntable_of_one_frequency_is_read(tmp_path, capture, capsys):
    poses = tuple(replace(pose, signal=pose.signal[:, :1]) for pose in capture.poses)
    start = {"start_frequency_hz": CAPTURE_JSON["start_frequency_hz"]}
    source = write_geraf_sens(tmp_path / "capture", replace(capture, poses=poses), parameters=start)
    assert run_import(source) == 0
    loaded = load_capture(source.parent / "scene")
    assert loaded.waveform.frequencies_hz == pytest.approx([77.3704e9])
    assert main(["info", str(source.parent / "scene")]) == 0
    shown = capsys.readouterr().out
    assert "none: one frequency" in shown
    assert "from 0.400 m" in shown
