"""Readers of photo sets: each format gives the cameras that were written."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from geraf2.apps.photos.formats import find_photos
from geraf2.apps.photos.formats.images import read_image, read_mask
from geraf2.apps.photos.formats.masks import threshold_mask
from geraf2.apps.photos.photo_store import load_photos
from geraf2.errors import UserError
from geraf2.io.photo_files import write_image
from geraf2.pipeline.los_options import LosOptions
from helpers.scene_photos import SIZE, ring_of_cameras, write_colmap, write_images

UNIT = LosOptions(unit="m")
POINTS = np.random.default_rng(1).uniform(-0.1, 0.1, (30, 3))


def assert_same_cameras(photos, cameras):
    assert photos.names == tuple(f"photo{index}.png" for index in range(len(cameras)))
    for read, camera in zip(photos.cameras, cameras, strict=True):
        np.testing.assert_allclose(read.position, camera.position, atol=1e-9)
        np.testing.assert_allclose(read.project(POINTS), camera.project(POINTS), atol=1e-6)


@pytest.mark.parametrize(
    ("binary", "model", "distortion"),
    [
        (True, "SIMPLE_PINHOLE", ()),
        (False, "PINHOLE", ()),
        (True, "SIMPLE_RADIAL", (0.1,)),
        (False, "RADIAL", (0.1, -0.05)),
        (True, "OPENCV", (0.1, -0.05, 1e-3, -2e-3)),
        (False, "OPENCV", (0.1, -0.05, 1e-3, -2e-3)),
    ],
)
def test_colmap(tmp_path, binary, model, distortion):
    cameras = write_colmap(tmp_path, binary=binary, model=model, distortion=distortion)
    assert find_photos(tmp_path) == tmp_path / "sparse" / "0"
    loaded = load_photos(tmp_path / "sparse" / "0" / f"images.{'bin' if binary else 'txt'}", UNIT)
    assert (loaded.format, loaded.notes) == ("colmap", ())
    assert_same_cameras(loaded.photos, cameras)


def test_the_scale_of_colmap_is_arbitrary(tmp_path):
    cameras = write_colmap(tmp_path, binary=True)
    loaded = load_photos(tmp_path)
    assert_same_cameras(loaded.photos, cameras)
    (note,) = loaded.notes
    assert "arbitrary scale" in note


def write_transforms_by_hand(folder, *, per_frame=False, opengl=True):
    """As nerfstudio writes them: OpenGL axes."""
    cameras = ring_of_cameras(4, distortion=(0.05, 0.0, 0.0, 0.0, 0.0))
    write_images(folder, 4)
    intrinsics = {"fl_x": 60.0, "fl_y": 60.0, "cx": 32.5, "cy": 24.5, "k1": 0.05}
    intrinsics |= {"w": SIZE[0], "h": SIZE[1]}
    frames = []
    for index, camera in enumerate(cameras):
        matrix = camera.camera_to_world.copy()
        if opengl:
            matrix[:, 1:3] *= -1.0
        frame = {"file_path": f"photo{index}.png", "transform_matrix": matrix.tolist()}
        frames.append(frame | (intrinsics if per_frame else {}))
    values = {"camera_model": "OPENCV", "frames": frames} | ({} if per_frame else intrinsics)
    (folder / "transforms.json").write_text(json.dumps(values))
    return cameras, values


@pytest.mark.parametrize(
    ("form", "axes"),
    [({}, "format"), ({"per_frame": True}, "format"), ({"opengl": False}, "opencv")],
)
def test_transforms(tmp_path, form, axes):
    cameras, _ = write_transforms_by_hand(tmp_path, **form)
    loaded = load_photos(tmp_path, LosOptions(camera_axes=axes))
    assert "metres are assumed" in loaded.notes[0]
    assert_same_cameras(loaded.photos, cameras)


def test_transforms_name_their_unit(tmp_path):
    cameras, values = write_transforms_by_hand(tmp_path)
    (tmp_path / "transforms.json").write_text(json.dumps(values | {"unit": "mm"}))
    loaded = load_photos(tmp_path)
    assert loaded.notes == ()
    np.testing.assert_allclose(loaded.photos.cameras[2].position, 1e-3 * cameras[2].position)


def test_images_scaled_down_keep_their_camera(tmp_path):
    cameras, _ = write_transforms_by_hand(tmp_path)
    image = read_image(tmp_path / "photo2.png").colour
    write_image(tmp_path / "photo2.png", np.ascontiguousarray(image[::2, ::2]))
    write_image(tmp_path / "photo3.png", np.ascontiguousarray(image[::2]))
    loaded = load_photos(tmp_path)
    assert loaded.photos.names == ("photo0.png", "photo1.png", "photo2.png")
    assert "another shape than its camera" in loaded.notes[-1]
    small = loaded.photos.cameras[2]
    assert (small.width, small.height) == (SIZE[0] // 2, SIZE[1] // 2)
    np.testing.assert_allclose(2.0 * small.project(POINTS), cameras[2].project(POINTS), atol=1e-6)


def test_frames_without_a_pose_are_left_out(tmp_path):
    _, values = write_transforms_by_hand(tmp_path)
    del values["frames"][1]["transform_matrix"]
    (tmp_path / "transforms.json").write_text(json.dumps(values))
    loaded = load_photos(tmp_path)
    assert len(loaded.photos) == 3
    assert "'photo1.png'" in loaded.notes[0]
    for frame in values["frames"]:
        frame.pop("transform_matrix", None)
    (tmp_path / "transforms.json").write_text(json.dumps(values))
    with pytest.raises(UserError, match="none of the frames has a pose"):
        load_photos(tmp_path)


def write_nerf_synthetic(folder, n_photos=4):
    """As the synthetic sets of NeRF: one angle for all, no size, no extension, transparency."""
    cameras = ring_of_cameras(n_photos)
    focal, (width, height) = 0.5 * SIZE[0] / np.tan(0.3), SIZE
    (folder / "train").mkdir()
    frames, expected = [], []
    for index, camera in enumerate(cameras):
        rgba = np.full((height, width, 4), 255, np.uint8)
        rgba[:, : width // 2, 3] = 0
        Image.fromarray(rgba).save(folder / "train" / f"r.{index}.png")
        matrix = camera.camera_to_world.copy()
        matrix[:, 1:3] *= -1.0
        frames.append({"file_path": f"./train/r.{index}", "transform_matrix": matrix.tolist()})
        middle = [[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]]
        expected.append(replace(camera, intrinsics=np.array(middle)))
    values = {"camera_angle_x": 0.6, "frames": frames}
    (folder / "transforms_train.json").write_text(json.dumps(values))
    return expected


def test_synthetic_sets_of_nerf(tmp_path):
    expected = write_nerf_synthetic(tmp_path)
    (tmp_path / "train" / "r.3.png").unlink()
    assert find_photos(tmp_path) is not None
    loaded = load_photos(tmp_path)
    assert len(loaded.photos) == 3
    assert "no such image './train/r.3'" in loaded.notes[0]
    for read, camera in zip(loaded.photos.cameras, expected, strict=False):
        np.testing.assert_allclose(read.project(POINTS), camera.project(POINTS), atol=1e-6)
    assert loaded.photos.masks[0][:, SIZE[0] // 2 :].all()
    assert not loaded.photos.masks[0][:, : SIZE[0] // 2].any()


def test_one_focal_length_without_size_is_not_for_photos_of_two_sizes(tmp_path):
    _, values = write_transforms_by_hand(tmp_path)
    del values["w"], values["h"]
    (tmp_path / "transforms.json").write_text(json.dumps(values))
    assert len(load_photos(tmp_path).photos) == 4
    write_image(tmp_path / "photo2.png", np.zeros((24, 32, 3), np.uint8))
    with pytest.raises(UserError, match=r"differ in size.*got 32 x 24, 64 x 48"):
        load_photos(tmp_path)


def test_photos_of_other_sizes_with_their_own_intrinsics(tmp_path):
    cameras, values = write_transforms_by_hand(tmp_path, per_frame=True)
    large = replace(cameras[1].resize(96, 96), distortion=cameras[1].distortion)
    write_image(tmp_path / "photo1.png", np.zeros((96, 96, 3), np.uint8))
    k = large.intrinsics
    own = {"fl_x": k[0, 0], "fl_y": k[1, 1], "cx": k[0, 2], "cy": k[1, 2], "w": 96, "h": 96}
    values["frames"][1] |= own
    (tmp_path / "transforms.json").write_text(json.dumps(values))
    loaded = load_photos(tmp_path)
    assert loaded.photos.images[1].shape == (96, 96, 3)
    np.testing.assert_allclose(loaded.photos.cameras[1].project(POINTS), large.project(POINTS))


@pytest.mark.parametrize("tagged", [True, False])
def test_a_picture_on_its_side_is_turned_where_its_camera_is_upright(tmp_path, tagged):
    upright = np.zeros((64, 48, 3), np.uint8)
    upright[:20] = 200  # the top
    exif = Image.Exif()
    if tagged:
        exif[0x0112] = 6  # turn clockwise to see it upright
    path = tmp_path / "photo.png"
    Image.fromarray(np.ascontiguousarray(np.rot90(upright))).save(path, exif=exif)
    assert read_image(path).colour.shape == (48, 64, 3)
    assert read_image(path, (64, 48)).colour.shape == (48, 64, 3)  # poses of the stored picture
    turned = read_image(path, (24, 32)).colour
    if tagged:
        np.testing.assert_array_equal(turned, upright)
    else:
        assert turned.shape == (48, 64, 3)


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


FOREIGN = [
    ("/elsewhere/scan/images/{}", "images"),
    ("C:\\Users\\someone\\scan\\images\\{}", "images"),
    ("/data/somewhere/{}", ""),
    ("../other/scan/{}", ""),
    ("D:/flat/{}", "images"),
]


@pytest.mark.parametrize(("pattern", "folder"), FOREIGN)
def test_images_of_foreign_paths_are_found_beside(tmp_path, pattern, folder):
    cameras, values = write_transforms_by_hand(tmp_path)
    (tmp_path / folder).mkdir(exist_ok=True)
    for index, frame in enumerate(values["frames"]):
        (tmp_path / f"photo{index}.png").rename(tmp_path / folder / f"photo{index}.png")
        (tmp_path / folder / f"mask{index}.png").write_bytes(
            (tmp_path / folder / f"photo{index}.png").read_bytes()
        )
        frame["file_path"] = pattern.format(f"photo{index}.png")
        frame["mask_path"] = pattern.format(f"mask{index}.png")
    (tmp_path / "transforms.json").write_text(json.dumps(values))
    loaded = load_photos(tmp_path)
    found = (tmp_path / folder / "photo0.png").relative_to(tmp_path).as_posix()
    assert loaded.photos.names[0] == found
    assert len(loaded.photos) == len(cameras)
    assert loaded.photos.masks is not None
    assert (
        f"4 images are not at the paths of transforms.json ({pattern.format('photo0.png')}"
        in (loaded.notes[0])
    )
    assert f"as {found}" in loaded.notes[0]


@pytest.mark.parametrize("name", ["../secret.png", "x/../../secret.png", "..\\secret.png"])
def test_no_path_is_looked_for_above_the_folder(tmp_path, name):
    folder = tmp_path / "scan"
    folder.mkdir()
    _, values = write_transforms_by_hand(folder)
    values["frames"][0]["file_path"] = "/nowhere/" + name
    write_image(tmp_path / "secret.png", np.zeros((SIZE[1], SIZE[0], 3), np.uint8))
    (folder / "transforms.json").write_text(json.dumps(values))
    loaded = load_photos(folder)
    assert len(loaded.photos) == 3
    assert any("no such image" in note for note in loaded.notes)


def test_two_frames_are_not_one_image(tmp_path):
    _, values = write_transforms_by_hand(tmp_path)
    for index, frame in enumerate(values["frames"]):
        frame["file_path"] = f"/somewhere/camera{index}/photo0.png"
    (tmp_path / "transforms.json").write_text(json.dumps(values))
    with pytest.raises(UserError, match="two frames share one file here"):
        load_photos(tmp_path)
    values["frames"][0]["file_path"] = "photo0.png"
    (tmp_path / "transforms.json").write_text(
        json.dumps({**values, "frames": values["frames"][:2]})
    )
    with pytest.raises(UserError, match=r"photo0\.png and /somewhere/camera1/photo0\.png"):
        load_photos(tmp_path)
    values["frames"] = values["frames"][:1]
    values["frames"][0]["file_path"] = "a" * 5000
    (tmp_path / "transforms.json").write_text(json.dumps(values))
    with pytest.raises(UserError, match="none of the 1 photos can be used"):
        load_photos(tmp_path)
