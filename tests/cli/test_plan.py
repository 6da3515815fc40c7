import pytest

from geraf2.cli.main import main
from geraf2.report import canvas

BOX = ["--box", "0.22", "0.22", "0.22"]
CHIRP = """
start_frequency_hz = 60.0e9
chirp_slope_hz_per_s = 70.0e12
sample_rate_hz = 200e3
n_samples = 8
"""


@pytest.fixture(autouse=True)
def _small_pictures(monkeypatch):
    monkeypatch.setattr(canvas, "_DPI", 40)


def test_a_plan_in_numbers_and_a_drawing(tmp_path, capsys):
    figure = tmp_path / "plan.png"
    assert main(["plan", *BOX, "--figure", str(figure)]) == 0
    shown = capsys.readouterr().out
    for text in (
        "0.39 m from the axis",
        "140 x 250 mm",
        "3.30 mm, at most 3.36 mm",
        "36 around, every 10.0 degrees, at 1 elevation\n",
        "minutes",
        "tilted by -18 to 18 degrees",
    ):
        assert text in shown
    assert figure.read_bytes().startswith(b"\x89PNG")


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
    for text in (
        "200 x 200 mm",
        "1.30 mm, at most 1.34 mm for a scene as wide as the plane: 154 rows of 154",
        "1.9 x 1.9 mm across, 8 mm in depth, 0.2 m away",
    ):
        assert text in shown
    assert not warned
    assert "normals" not in shown
    (tmp_path / "radar.toml").write_text(CHIRP.replace("n_samples = 8", "n_samples = 1"))
    radar = ["--radar", str(tmp_path / "radar.toml")]
    arguments = ["--depth", "5", "--aperture", "0.2", "0.1", "--spacing", "0.04", *radar]
    assert main(["plan", *arguments]) == 0
    shown, warned = capsys.readouterr()
    assert "60 GHz, wavelength 5.00 mm, no ranges" in shown
    for text in ("too coarse", "tells no depth"):
        assert text in warned
    assert "unambiguous" not in warned


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--box", "0.2", "0", "0.2"], "--box must be above 0, got 0.0"),
        ([], "give --box, or --depth of a single plane"),
        ([*BOX, "--depth", "0.2"], "--depth plans a single plane, without --box"),
        (["--depth", "0.2", "--planes", "3"], "without --planes"),
        (["--depth", "nan"], "--depth must be above 0"),
        (["--box", "220", "220", "220"], "--box must be at most 10"),
        ([*BOX, "--standoff", "0.1"], "the box would turn into the radar"),
        ([*BOX, "--standoff", "0"], "--standoff must be above 0"),
        ([*BOX, "--spacing", "nan"], "--spacing must be at least 0.0001"),
        ([*BOX, "--aperture", "0.1", "-1"], "--aperture must be above 0"),
        ([*BOX, "--planes", "0"], "--planes must be at least 1"),
        ([*BOX, "--elevations-deg", "95"], "--elevations-deg must be below 90"),
        ([*BOX, "--speed-m-per-s", "0"], "--speed-m-per-s must be above 0"),
        ([*BOX, "--radar", "absent.toml"], "no such file"),
        ([*BOX, "--radar", "RADAR"], "does not describe the chirp"),
        ([*BOX, "--radar", "RADAR", "--preset", "awr1843"], "give either --radar or --preset"),
    ],
)
def test_bad_input_is_one_line(tmp_path, capsys, arguments, message):
    (tmp_path / "radar.toml").write_text("n_samples = 32\n")
    named = [str(tmp_path / "radar.toml") if a == "RADAR" else a for a in arguments]
    assert main(["plan", *named]) == 2
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    assert message in error
