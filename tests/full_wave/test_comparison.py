"""Comparison of full-wave captures with physical optics, on captures of the simulator."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import geraf2
from geraf2.io.mesh import read_mesh, write_mesh
from geraf2.io.toml import write_toml
from geraf2.pipeline.commands.simulate import simulate_scene
from geraf2.scene.store import load_capture, save_capture
from geraf2.surfaces import FitConfig


@pytest.fixture(scope="module")
def captures(tmp_path_factory, wave):
    """A body whose capture is the simulator's own."""
    folder = tmp_path_factory.mktemp("captures") / "thing"
    folder.mkdir()
    spec = geraf2.examples.small_scene()
    simulate_scene(spec, folder / wave.comparison.SCENE_NAME)
    write_toml(folder / wave.comparison.TWIN_NAME, spec)
    return folder.parent


def test_equal_captures_have_equal_scores_and_no_difference(captures, tmp_path, wave, monkeypatch):
    monkeypatch.setattr(wave.comparison, "_SPACING_M", 0.008)
    few = partial(wave.comparison.evaluate, n_samples=1000)
    monkeypatch.setattr(wave.comparison, "evaluate", few)
    coarse = geraf2.FastPreset(fit=FitConfig(spacing_m=0.006))
    monkeypatch.setattr(wave.comparison, "preset_type", lambda _: lambda: coarse)
    folders = wave.comparison.bodies(captures)
    table = wave.comparison.compare(folders, ["fast"], tmp_path)
    header, full, own, _, heat_header, heat = table
    assert header.startswith("body")
    assert full.split()[:4] == ["thing", "fast", "full", "wave"]
    assert own.split()[:4] == ["thing", "fast", "physical", "optics"]
    assert full.split()[4:] == own.split()[4:]
    assert float(full.split()[4]) > 0.8
    assert heat_header.startswith("heat maps")
    assert float(heat.split()[1]) < -80
    result = next(tmp_path.glob("runs/thing-full-wave-fast/result.json"))
    before = result.stat().st_mtime_ns
    assert wave.comparison.compare(folders, ["fast"], tmp_path) == table
    assert result.stat().st_mtime_ns == before  # what is done is kept


def test_a_heat_map_differs_where_a_scatterer_was_added(captures, tmp_path, wave):
    scene = captures / "thing" / wave.comparison.SCENE_NAME
    capture, truth = load_capture(scene), read_mesh(scene / "truth.ply")
    beside = np.array([0.0, 0.0, truth.vertices[:, 2].max() + 0.008])
    k = 2 * np.pi * capture.waveform.frequencies_hz / 299792458.0
    poses = []
    for pose in capture.poses:
        path = np.linalg.norm(pose.tx_positions - beside, axis=1)
        path += np.linalg.norm(pose.rx_positions - beside, axis=1) + capture.waveform.path_bias_m
        echo = np.exp(-1j * k * path[:, None]).astype(np.complex64)
        poses.append(replace(pose, signal=pose.signal + echo))
    changed = tmp_path / "scene"
    save_capture(
        replace(capture, poses=tuple(poses)),
        changed,
        extras=lambda folder: write_mesh(truth, folder / "truth.ply"),
    )
    same = wave.comparison.heat_difference(scene, scene)
    heat = wave.comparison.heat_difference(changed, scene)
    assert same.difference_db < -60
    assert heat.difference_db > -15
    assert heat.outside_share > 0.5
    assert np.linalg.norm(np.array(heat.at_m) - beside) < 0.004
