"""Photo folders as people have them: several models, other capitals, missing and turned photos."""

import json

import numpy as np
import pytest
from PIL import Image, ImageOps

from geraf2.apps.photos.photo_store import load_photos
from geraf2.geometry.transforms import OPENGL_TO_OPENCV
from geraf2.pipeline.los_options import LosOptions
from helpers.scene_photos import image_of, ring_of_cameras, write_colmap

UNIT = LosOptions(unit="m")


def two_models(folder, *, binary, few="0", many="1"):
    """Models of 3 and 6 photos in sparse/0 and sparse/1."""
    write_colmap(folder / "few", 3, binary=binary)
    cameras = write_colmap(folder, 6, binary=binary)
    (folder / "sparse" / "0").rename(folder / "sparse" / "later")
    (folder / "few" / "sparse" / "0").rename(folder / "sparse" / few)
    (folder / "sparse" / "later").rename(folder / "sparse" / many)
    return cameras


@pytest.mark.parametrize(("binary", "few", "many"), [(True, "0", "1"), (False, "1", "0")])
def test_the_largest_model_is_read_and_the_others_named(tmp_path, binary, few, many):
    two_models(tmp_path, binary=binary, few=few, many=many)
    loaded = load_photos(tmp_path, UNIT)
    assert len(loaded.photos) == 6
    note = f"of several COLMAP models '{many}' (6 photos) is read, not {few} (3)"
    assert loaded.notes == (note,)
    # The folder that the user names is read, whichever it is.
    named = load_photos(tmp_path / "sparse" / few, UNIT)
    assert len(named.photos) == 3
    assert f"'{few}' (3 photos) is read, not {many} (6)" in named.notes[0]


def test_a_broken_model_does_not_hide_a_good_one(tmp_path):
    two_models(tmp_path, binary=True)
    (tmp_path / "sparse" / "0" / "images.bin").write_bytes(b"\1")
    assert len(load_photos(tmp_path, UNIT).photos) == 6


@pytest.mark.parametrize("every", [1, 2])
def test_models_without_point_lines(tmp_path, every):
    cameras = write_colmap(tmp_path, 6, binary=False)
    path = tmp_path / "sparse" / "0" / "images.txt"
    lines = [line for line in path.read_text().splitlines() if ".png" in line]
    kept = [line for k, line in enumerate(lines) for line in (line, *["1 2 -1"][k % every :])]
    path.write_text("\n".join(lines if every == 1 else kept) + "\n")
    photos = load_photos(tmp_path, UNIT).photos
    assert len(photos) == 6
    for read, camera in zip(photos.cameras, cameras, strict=True):
        np.testing.assert_allclose(read.position, camera.position, atol=1e-9)


def capitals(folder):
    for path in sorted(folder.rglob("*"), key=lambda path: -len(path.parts)):
        path.rename(path.with_name(path.name.upper()))


@pytest.mark.parametrize("binary", [True, False])
def test_names_in_capitals_are_found(tmp_path, binary):
    cameras = write_colmap(tmp_path, binary=binary)
    capitals(tmp_path)
    photos = load_photos(tmp_path, UNIT).photos
    assert len(photos) == len(cameras)


def transforms(folder, cameras, *, size=(64, 48), name="images/photo{}.jpg"):
    frames = [
        {
            "file_path": name.format(k),
            "transform_matrix": (camera.camera_to_world @ OPENGL_TO_OPENCV).tolist(),
        }
        for k, camera in enumerate(cameras)
    ]
    head = {"fl_x": 60.0, "cx": 32.5, "cy": 24.5, "w": size[0], "h": size[1], "unit": "m"}
    (folder / "transforms.json").write_text(json.dumps(head | {"frames": frames}))


def write_photo(path, image, tag):
    """Store an upright image so that the tag turns it back."""
    inverse = {6: 8, 8: 6}.get(tag, tag)
    exif = Image.Exif()
    exif[0x0112] = inverse
    picture = Image.fromarray(image)
    picture.getexif()[0x0112] = inverse
    stored = ImageOps.exif_transpose(picture)
    exif[0x0112] = tag
    stored.save(path, exif=exif, quality=95)


def test_names_of_transforms_in_other_capitals_are_found(tmp_path):
    (tmp_path / "Images").mkdir()
    for k in range(4):
        Image.fromarray(image_of(64, 48)).save(tmp_path / "Images" / f"PHOTO{k}.JPG")
    transforms(tmp_path, ring_of_cameras(4))
    assert len(load_photos(tmp_path, UNIT).photos) == 4


GRADED = np.repeat(np.linspace(0, 250, 48).astype(np.uint8)[:, None], 64, axis=1)
GRADED = np.stack(
    [GRADED, GRADED // 2, np.tile(np.arange(64, dtype=np.uint8) * 3, (48, 1))], axis=2
)


@pytest.mark.parametrize(("tag", "turns"), [(1, False), (3, False), (6, True), (8, True)])
def test_only_photos_on_their_side_are_turned_and_other_tags_named(tmp_path, tag, turns):
    (tmp_path / "images").mkdir()
    for k in range(4):
        write_photo(tmp_path / "images" / f"photo{k}.jpg", GRADED, tag if k % 2 else 1)
    transforms(tmp_path, ring_of_cameras(4))
    loaded = load_photos(tmp_path, UNIT)
    stored = GRADED if turns or tag == 1 else GRADED[::-1, ::-1]
    assert np.abs(loaded.photos.images[1].astype(int) - stored).mean() < 6
    named = any("2 photos with an EXIF orientation were taken as stored" in n for n in loaded.notes)
    assert named == (tag == 3)
