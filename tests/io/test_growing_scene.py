"""A scene folder that grows: the same as one written at once, and whole after each plane."""

from dataclasses import replace

import pytest

from geraf2 import examples
from geraf2.errors import UserError
from geraf2.io import growing_scene
from geraf2.io.container import SceneReader, verify_scene
from geraf2.io.growing_scene import GrowingScene
from geraf2.scene.store import capture_digest, load_capture, manifest_of, save_capture
from helpers.folders import contents


@pytest.fixture(scope="module")
def capture():
    """Planes of different sizes: the second is larger than the first, the third smaller."""
    capture, _ = examples.small_capture()
    sizes = (20, 44, 9)
    poses = tuple(pose.select(slice(n)) for n, pose in zip(sizes, capture.poses, strict=False))
    return replace(capture, poses=poses)


def _about(capture):
    return manifest_of(replace(capture, poses=()))


def test_it_holds_what_a_scene_written_at_once_holds(capture, tmp_path):
    scene = GrowingScene(tmp_path / "grown", _about(capture))
    for number, pose in enumerate(capture.poses, start=1):
        scene.append(pose)
        assert len(load_capture(scene.path).poses) == number
    save_capture(capture, tmp_path / "once")
    grown, once = SceneReader(scene.path), SceneReader(tmp_path / "once")
    assert grown.holds_same_poses(once)
    assert verify_scene(scene.path) == 3
    assert capture_digest(load_capture(scene.path)) == capture_digest(capture)


def test_many_planes_have_their_counts_and_angles(capture, tmp_path, monkeypatch):
    monkeypatch.setattr(growing_scene, "_N_COUNTED", 2)
    scene = GrowingScene(tmp_path / "scene", _about(capture))
    poses = [replace(capture.poses[n % 3], angle_deg=10.0 * n) for n in range(5)]
    for pose in poses:
        scene.append(pose)
    stored = load_capture(scene.path)
    assert [pose.angle_deg for pose in stored.poses] == [0.0, 10.0, 20.0, 30.0, 40.0]
    assert [pose.n_antennas for pose in stored.poses] == [20, 44, 9, 20, 44]


@pytest.mark.parametrize("n_whole", [0, 1])
def test_a_plane_that_was_half_written_is_written_again(capture, tmp_path, monkeypatch, n_whole):
    """Whichever of its files was the last."""

    class Killed(BaseException):
        pass

    def written(path, write, left):
        if left[0] == 0:
            raise Killed
        left[0] -= 1
        write(path)

    for n_files in range(n_whole, 40, 3):
        folder, left = tmp_path / str(n_files), [10**9]
        with monkeypatch.context() as patch:
            for name in ("write_bytes_atomic", "write_text_atomic", "write_toml"):
                write = getattr(growing_scene, name)
                patch.setattr(
                    growing_scene,
                    name,
                    lambda path, data, write=write, left=left: written(
                        path, lambda to: write(to, data), left
                    ),
                )
            scene = GrowingScene(folder, _about(capture))
            for pose in capture.poses[:n_whole]:
                scene.append(pose)
            left[0] = n_files
            try:
                scene.append(capture.poses[n_whole])
            except Killed:
                pass
            else:
                break
        again = GrowingScene(folder, _about(capture))
        assert len(again) == n_whole
        for pose in capture.poses[n_whole:]:
            again.append(pose)
        assert capture_digest(load_capture(folder)) == capture_digest(capture)
    assert n_files > 10  # each file of a plane was the last one


def test_an_error_leaves_the_planes_before(capture, tmp_path, monkeypatch):
    scene = GrowingScene(tmp_path / "scene", _about(capture))
    scene.append(capture.poses[0])
    with monkeypatch.context() as patch:

        def full(path, _):
            raise UserError(what="No space left on device", where=path)

        patch.setattr(growing_scene, "write_text_atomic", full)
        with pytest.raises(UserError, match="No space left"):
            scene.append(capture.poses[1])
    for pose in capture.poses[1:]:
        scene.append(pose)
    assert capture_digest(load_capture(scene.path)) == capture_digest(capture)


def test_planes_of_another_radar_do_not_join(capture, tmp_path):
    GrowingScene(tmp_path / "scene", _about(capture)).append(capture.poses[0])
    other = replace(capture.waveform, path_bias_m=0.1)
    with pytest.raises(UserError, match="another radar, box or frame"):
        GrowingScene(tmp_path / "scene", _about(replace(capture, waveform=other)))


def test_a_finished_scene_does_not_grow(capture, tmp_path):
    save_capture(capture, tmp_path / "scene")
    before = contents(tmp_path / "scene")
    with pytest.raises(UserError, match="is a finished scene"):
        GrowingScene(tmp_path / "scene", _about(capture))
    assert contents(tmp_path / "scene") == before
