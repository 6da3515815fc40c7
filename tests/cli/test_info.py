import json
import shlex
from dataclasses import replace

import numpy as np
import pytest

from geraf2.cli.main import main
from geraf2.report import overview
from geraf2.scene import Wall, save_capture
from helpers.synthetic import point_capture

WALL = Wall(size_m=(0.22, 0.22, 0.22), thickness_m=0.004, permittivity=1.6)


def show(capture, tmp_path, capsys, *, code=0):
    save_capture(capture, tmp_path / "scene")
    assert main(["info", str(tmp_path / "scene")]) == code
    return capsys.readouterr()


def test_what_is_in_a_scene(tmp_path, capsys):
    shown = show(replace(point_capture(4), walls=(WALL,)), tmp_path, capsys).out
    for text in (
        "planes                   4",
        "antennas                 144 (36 per plane)",
        "samples                  32",
        "41.7 mm",
        "1.34 m",
        "30 x 30 mm",
        "6.00 mm, coarser than the Nyquist spacing 3.45 mm of a scene 0.22 m wide",
        "from 0.400 m",
        "220 x 220 x 220 mm, 4 mm thick, permittivity 1.6",
        "GiB on",
    ):
        assert text in shown


def scaled(capture, factor):
    poses = tuple(
        replace(p, tx_positions=factor * p.tx_positions, rx_positions=factor * p.rx_positions)
        for p in capture.poses
    )
    return replace(capture, poses=poses)


def with_first_signal(capture, change):
    first = capture.poses[0]
    changed = replace(first, signal=change(first.signal.copy()))
    return replace(capture, poses=(changed, *capture.poses[1:]))


def lost(signal):
    signal[20:30] = 0
    return signal


def with_offset(signal):
    return signal + np.float32(0.5 * np.abs(signal).max())


def with_bursts(signal):
    """A short pulse in every hundredth recording, as of another radar's chirp."""
    rng = np.random.default_rng(0)
    signal[50::100, 7] += 60.0
    return (signal + 0.1 * rng.standard_normal(signal.shape)).astype(np.complex64)


