"""Photo sets from files: what is read, what is omitted and reported."""

import numpy as np
import pytest

from geraf2.apps.photos.photo_checks import check_photos
from geraf2.apps.photos.photo_store import box_outline, load_photos
from geraf2.io.photo_files import write_image
from geraf2.pipeline.los_options import LosOptions
from helpers.middlebury import convert_middlebury
from helpers.scene_photos import write_photo_set

TEMPLE_BOUNDS = np.array([[-0.073568, 0.021728, -0.012445], [0.028855, 0.181892, 0.062736]])


def test_a_missing_and_a_broken_photo_are_left_out(tmp_path):
    cameras = write_photo_set(tmp_path, n_photos=5)
    (tmp_path / "photo1.png").unlink()
    whole = (tmp_path / "photo3.png").read_bytes()
    (tmp_path / "photo3.png").write_bytes(whole[: len(whole) // 2])
    loaded = load_photos(tmp_path)
    assert loaded.photos.names == ("photo0.png", "photo2.png", "photo4.png")
    assert [("photo1.png" in note, "photo3.png" in note) for note in loaded.notes] == [
        (True, False),
        (False, True),
    ]
    np.testing.assert_allclose(
        loaded.photos.cameras[1].camera_to_world, cameras[2].camera_to_world, atol=1e-9
    )


def test_unit_and_frame(tmp_path):
    cameras = write_photo_set(tmp_path, n_photos=2)
    move = np.array([[0.0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, 0.3], [0, 0, 0, 1]])
    np.savetxt(tmp_path / "move.txt", move)
    options = LosOptions(unit="mm", to_radar=tmp_path / "move.txt")
    photos = load_photos(tmp_path, options).photos
    expected = move[:3, :3] @ (0.001 * cameras[1].position) + move[:3, 3]
    np.testing.assert_allclose(photos.cameras[1].position, expected, atol=1e-9)


def test_large_photos_are_read_smaller(tmp_path, monkeypatch):
    monkeypatch.setattr("geraf2.apps.photos.photo_store._MAX_SIDE_PX", 32)
    cameras = write_photo_set(tmp_path, n_photos=2)
    photos = load_photos(tmp_path, LosOptions(mask_threshold=1.0)).photos
    assert photos.images[0].shape == (24, 32, 3)
    assert photos.masks[0].shape == (24, 32)
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (20, 3))
    np.testing.assert_allclose(
        2.0 * photos.cameras[1].project(points), cameras[1].project(points), atol=1e-6
    )


def test_masks_from_a_folder(tmp_path):
    cameras = write_photo_set(tmp_path, n_photos=2)
    height, width = cameras[0].height, cameras[0].width
    half = np.zeros((height, width, 3), np.uint8)
    half[: height // 2] = 255
    for name in ("photo0.png", "photo1.png"):
        write_image(tmp_path / "masks" / name, half)
    masks = load_photos(tmp_path, LosOptions(masks=tmp_path / "masks")).photos.masks
    assert masks[0][: height // 2].all()
    assert not masks[0][height // 2 :].any()
    write_image(tmp_path / "masks" / "photo1.png", half[:, :-1])
    notes = load_photos(tmp_path, LosOptions(masks=tmp_path / "masks")).notes
    assert "the mask has another size" in notes[-1]


@pytest.mark.data
def test_the_temple_s_masks_fill_its_published_box(shared_data, tmp_path):
    options = LosOptions(mask_threshold=46.0, bounds=tuple(TEMPLE_BOUNDS.ravel().tolist()))
    loaded = load_photos(convert_middlebury(shared_data / "temple_photos", tmp_path), options)
    photos = loaded.photos
    assert len(photos) == 16
    assert loaded.notes == ()
    assert check_photos(photos) == ()
    middle = TEMPLE_BOUNDS.mean(axis=0)
    assert np.abs(photos.focus() - middle).max() < 0.02
    for camera, mask in zip(photos.cameras, photos.masks, strict=True):
        outline = box_outline(camera, TEMPLE_BOUNDS)
        assert not (mask & ~outline).any()
        assert 0.4 < mask.sum() / outline.sum() < 0.95
        # The box is tight: the object is as wide as its outline.
        columns, box_columns = np.nonzero(mask)[1], np.nonzero(outline)[1]
        assert abs(columns.max() - box_columns.max()) < 40
