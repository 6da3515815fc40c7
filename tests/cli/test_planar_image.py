"""A planar scan without a box, imported and imaged by one command each."""

import json

import numpy as np
import pytest

from geraf2.cli.main import main
from geraf2.report import overview
from geraf2.scene import Capture, load_capture, save_capture
from helpers.planar_scan import LETTER, TARGETS, letter_pose, write_hologram, write_planar


def imaged(source, tmp_path, *flags):
    assert main(["import", "planar", str(source), str(tmp_path / "scene")]) == 0
    assert main(["image", str(tmp_path / "scene"), str(tmp_path / "out"), *flags]) == 0
    about = json.loads((tmp_path / "out" / "image.json").read_text())
    return np.load(tmp_path / "out" / "image.npz"), about


def sharpest(stored, about):
    """Power of the sharpest slice, and its axes [m]."""
    power = stored["volume"][int(np.argmax(about["sharpness"]))].astype(float) ** 2
    axes = zip(stored["origin_m"][1:], power.shape, strict=True)
    return power, *(start + stored["spacing_m"] * np.arange(n) for start, n in axes)


@pytest.mark.usefixtures("drawn")
def test_points_before_a_flat_sheet_are_sharp_at_their_depth(tmp_path, capsys):
    source = write_planar(tmp_path / "scan", flat=30.0)
    flags = ["--depth-m", "0.06", "0.12", "--extent-m", "0.05", "0.04", "--spacing-m", "0.002"]
    stored, about = imaged(source, tmp_path, *flags, "--angles-deg", "10", "60")
    shown, warned = capsys.readouterr()
    assert "sharpest depth" in shown
    assert "searching" not in warned
    assert about["sharpest_depth_m"] == pytest.approx(0.09, abs=0.004)
    assert stored["volume"].shape == (31, 26, 21)
    best = int(np.argmax(about["sharpness"]))
    peak = np.unravel_index(stored["volume"][best].argmax(), (26, 21))
    position = stored["origin_m"][1:] + 0.002 * np.array(peak)
    assert np.abs(TARGETS[:, :2] - position).max(axis=1).min() <= 0.003
    assert (tmp_path / "out" / "figures" / "depth.png").stat().st_size > 1000


def test_info_copes_with_a_scene_without_a_box(tmp_path, capsys):
    source = write_planar(tmp_path / "scan")
    assert main(["import", "planar", str(source), str(tmp_path / "scene")]) == 0
    assert main(["info", str(tmp_path / "scene")]) == 0
    printed, warned = capsys.readouterr()
    printed = " ".join(printed.split())
    assert " 90 x 72 mm (horizontal x vertical)" in printed
    assert "plane looks along (1, 0, 0)" in printed
    assert "mm in depth, 0.09 m away" in printed
    for text in ("wall", "normals", "reconstruct"):
        assert text not in printed
    # The phase of the antenna was measured with its delay.
    assert "warning" not in warned


@pytest.mark.parametrize("frequencies", [np.linspace(22e9, 22.5e9, 6), 22.3e9])
def test_a_letter_is_seen_without_a_flag(tmp_path, capsys, frequencies):
    source = write_hologram(tmp_path / "letter.npy", frequencies=frequencies)
    stored, about = imaged(source, tmp_path)
    shown, warned = capsys.readouterr()
    assert "phase sign        exp(+j...), conjugated on import: the image 0.09" in shown
    assert "delay (waveform" not in warned
    assert "searching the depth" in warned
    # To a quarter of the depth of focus, two wavelengths.
    assert about["sharpest_depth_m"] == pytest.approx(0.1, abs=0.007)
    assert load_capture(tmp_path / "scene").provenance["phase_sign"] == "+1"
    # What is bright is the letter, to the 6.8 mm that this plane resolves, and all of it.
    power, y, z = sharpest(stored, about)
    off = np.hypot(y[:, None, None] - LETTER[:, 0], z[:, None] - LETTER[:, 1])
    assert off.min(axis=-1)[power > 0.25 * power.max()].max() < 0.0085
    bright = [power[off[..., number] < 0.006].max() for number in range(len(LETTER))]
    assert min(bright) > 0.25 * power.max()


