"""A volume in slabs: the bytes of the whole one, however often it was stopped."""

import errno
import json
import os
from dataclasses import replace

import numpy as np
import pytest
import zarr

from geraf2.cli.main import main
from geraf2.errors import UserError
from geraf2.imaging.volume import image_volume
from geraf2.io import atomic
from geraf2.pipeline.commands import image_tiles as tiles
from geraf2.pipeline.commands.image import ImageOptions, image_scene
from geraf2.scene import save_capture
from geraf2.scene.capture import LazyPoses
from geraf2.scene.store import capture_digest, load_capture, open_capture
from helpers.synthetic import TARGETS, point_capture

# 17 x 25 x 21 voxels: slabs along y, of 4 layers of 357 voxels, the last of one layer
OPTIONS = ImageOptions(
    size_m=(0.08, 0.12, 0.10), center_m=(0.0, 0.0, 0.0), spacing_m=0.005, slab_gib=1e-3
)


@pytest.fixture
def scene(tmp_path, monkeypatch):
    monkeypatch.setattr("geraf2.imaging.slabs.SLAB_BYTES_PER_VOXEL", 2.0**20 / (5 * 357))
    save_capture(point_capture(4, n_side=12, spacing_m=0.008, targets=TARGETS[:1]), tmp_path / "s")
    return tmp_path / "s"


def _volume(out):
    return zarr.open_group(str(out / "image.zarr"), mode="r")["volume"]


def test_memory_below_one_layer_is_refused(scene, tmp_path, monkeypatch):
    monkeypatch.setattr("geraf2.imaging.slabs.SLAB_BYTES_PER_VOXEL", 2.0**20)
    with pytest.raises(UserError, match=r"not even one layer .* raise slab_gib"):
        tiles.image_tiles(scene, tmp_path / "out", OPTIONS)


@pytest.mark.usefixtures("drawn")
def test_chunks_hold_the_bytes_of_the_whole_image(scene, tmp_path, monkeypatch):
    whole = image_scene(scene, tmp_path / "whole", OPTIONS)
    done, image_slab = [], tiles.image_slab

    def stopped(job, number, num_threads=None):
        if len(done) == 3:
            raise KeyboardInterrupt
        done.append(number)
        return image_slab(job, number, num_threads)

    monkeypatch.setattr(tiles, "image_slab", stopped)
    with pytest.raises(KeyboardInterrupt):
        tiles.image_tiles(scene, tmp_path / "tiles", OPTIONS)
    monkeypatch.setattr(tiles, "image_slab", image_slab)
    chunks = sorted((tmp_path / "tiles" / "image.zarr" / "volume" / "c").rglob("0"))
    kept = {p: p.stat().st_mtime_ns for p in chunks if p.is_file()}
    assert len(kept) == 3
    made = tiles.image_tiles(scene, tmp_path / "tiles", OPTIONS)
    assert {p: p.stat().st_mtime_ns for p in kept} == kept
    assert (len(made.slabs), made.n_done) == (7, 4)
    volume = _volume(tmp_path / "tiles")
    assert volume.chunks == (17, 4, 21)
    assert volume[:].tobytes() == whole.volume.tobytes()
    assert made.strongest_m == pytest.approx(whole.strongest_m)
    # Two images of one view: the pictures are the same, too.
    pictures = [tmp_path / name / "figures" / "projections.png" for name in ("whole", "tiles")]
    assert pictures[0].read_bytes() == pictures[1].read_bytes()
    # Each slab is that of the matched filter, to its rtol, however it is cut.
    one = image_volume(load_capture(scene), whole.grid)
    assert np.abs(one - whole.volume).max() <= 1e-3 * one.max()


def test_other_settings_need_consent_and_half_an_image_is_recognised(scene, tmp_path, capsys):
    out = tmp_path / "out"
    tiles.image_tiles(scene, out, OPTIONS)
    other = replace(OPTIONS, spacing_m=0.01)
    with pytest.raises(UserError, match="overwrite"):
        tiles.image_tiles(scene, out, other)
    assert _volume(out).shape == (17, 25, 21)
    assert tiles.image_tiles(scene, out, OPTIONS).n_done == 0
    assert tiles.image_tiles(scene, out, other, overwrite=True).n_done > 0
    assert _volume(out).shape == (9, 13, 11)
    attributes = json.loads((out / "image.zarr" / "zarr.json").read_text())["attributes"]
    assert (attributes["unit"], attributes["shape"]) == ("metre", [9, 13, 11])
    assert main(["verify", str(out)]) == 0
    assert main(["image", str(scene), str(out), "--scheduler", "tcp://127.0.0.1:9"]) == 2
    assert "--scheduler needs --tiles" in capsys.readouterr().err


def test_a_full_disk_leaves_whole_slabs_and_the_same_command_continues(
    scene, tmp_path, monkeypatch
):
    flush, out = atomic._flush, tmp_path / "out"

    def full(path):
        if path.parent.name == "2":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        flush(path)

    monkeypatch.setattr(atomic, "_flush", full)
    with pytest.raises(UserError, match="No space left"):
        tiles.image_tiles(scene, out, OPTIONS)
    files = [p for p in (out / "image.zarr").rglob("*") if p.is_file()]
    assert sorted(p.name for p in files) == ["0", "0", "zarr.json", "zarr.json"]
    monkeypatch.undo()
    monkeypatch.setattr("geraf2.imaging.slabs.SLAB_BYTES_PER_VOXEL", 2.0**20 / (5 * 357))
    assert tiles.image_tiles(scene, out, OPTIONS).n_done == 5


@pytest.mark.usefixtures("drawn")
def test_depths_of_one_pose_are_computed_from_slabs(scene, tmp_path):
    options = replace(OPTIONS, plane=0, depth_m=(0.3, 0.4), size_m=None, extent_m=(0.1, 0.06))
    whole = image_scene(scene, tmp_path / "whole", options)
    made = tiles.image_tiles(scene, tmp_path / "tiles", options)
    assert len(made.slabs) > 1
    np.testing.assert_allclose(made.sharpness, whole.sharpness, rtol=1e-6)
    pictures = [tmp_path / name / "figures" / "depth.png" for name in ("whole", "tiles")]
    assert pictures[0].read_bytes() == pictures[1].read_bytes()


def test_poses_of_a_scene_are_read_on_demand_and_not_kept(scene):
    capture, loaded = open_capture(scene), load_capture(scene)
    assert capture.n_antennas == loaded.n_antennas
    assert capture_digest(capture) == capture_digest(loaded)
    assert isinstance(capture.poses, LazyPoses)
    assert capture.poses[-1] is not capture.poses[-1]
    some = capture.poses[1::2]
    assert some.n_antennas == capture.poses.n_antennas[1::2]
    assert [pose.name for pose in some] == [pose.name for pose in loaded.poses[1::2]]
    with pytest.raises(IndexError):
        capture.poses[4]
    assert capture.load().poses[1].signal.tobytes() == loaded.poses[1].signal.tobytes()
