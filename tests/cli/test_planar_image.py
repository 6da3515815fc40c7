"""A planar scan without a box, imported and imaged by one command each."""

import json

import numpy as np
import pytest

from geraf2.cli.main import main
from geraf2.scene import save_capture
from planar_scan import TARGETS, write_planar
from synthetic import point_capture


def imaged(source, tmp_path, *flags):
    assert main(["import", "planar", str(source), str(tmp_path / "scene")]) == 0
    assert main(["image", str(tmp_path / "scene"), str(tmp_path / "out"), *flags]) == 0
    about = json.loads((tmp_path / "out" / "image.json").read_text())
    return np.load(tmp_path / "out" / "image.npz"), about


def test_points_before_a_flat_sheet_are_sharp_at_their_depth(tmp_path, capsys):
    source = write_planar(tmp_path / "scan", flat=30.0)
    flags = ["--depth-m", "0.06", "0.12", "--extent-m", "0.05", "0.04", "--spacing-m", "0.002"]
    stored, about = imaged(source, tmp_path, *flags, "--angles-deg", "10", "60")
    assert "sharpest depth" in capsys.readouterr().out
    assert about["sharpest_depth_m"] == pytest.approx(0.09, abs=0.004)
    assert stored["volume"].shape == (31, 26, 21)
    best = int(np.argmax(about["sharpness"]))
    peak = np.unravel_index(stored["volume"][best].argmax(), (26, 21))
    place = stored["origin_m"][1:] + 0.002 * np.array(peak)
    assert np.abs(TARGETS[:, :2] - place).max(axis=1).min() <= 0.003
    assert (tmp_path / "out" / "figures" / "depth.png").stat().st_size > 10_000


def test_the_extent_is_that_of_the_antennas_when_not_given(tmp_path):
    stored, about = imaged(
        write_planar(tmp_path / "scan"), tmp_path, "--depth-m", "0.08", "0.1", "--spacing-m", "0.01"
    )
    assert stored["volume"].shape == (3, 10, 9)
    assert about["depths_m"] == pytest.approx([0.08, 0.09, 0.1])


def test_info_copes_with_a_scene_without_a_box(tmp_path, capsys):
    source = write_planar(tmp_path / "scan")
    assert main(["import", "planar", str(source), str(tmp_path / "scene")]) == 0
    assert main(["info", str(tmp_path / "scene")]) == 0
    printed = capsys.readouterr().out
    assert "aperture                 90 x 72 mm" in printed
    assert "wall" not in printed


@pytest.mark.parametrize(
    ("flags", "text"),
    [
        (["--depth-m", "0.1", "0.05"], "--depth-m must be two rising distances"),
        (["--depth-m", "0.1", "nan"], "--depth-m must be two rising distances"),
        (["--depth-m", "0.3", "0.5"], "--depth-m needs one pose, got 2; add --pose N"),
        (
            ["--depth-m", "0.3", "0.5", "--pose", "0", "--extent-m", "0", "1"],
            "--extent-m must be two positive",
        ),
        (
            ["--depth-m", "0.3", "0.5", "--pose", "0", "--size-m", "1", "1", "1"],
            "exclude each other",
        ),
        (["--angles-deg", "60", "10"], "--angles-deg must be two rising angles"),
        (["--angles-deg", "10", "91"], "--angles-deg must be two rising angles"),
    ],
)
def test_impossible_flags_are_named(tmp_path, capsys, flags, text):
    save_capture(point_capture(2), tmp_path / "s")
    assert main(["image", str(tmp_path / "s"), str(tmp_path / "out"), *flags]) == 2
    assert text in capsys.readouterr().err


@pytest.mark.data
@pytest.mark.slow
def test_the_real_square_is_sharp_at_its_depth(tmp_path, shared_data):
    stored, about = imaged(
        shared_data / "planar_22_26ghz",
        tmp_path,
        *["--depth-m", "0.07", "0.12", "--extent-m", "0.16", "0.16"],
        *["--center-m", "0", "-0.075", "0.01", "--angles-deg", "10", "60", "--spacing-m", "0.0025"],
    )
    # Another program's back-projection of these samples is sharpest at 0.0925 m.
    assert 0.085 <= about["sharpest_depth_m"] <= 0.1
    best = int(np.argmax(about["sharpness"]))
    power = stored["volume"][best].astype(float) ** 2
    y = stored["origin_m"][1] + 0.0025 * np.arange(power.shape[0])
    z = stored["origin_m"][2] + 0.0025 * np.arange(power.shape[1])
    # A frame of 80 x 85 mm: nearly all power lies in it, and little around it.
    inside = (np.abs(y[:, None] + 0.068) < 0.052) & (np.abs(z - 0.005) < 0.052)
    assert power[inside].sum() > 0.9 * power.sum()