@pytest.mark.usefixtures("drawn")
def test_a_scene_of_one_frequency_has_no_ranges(tmp_path, capsys, monkeypatch):
    source = write_hologram(tmp_path / "letter.npy", frequencies=22.3e9)
    assert main(["import", "planar", str(source), str(tmp_path / "scene")]) == 0
    assert main(["info", str(tmp_path / "scene")]) == 0
    shown = capsys.readouterr().out
    assert "none: one frequency" in shown
    assert " 22.3 GHz, wavelength 13.44 mm" in shown
    assert "unambiguous" not in shown
    figure = tmp_path / "figure.png"
    monkeypatch.setattr(overview, "_N_VOXELS", 12)
    assert main(["info", str(tmp_path / "scene"), "--figure", str(figure)]) == 0
    assert figure.stat().st_size > 1000


def test_the_sign_can_be_forced(tmp_path, capsys):
    source = write_hologram(tmp_path / "letter.npy")
    command = ["import", "planar", str(source), str(tmp_path / "scene"), "--phase-sign"]
    assert main([*command, "-1"]) == 0
    shown, warned = capsys.readouterr()
    assert "exp(-j...): as given" in shown
    assert "that --phase-sign does not have; --phase-sign +1 takes that one" in warned
    forced = load_capture(tmp_path / "scene")
    assert forced.provenance["phase_sign"] == "-1"
    assert main([*command, "+1", "--overwrite"]) == 0
    other = load_capture(tmp_path / "scene")
    assert np.array_equal(other.poses[0].signal, forced.poses[0].signal.conj())


def one_frequency(positions):
    """The letter 0.1 m before antennas anywhere, as a capture."""
    pose, waveform = letter_pose(positions, slope_hz_per_s=1e12)
    return Capture(waveform=waveform, poses=(pose,))


def test_antennas_on_no_raster_are_imaged_over_all_depths(tmp_path, capsys):
    positions = np.zeros((700, 3))
    positions[:, 1:] = np.random.default_rng(0).uniform(-0.062, 0.062, (700, 2))
    save_capture(one_frequency(positions), tmp_path / "scene")
    assert main(["image", str(tmp_path / "scene"), str(tmp_path / "out")]) == 0
    about = json.loads((tmp_path / "out" / "image.json").read_text())
    assert about["depths_m"][0] == pytest.approx(0.031, abs=0.004)
    assert about["depths_m"][-1] == pytest.approx(0.248, abs=0.004)
    assert "searched_depth_m" not in about
    assert about["sharpest_depth_m"] == pytest.approx(0.1, abs=0.01)


def test_a_line_of_one_frequency_gives_no_range(tmp_path, capsys):
    positions = np.zeros((50, 3))
    positions[:, 1] = 0.003 * np.arange(50)
    save_capture(one_frequency(positions), tmp_path / "scene")
    assert main(["image", str(tmp_path / "scene"), str(tmp_path / "out")]) == 2
    assert "one frequency gives no range; give --depth-m" in capsys.readouterr().err
    figure = ["--figure", str(tmp_path / "figure.png")]
    assert main(["info", str(tmp_path / "scene"), *figure]) == 2
    assert "has one frequency, no ranges and no plane to draw" in capsys.readouterr().err


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
    power, y, z = sharpest(stored, about)
    # A frame of 80 x 85 mm: nearly all power lies in it, and little around it.
    inside = (np.abs(y[:, None] + 0.068) < 0.052) & (np.abs(z - 0.005) < 0.052)
    assert power[inside].sum() > 0.9 * power.sum()


@pytest.mark.data
def test_the_real_letter_is_seen_without_a_flag(tmp_path, shared_data, capsys):
    stored, about = imaged(shared_data / "letter_r_22ghz", tmp_path)
    assert "exp(+j...), conjugated on import: the image 0.2" in capsys.readouterr().out
    # Another program's propagation of these samples is sharpest at 0.208 to 0.212 m, 7.6.
    assert 0.205 <= about["sharpest_depth_m"] <= 0.215
    assert max(about["sharpness"]) > 7
    power, y, z = sharpest(stored, about)
    # The stem of the R, 100 mm long and 10 wide at -29 mm, against the strip beyond it.
    stem = power[(y > -0.06) & (y < 0.045)][:, np.abs(z + 0.029) < 0.005].mean(axis=1)
    beyond = power[(y > -0.06) & (y < 0.045)][:, (z > -0.075) & (z < -0.05)]
    assert (stem > 4 * beyond.mean()).mean() > 0.95
