import json

import numpy as np
import pytest

from geraf2.cli.main import main
from geraf2.imaging.volume import image_volume, slabs_of
from geraf2.scene import Grid, load_capture, save_capture
from geraf2.scene.capture import LazyPoses
from geraf2.scene.store import capture_digest, open_capture
from helpers.synthetic import TARGETS, point_capture


@pytest.fixture
def points(tmp_path):
    save_capture(point_capture(8, n_side=14, spacing_m=0.008, targets=TARGETS[:1]), tmp_path / "s")
    return tmp_path / "s"


GRID = Grid(origin_m=(-0.04, -0.06, -0.05), spacing_m=0.005, shape=(17, 25, 21))
FLAGS = ["--size-m", "0.08", "0.08", "0.08", "--center-m", "0", "0", "0", "--spacing-m", "0.005"]


@pytest.mark.usefixtures("drawn")
def test_a_point_appears_where_it_is(points, tmp_path, capsys):
    assert main(["image", str(points), str(tmp_path / "out"), *FLAGS]) == 0
    out = capsys.readouterr().out
    assert "largest at" in out
    assert "method         block costs about" in out
    log = [json.loads(line) for line in (tmp_path / "out" / "log.jsonl").read_text().splitlines()]
    (method,) = [entry["method"] for entry in log if entry["event"] == "image"]
    assert method.startswith("block")
    assert method in out
    stored = np.load(tmp_path / "out" / "image.npz")
    peak = np.unravel_index(stored["volume"].argmax(), stored["volume"].shape)
    position = stored["origin_m"] + stored["spacing_m"] * np.array(peak)
    assert np.abs(position - TARGETS[0]).max() <= 0.0051
    assert stored["poses"].tolist() == list(range(8))
    about = json.loads((tmp_path / "out" / "image.json").read_text())
    assert about["shape"] == [17, 17, 17]
    assert about["unit"] == "metre"
    assert (tmp_path / "out" / "figures" / "projections.png").stat().st_size > 1000


def test_flags_may_stand_anywhere_and_one_pose_is_enough(points, tmp_path):
    arguments = [*FLAGS, "--plane", "2", "image", str(points), str(tmp_path / "out")]
    assert main(arguments) == 0
    stored = np.load(tmp_path / "out" / "image.npz")
    assert stored["poses"].tolist() == [2]
    grid = Grid(origin_m=tuple(stored["origin_m"]), spacing_m=0.005, shape=stored["volume"].shape)
    alone = image_volume(load_capture(points), grid, poses=[2])
    assert np.array_equal(alone, stored["volume"])


def test_slabs_give_the_image_of_the_whole_to_the_methods_rtol(points, monkeypatch):
    capture, grid = load_capture(points), GRID
    whole = image_volume(capture, grid)
    monkeypatch.setattr("geraf2.imaging.volume._MAX_SLAB_VOXELS", 4 * 17 * 21)
    assert [part.shape for _, part in slabs_of(grid)] == [*[(17, 4, 21)] * 6, (17, 1, 21)]
    assert np.abs(image_volume(capture, grid) - whole).max() <= 1e-3 * whole.max()


def test_poses_of_a_scene_are_read_on_demand_and_not_kept(points):
    capture, loaded = open_capture(points), load_capture(points)
    assert capture.n_antennas == loaded.n_antennas
    assert capture_digest(capture) == capture_digest(loaded)
    assert isinstance(capture.poses, LazyPoses)
    assert capture.poses[-1] is not capture.poses[-1]
    some = capture.poses[1::2]
    assert some.n_antennas == capture.poses.n_antennas[1::2]
    assert [pose.name for pose in some] == [pose.name for pose in loaded.poses[1::2]]
    with pytest.raises(IndexError):
        capture.poses[8]
    assert capture.load().poses[1].signal.tobytes() == loaded.poses[1].signal.tobytes()
