import json

import numpy as np
import pytest

import geraf2
from geraf2.apps.planning import scan_time
from geraf2.cli.main import main
from geraf2.io.scan_file import read_scan_file

BOX = ["--box", "0.22", "0.22", "0.22"]
CHIRP = """
start_frequency_hz = 60.0e9
chirp_slope_hz_per_s = 70.0e12
sample_rate_hz = 200e3
n_samples = 8
"""


@pytest.fixture(scope="module", autouse=True)
def one_elevation():
    """Raised planes of one elevation are tried; tests/apps/planning tries all."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scan_time, "_RAISED_DEG", (40.0,))
        yield


@pytest.mark.usefixtures("drawn")
def test_a_plan_in_numbers_and_a_drawing(tmp_path, capsys):
    figure = tmp_path / "plan.png"
    assert main(["plan", *BOX, "--figure", str(figure)]) == 0
    shown = capsys.readouterr().out
    for text in ("0.39 m from the axis", "140 x 250 mm", "degrees of elevation, 1 above"):
        assert text in shown
    # What a ring of as many planes misses is that of the rings which are asked for.
    assert "in the same time sees 31 %: nothing that tilts by more than 18 degrees" in shown
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert main(["plan", *BOX, "--elevations-deg", "0"]) == 0
    shown = capsys.readouterr().out
    for text in ("3.30 mm", "36 around", "31 %: tilted by -18 to 18 degrees"):
        assert text in shown


def test_minutes_that_are_not_used_are_said_and_planes_look_at_the_content(tmp_path, capsys):
    scan = tmp_path / "scan.json"
    assert main(["plan", *BOX, "--minutes", "60", "--content", "0", "0.1", "--out", str(scan)]) == 0
    assert "about 30 minutes of the 60 minutes: no plan sees more" in capsys.readouterr().out
    planned = read_scan_file(scan)
    middles = [np.mean(planned.antennas(plane)[0], axis=0) for plane in planned.planes]
    assert min(m[2] for m in middles) == pytest.approx(0.05 - 0.11, abs=0.002)
    looks = [m + np.asarray(p.axes[0]) * 0.39 for m, p in zip(middles, planned.planes, strict=True)]
    assert np.asarray(looks) == pytest.approx(np.tile([0, 0, -0.06], (len(looks), 1)), abs=0.004)


def test_a_radar_of_ones_own_and_what_is_wrong_with_the_plan(tmp_path, capsys):
    (tmp_path / "radar.toml").write_text(CHIRP)
    arguments = ["--radar", str(tmp_path / "radar.toml"), "--spacing", "0.008", "--planes", "6"]
    assert main(["plan", *BOX, *arguments, "--aperture", "0.06", "0.2"]) == 0
    shown = capsys.readouterr()
    assert "60 GHz + 2.8 GHz" in shown.out
    for text in ("too coarse", "beyond the unambiguous range", "80 mm", "normals that none sees"):
        assert text in shown.err


def test_a_single_plane_without_a_box(tmp_path, capsys):
    assert main(["plan", "--depth", "0.2"]) == 0
    shown, warned = capsys.readouterr()
    for text in ("200 x 200 mm", "1.30 mm, at most 1.34", "154 rows of 154", "1.9 x 1.9 mm across"):
        assert text in shown
    assert not warned
    assert "normals" not in shown
    (tmp_path / "radar.toml").write_text(CHIRP.replace("n_samples = 8", "n_samples = 1"))
    radar = ["--radar", str(tmp_path / "radar.toml")]
    arguments = ["--depth", "5", "--aperture", "0.2", "0.1", "--spacing", "0.04", *radar]
    assert main(["plan", *arguments]) == 0
    shown, warned = capsys.readouterr()
    assert "60 GHz, wavelength 5.00 mm, no ranges" in shown
    for text in ("too coarse", "measures no depth"):
        assert text in warned
    assert "unambiguous" not in warned


@pytest.mark.parametrize(
    ("flags", "texts"),
    [
        (["--array", "awr1843"], ["12 at once\n", "Of --preset fast, for metal objects"]),
        (["--preset", "awr1843", "--channels", "2"], ["2 at once\n"]),
        ([], ["1 at once; --channels or --array names more"]),
        (["--box", "0.5", "0.5", "0.5", "--max-elevation-deg", "0"], ["unknown: "]),
    ],
)
def test_a_plan_names_its_board_and_what_its_forecast_holds_for(flags, texts, capsys):
    assert main(["plan", *BOX, "--minutes", "5", *flags]) == 0
    shown = capsys.readouterr().out
    for text in texts:
        assert text in shown


def test_a_plan_in_minutes_is_simulated_and_explained(tmp_path, capsys):
    scan, scene = tmp_path / "scan.json", tmp_path / "scene"
    arm = ["--channels", "8", "--speed-m-per-s", "0.1"]
    size = ["--aperture", "0.06", "0.06", "--spacing", "0.01", "--max-elevation-deg", "50"]
    assert main(["plan", *BOX, "--minutes", "0.25", *arm, *size, "--out", str(scan)]) == 0
    shown = capsys.readouterr().out
    for text in ("around the box", "every 10 mm, at 0.1 m/s", "8 at once", "expected", str(scan)):
        assert text in shown
    (tmp_path / "spec.toml").write_text(
        "[figure]\nname = 'hammer'\nheight_m = 0.05\n[numerics]\nwall_patch_m = 0.02\n"
        "[[walls]]\nsize_m = [0.2, 0.2, 0.2]\n"
    )
    spec = [str(tmp_path / "spec.toml"), str(scene)]
    assert main(["simulate", *spec, "--scan", str(scan)]) == 0
    poses, planned = geraf2.load_capture(scene).poses, read_scan_file(scan)
    for pose, plane in zip(poses, planned.planes, strict=True):
        assert np.array_equal(pose.tx_positions, planned.antennas(plane)[0])
    capsys.readouterr()
    assert main(["plan", "--like", str(scene), *arm]) == 0
    like = capsys.readouterr().out
    assert f"{len(poses)}: " in like
    assert "normals seen" in like


def test_an_array_of_ones_own_and_a_slow_table(tmp_path, capsys):
    """Two receivers 2 cm apart, in turns of two transmitters: 4 channels, a line 24 mm high."""
    radar = tmp_path / "radar.toml"
    radar.write_text(
        CHIRP.replace("n_samples = 8", "n_samples = 32")
        + "[antennas]\ntx_offsets_m = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.04]]\n"
        "rx_offsets_m = [[0.0, 0.005, 0.0], [0.0, 0.005, 0.02]]\n"
    )
    arguments = ["--minutes", "20", "--radar", str(radar), "--out", str(tmp_path / "scan.json")]
    assert main(["plan", *BOX, *arguments, "--max-elevation-deg", "0", "--spacing", "0.004"]) == 0
    assert "4 at once" in capsys.readouterr().out
    scan = read_scan_file(tmp_path / "scan.json")
    assert scan.array.rx_offsets_m == ((0.0, 0.005, 0.0), (0.0, 0.005, 0.02))
    assert scan.array.n_channels == 4
    slow = ["--turn-s", "60", "--settle-s", "0.5", "--channels", "8"]
    assert main(["plan", *BOX, "--minutes", "3", *slow]) == 2
    error = capsys.readouterr().err
    assert "no plan can be reached in the time" in error
    # Three planes of 7 lines of 36 positions, half a second and 3 ms each, and 172 mm each at 0.2
    # m/s; two turns of a minute.
    least = float(error.split("at least ")[1].split(" ")[0])
    assert least == pytest.approx((3 * 7 * (36 * 0.503 + 0.86) + 2 * 60) / 60, abs=0.01)


@pytest.mark.parametrize(
    ("flags", "texts", "known"),
    [
        (["--minutes", "5", "--channels", "8"], [], {"n_channels": 8, "aperture_m": [0.14, 0.25]}),
        (["--elevations-deg", "0", "30"], [], {"elevations_deg": [0, 30], "standoff_m": 0.39}),
        (["--depth", "0.2"], [], {"depth_m": 0.2, "aperture_m": [0.2, 0.2]}),
        (["--minutes", "5", "--out", "scan.csv"], ["scan_file"], {"scan_file": "scan.csv"}),
    ],
)
def test_a_plan_has_numbers_in_si_units(flags, texts, known, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    box = [] if "--depth" in flags else BOX
    assert main(["plan", *box, *flags, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert known.items() <= found.items()
    assert found["waveform"]["start_frequency_hz"] == 77.3704e9
    numbers = {k: v for k, v in found.items() if k not in {"command", "warnings", *texts}}
    assert not [name for name, value in numbers.items() if isinstance(value, str)]
