import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import zarr

from geraf2.errors import UserError
from geraf2.io import scene_writer
from geraf2.io.container import SceneReader, is_scene
from geraf2.io.scene_writer import SceneWriter
from geraf2.records import RawPose
from geraf2.scene import Wall
from geraf2.scene.store import capture_digest, load_capture, manifest_of, save_capture
from helpers.synthetic import point_capture, point_pose

WALL = Wall(size_m=(0.22, 0.2, 0.18), thickness_m=0.004, permittivity=1.6, center_m=(0, 0, 0.01))


@pytest.fixture
def ragged():
    poses = (point_pose(0.0, n_side=6), point_pose(90.0, n_side=4), point_pose(180.0, n_side=5))
    capture = replace(point_capture(), poses=poses, walls=(WALL,))
    return replace(capture, poses=(*poses[:2], replace(poses[2], angle_deg=None)))


@pytest.fixture
def scene(tmp_path, ragged):
    save_capture(ragged, tmp_path / "scene")
    return tmp_path / "scene"


def folder_names(path):
    return sorted(entry.name for entry in path.iterdir())


def test_the_digest_of_a_capture_survives_the_disk_and_sees_each_part(scene, ragged):
    digest, loaded = capture_digest(ragged), load_capture(scene)
    assert capture_digest(loaded) == digest
    assert loaded.provenance == ragged.provenance
    assert [pose.name for pose in loaded.poses] == [pose.name for pose in ragged.poses]
    assert loaded.poses[0].signal.dtype == np.complex64
    louder = replace(ragged.poses[0], signal=ragged.poses[0].signal * np.float32(1.001))
    changed = [
        replace(ragged, walls=()),
        replace(ragged, poses=ragged.poses[:2]),
        replace(ragged, poses=(louder, *ragged.poses[1:])),
        replace(ragged, waveform=replace(ragged.waveform, path_bias_m=0.1)),
    ]
    assert len({digest, *(capture_digest(c) for c in changed)}) == 5
    assert capture_digest(replace(ragged, provenance={"importer": "other"})) == digest


def without_checksums(scene):
    """As a version of geraf2 before them wrote it."""
    path = scene / "radar.zarr" / "zarr.json"
    content = json.loads(path.read_text())
    names = {*ARRAYS, "axes", "angle", "antenna_count"}
    assert set(content["attributes"].pop("checksums")) == names
    path.write_text(json.dumps(content))


ARRAYS = ("signal", "tx_positions", "rx_positions")


def test_a_lost_chunk_reads_as_nan_not_as_silence(scene):
    (scene / "radar.zarr" / "signal" / "c" / "1" / "0" / "0").unlink()
    with pytest.raises(UserError, match=r"signal of plane .* is not what was written"):
        SceneReader(scene).read_pose(1)
    without_checksums(scene)
    assert np.isnan(SceneReader(scene).read_pose(1).signal).all()


@pytest.mark.parametrize("name", ["signal", "axes", "name"])
def test_the_smallest_change_makes_another_scene(scene, ragged, monkeypatch, name):
    monkeypatch.setattr(scene_writer, "_CHUNK_BYTES", 8 * 32 * 5)
    last = ragged.poses[-1]
    value: object = "other"
    if name != "name":
        value = getattr(last, name).copy()
        value[-1, -1] = np.nextafter(value[-1, -1].real, np.float32(9), dtype=value.real.dtype)
    changed = replace(ragged, poses=(*ragged.poses[:-1], replace(last, **{name: value})))
    with pytest.raises(UserError, match="holds another scene"):
        save_capture(changed, scene)
    # The same content in other chunks is the same scene, and nothing changes.
    before = (scene / "scene.toml").stat().st_mtime_ns
    assert save_capture(ragged, scene) is False
    assert (scene / "scene.toml").stat().st_mtime_ns == before