@pytest.mark.usefixtures("drawn")
def test_one_picture_of_the_scan(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(overview, "_N_VOXELS", 12)
    capture = replace(with_first_signal(point_capture(4, n_side=12), lost), walls=(WALL,))
    save_capture(capture, tmp_path / "scene")
    path = tmp_path / "scan.png"
    assert main(["info", str(tmp_path / "scene"), "--figure", str(path), "--threads", "1"]) == 0
    shown = capsys.readouterr()
    assert f"picture  {path}" in shown.out
    assert "normals seen" in shown.out
    assert "10 antennas have a constant signal" in shown.err
    assert path.read_bytes().startswith(b"\x89PNG")


def of_30(change):
    return lambda _: with_first_signal(point_capture(2, n_side=30), change)


def clip(signal):
    limit = 0.3 * float(np.abs(signal).max())
    return (np.clip(signal.real, -limit, limit) + 1j * np.clip(signal.imag, -limit, limit)).astype(
        np.complex64
    )


def delayed(signal):
    """A path longer by five range cells."""
    return signal * np.exp(-2j * np.pi * 10 / signal.shape[1] * np.arange(signal.shape[1]))


def walled(capture, path_bias_m=None):
    wall = replace(WALL, size_m=(0.1, 0.1, 0.1))
    bias = capture.waveform.path_bias_m if path_bias_m is None else path_bias_m
    waveform = replace(capture.waveform, path_bias_m=bias)
    return replace(capture, walls=(wall,), waveform=waveform)


def silenced(capture):
    rng = np.random.default_rng(0)

    def noise(pose):
        parts = rng.standard_normal((2, *pose.signal.shape))
        return replace(pose, signal=(parts[0] + 1j * parts[1]).astype(np.complex64))

    return replace(walled(capture), poses=tuple(noise(pose) for pose in capture.poses))


CASES = {
    "moved": (
        lambda c: with_first_signal(c, lambda s: delayed(s).astype(np.complex64)),
        "the echoes of 1 planes lie up to 0.42 m nearer or farther than those of the others",
    ),
    "delay": (
        lambda c: walled(c, c.waveform.path_bias_m - 0.8),
        "outside the ranges of the stated box, 0.31 to 0.49 m",
    ),
    "empty": (silenced, "the box is empty or not there; check path_bias_m"),
    "nothing": (lambda _: point_capture(4, spacing_m=0.003), ""),
    "centimetres": (lambda c: scaled(c, 1e2), "if they are in centimetres"),
    "constant": (lambda c: with_first_signal(c, np.zeros_like), "signal is constant in 1 planes"),
    "saturated": (lambda c: with_first_signal(c, clip), "1 planes look saturated"),
    "offset": (of_30(with_offset), "1 planes have a constant offset (DC) of up to"),
    "bursts": (of_30(with_bursts), "9 antennas are 10 dB noisier than those around them"),
    "loud": (lambda c: with_first_signal(c, lambda s: 100 * s), "more than 20 dB off"),
    "duplicate": (lambda c: replace(c, poses=(*c.poses, c.poses[0])), "hold the same samples"),
    "looking away": (
        lambda c: replace(c, poses=(replace(c.poses[0], axes=-c.poses[0].axes), *c.poses[1:])),
        "1 planes do not look at the point",
    ),
    "no delay": (
        lambda c: replace(c, waveform=replace(c.waveform, path_bias_m=0.0)),
        "path_bias_m) is 0",
    ),
    "no poses": (lambda c: replace(c, poses=()), "the scene has no planes"),
}


@pytest.mark.parametrize("name", CASES)
def test_only_what_is_implausible_is_reported(tmp_path, capsys, name):
    change, text = CASES[name]
    is_error = name in ("centimetres", "no poses")
    findings = show(change(point_capture(4)), tmp_path, capsys, code=2 * is_error).err
    assert text in findings
    assert findings.count("error: ") == is_error
    # So few planes see little. An offset of one of two moves the point that both look at.
    unseen = ("no antenna looks at", "most of a surface would be", "all antennas: surfaces")
    lines = [line for line in findings.splitlines() if not any(part in line for part in unseen)]
    assert len(lines) == (text != "") + (name == "offset")


def test_what_the_scan_cannot_see_is_named_and_in_the_json(tmp_path, capsys):
    tall = replace(WALL, size_m=(0.22, 0.22, 0.44))
    save_capture(replace(point_capture(12, n_side=24), walls=(tall,)), tmp_path / "scene")
    assert main(["info", str(tmp_path / "scene"), "--json"]) == 0
    shown = capsys.readouterr()
    assert "content between z = -216 and -69 mm lies below all antennas" in shown.err
    found = json.loads(shown.out)
    assert found["walls"][0]["size_m"] == [0.22, 0.22, 0.44]
    hidden = np.array(found["coverage"]["heights_out_of_sight_m"])
    assert hidden == pytest.approx(np.array([[-0.216, -0.069], [0.069, 0.216]]), abs=1e-4)
    assert "scan 147 mm more at the top" in found["warnings"][-1]


def test_a_run_prints_what_it_found_and_the_next_command(finished_run, capsys):
    assert main(["info", str(finished_run)]) == 0
    shown = capsys.readouterr().out
    for text in ("run of scene", "found", "typical error", f"geraf2 view {finished_run}"):
        assert text in shown
    record = json.loads((finished_run / "run.json").read_text())
    del record["stages"]["mesh"]
    (finished_run / "run.json").write_text(json.dumps(record))
    assert main(["info", str(finished_run)]) == 0
    assert f"geraf2 reconstruct SCENE {finished_run}" in capsys.readouterr().out


def test_commands_to_type_next_can_be_pasted_whatever_the_name(scene, tmp_path, capsys):
    odd = tmp_path / "my 'scan' <b>&1"
    odd.symlink_to(scene)
    assert main(["info", str(odd)]) == 0
    line = next(x for x in capsys.readouterr().out.splitlines() if x.startswith("next"))
    assert shlex.split(line)[1:] == ["geraf2", "reconstruct", str(odd), "out"]
