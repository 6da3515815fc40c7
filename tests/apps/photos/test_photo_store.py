"""Photo sets from files: pictures and masks, and what is omitted and reported."""

import numpy as np
import pytest
from PIL import Image, ImageOps

from geraf2.apps.photos.formats.images import read_image, read_mask
from geraf2.apps.photos.formats.masks import threshold_mask
from geraf2.apps.photos.photo_checks import check_photos
from geraf2.apps.photos.photo_store import box_outline, load_photos
from geraf2.errors import UserError
from geraf2.pipeline.los_options import LosOptions
from helpers.middlebury import convert_middlebury
from helpers.scene_photos import SIZE, write_photo_set
from photo_writing import write_image

TEMPLE_BOUNDS = np.array([[-0.073568, 0.021728, -0.012445], [0.028855, 0.181892, 0.062736]])


def test_a_missing_and_a_broken_photo_are_left_out(tmp_path):
    cameras = write_photo_set(tmp_path, n_photos=5)
    (tmp_path / "photo1.png").unlink()
    whole = (tmp_path / "photo3.png").read_bytes()
    (tmp_path / "photo3.png").write_bytes(whole[: len(whole) // 2])
    loaded = load_photos(tmp_path)
    assert loaded.photos.names == ("photo0.png", "photo2.png", "photo4.png")
    first, second = loaded.notes
    assert "photo1.png" in first
    assert "photo3.png" in second
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
    write_photo_set(tmp_path, n_photos=2)
    width, height = SIZE
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


def test_images_of_other_kinds(tmp_path):
    grey = np.arange(256, dtype=np.uint8).reshape(16, 16)
    Image.fromarray(grey).save(tmp_path / "grey.png")
    Image.fromarray(grey.astype(np.uint16) * 257).save(tmp_path / "deep.png")
    rgba = np.dstack([grey, grey, grey, np.where(grey > 99, 255, 0)]).astype(np.uint8)
    Image.fromarray(rgba).save(tmp_path / "alpha.png")
    for name in ("grey.png", "deep.png", "alpha.png"):
        np.testing.assert_array_equal(read_image(tmp_path / name).colour[:, :, 1], grey)
    np.testing.assert_array_equal(read_mask(tmp_path / "alpha.png"), grey > 99)
    np.testing.assert_array_equal(read_mask(tmp_path / "grey.png"), grey >= 128)
    (tmp_path / "text.png").write_text("no image")
    with pytest.raises(UserError, match="cannot be read"):
        read_image(tmp_path / "text.png")


@pytest.mark.parametrize(("tag", "turns"), [(1, False), (3, False), (6, True), (8, True)])
def test_only_photos_on_their_side_are_turned_and_other_tags_named(tmp_path, tag, turns):
    write_photo_set(tmp_path, n_photos=2)
    upright = read_image(tmp_path / "photo1.png").colour
    exif = Image.Exif()
    exif[0x0112] = {6: 8, 8: 6}.get(tag, tag)  # turns the stored picture as the tag turns it back
    picture = Image.fromarray(upright)
    picture.getexif()[0x0112] = exif[0x0112]
    stored = ImageOps.exif_transpose(picture)
    exif[0x0112] = tag
    stored.save(tmp_path / "photo1.png", exif=exif)
    loaded = load_photos(tmp_path)
    shown = upright if turns or tag == 1 else upright[::-1, ::-1]
    np.testing.assert_array_equal(loaded.photos.images[1], shown)
    note = "1 photos with an EXIF orientation were taken as stored (e.g. photo1.png)"
    assert any(note in text for text in loaded.notes) == (tag == 3)
    # poses of the stored picture
    assert read_image(tmp_path / "photo1.png", stored.size).colour.shape == np.shape(stored)


def test_threshold_mask_is_the_largest_bright_part():
    image = np.full((40, 60, 3), 10, np.uint8)
    image[10:30, 10:40, 1] = 200
    image[2:5, 50:54] = 255
    mask = threshold_mask(image, 50.0)
    assert 20 * 30 <= mask.sum() < 22 * 32 + 1
    assert not mask[:, 45:].any()
    assert not threshold_mask(image, 254.0)[10:30, 10:40].any()
    assert not threshold_mask(np.zeros((4, 4, 3), np.uint8), 50.0).any()


@pytest.mark.parametrize(
    ("behind", "dark", "width", "filled"),
    [
        (10, 35, 8, True),  # a slot in shadow
        (10, 12, 8, False),  # a narrow gap before the background
        (40, 40, 8, False),  # before a bright one
        (10, 35, 40, False),  # wide: whatever it is, it is no crack
        (10, 35, 2, True),  # a crack
    ],
)
def test_threshold_mask_fills_shadow_but_not_gaps(behind, dark, width, filled):
    image = np.full((200, 640, 3), behind, np.uint8)
    image[40:160, 100:500] = 200
    image[60:140, 300 : 300 + width] = dark
    middle = (100, 300 + width // 2)
    assert not threshold_mask(image, 60.0, fill_shadows=False)[middle] or width == 2
    mask = threshold_mask(image, 60.0)
    assert mask[middle] == filled
    # what is outside is untouched, as is an open notch of the outline
    assert not mask[:, :98].any()
    image[:60, 200:210] = 10
    assert not threshold_mask(image, 60.0)[50, 205]


@pytest.mark.data
def test_the_temple_s_masks_fill_its_published_box(shared_data, tmp_path):
    options = LosOptions(mask_threshold=46.0, bounds=tuple(TEMPLE_BOUNDS.ravel().tolist()))
    loaded = load_photos(convert_middlebury(shared_data / "temple_photos", tmp_path), options)
    photos = loaded.photos
    assert len(photos) == 16
    assert loaded.notes == ()
    assert check_photos(photos) == ()
    assert np.abs(photos.focus() - TEMPLE_BOUNDS.mean(axis=0)).max() < 0.02
    for camera, mask in zip(photos.cameras, photos.masks, strict=True):
        outline = box_outline(camera, TEMPLE_BOUNDS)
        assert not (mask & ~outline).any()
        assert 0.4 < mask.sum() / outline.sum() < 0.95
        # The box is tight: the object is as wide as its outline.
        columns, box_columns = np.nonzero(mask)[1], np.nonzero(outline)[1]
        assert abs(columns.max() - box_columns.max()) < 40