def test_overwrite_replaces_a_scene_but_never_another_folder(scene, tmp_path):
    assert save_capture(point_capture(), scene, overwrite=True) is True
    assert len(load_capture(scene).poses) == 3
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "diary.txt").write_text("mine")
    with pytest.raises(UserError, match="holds files but no scene"):
        save_capture(point_capture(), tmp_path / "notes", overwrite=True)
    assert (tmp_path / "notes" / "diary.txt").read_text() == "mine"
    (tmp_path / "empty").mkdir()
    save_capture(point_capture(), tmp_path / "empty")
    assert is_scene(tmp_path / "empty")
    assert folder_names(tmp_path) == ["empty", "notes", "scene"]


def parts_of(pose, sizes):
    bounds = np.cumsum([0, *sizes])
    for first, stop in pairwise(bounds):
        chosen = slice(first, stop)
        yield replace(
            pose,
            signal=pose.signal[chosen],
            tx_positions=pose.tx_positions[chosen],
            rx_positions=pose.rx_positions[chosen],
        )


@pytest.mark.parametrize("sizes", [(1, 35), (7, 7, 7, 7, 7, 1), (12, 0, 24)])
def test_a_pose_may_come_in_parts(tmp_path, ragged, monkeypatch, sizes):
    save_capture(ragged, tmp_path / "whole")
    # Five antennas a chunk: poses end within chunks, and parts begin within them.
    monkeypatch.setattr(scene_writer, "_CHUNK_BYTES", 8 * 32 * 5)
    writer = SceneWriter(tmp_path / "parts", manifest_of(ragged), n_poses=3, n_antennas_max=36)
    with writer:
        for number, pose in enumerate(ragged.poses):
            for part in parts_of(pose, sizes) if number == 0 else [pose]:
                writer.append(part, n_antennas=pose.n_antennas)
    whole, parts = SceneReader(tmp_path / "whole"), SceneReader(tmp_path / "parts")
    assert whole.holds_same_poses(parts)
    assert parts.holds_same_poses(whole)
    assert capture_digest(load_capture(tmp_path / "parts")) == capture_digest(ragged)


@pytest.fixture
def scene_of_integers(tmp_path, ragged, monkeypatch):
    """Scene with five antennas a chunk, and the integers in it."""
    monkeypatch.setattr(scene_writer, "_CHUNK_BYTES", 4 * 32 * 5)
    rng = np.random.default_rng(1)
    integers = [
        rng.integers(-0x8000, 0x8000, (pose.n_antennas, 32, 2), dtype=np.int16)
        for pose in ragged.poses
    ]
    integers[0][3, 4] = (-0x8000, 5)
    writer = SceneWriter(
        tmp_path / "ints", manifest_of(ragged), n_poses=3, n_antennas_max=36, integers=True
    )
    with writer:
        for pose, samples in zip(ragged.poses, integers, strict=True):
            whole = RawPose(**{**vars(pose), "signal": samples})
            for part in parts_of(whole, (7, pose.n_antennas - 7)):
                writer.append(part, n_antennas=pose.n_antennas)
    return tmp_path / "ints", integers


def test_integers_are_stored_as_they_are_and_read_as_complex_numbers(scene_of_integers, ragged):
    path, integers = scene_of_integers
    for pose, samples, want in zip(load_capture(path).poses, integers, ragged.poses, strict=True):
        kept = np.clip(samples, -0x7FFF, None)
        assert pose.signal.dtype == np.complex64
        assert np.array_equal(pose.signal, kept[..., 0] + 1j * kept[..., 1])
        assert np.array_equal(pose.tx_positions, want.tx_positions)
        assert np.array_equal(pose.axes, want.axes)
    stored = zarr.open_group(str(path / "radar.zarr"), mode="r")["signal"]
    assert (stored.dtype, stored.shape, stored.chunks) == ("i2", (3, 36, 32, 2), (1, 5, 32, 2))
    assert stored.metadata.dimension_names == ("pose", "antenna", "sample", "part")
    # Padding is marked as such.
    assert (stored[1, 16:] == -0x8000).all()
    (path / "radar.zarr" / "signal" / "c" / "1" / "2" / "0" / "0").unlink()
    without_checksums(path)
    lost = np.isnan(SceneReader(path).read_pose(1).signal).all(axis=1)
    assert np.flatnonzero(lost).tolist() == [*range(10, 15)]
