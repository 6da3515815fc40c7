"""Readers of photo sets: the cameras that were written come back, and bad files are named."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from geraf2.apps.photos.formats import find_photos
from geraf2.apps.photos.photo_store import load_photos
from geraf2.errors import UserError
from geraf2.geometry.transforms import OPENGL_TO_OPENCV
from geraf2.pipeline.los_options import LosOptions
from helpers.scene_photos import SIZE, image_of, ring_of_cameras, write_colmap, write_images
from photo_writing import write_image

UNIT = LosOptions(unit="m")
POINTS = np.random.default_rng(1).uniform(-0.1, 0.1, (30, 3))
LENS = {"fl_x": 60.0, "fl_y": 60.0, "cx": 32.5, "cy": 24.5, "k1": 0.05, "w": SIZE[0], "h": SIZE[1]}


def assert_same_cameras(photos, cameras):
    assert photos.names == tuple(f"photo{index}.png" for index in range(len(cameras)))
    for read, camera in zip(photos.cameras, cameras, strict=True):
        np.testing.assert_allclose(read.position, camera.position, atol=1e-9)
        np.testing.assert_allclose(read.project(POINTS), camera.project(POINTS), atol=1e-6)


def change(path, edit):
    """Replace the content of a transforms.json by what `edit` makes of it."""
    values = json.loads(path.read_text())
    path.write_text(json.dumps(edit(values) or values))


def write_transforms(folder, *, per_frame=False, opengl=True):
    """A transforms.json of four photos; returns the cameras."""
    cameras = ring_of_cameras(4, distortion=(0.05, 0.0, 0.0, 0.0, 0.0))
    write_images(folder, 4)
    frames = []
    for index, camera in enumerate(cameras):
        matrix = camera.camera_to_world @ (OPENGL_TO_OPENCV if opengl else np.eye(4))
        frame = {"file_path": f"photo{index}.png", "transform_matrix": matrix.tolist()}
        frames.append(frame | (LENS if per_frame else {}))
    values = {"camera_model": "OPENCV", "frames": frames} | ({} if per_frame else LENS)
    (folder / "transforms.json").write_text(json.dumps(values))
    return cameras


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
    (note,) = load_photos(tmp_path).notes
    assert "arbitrary scale" in note


def test_a_broken_model_does_not_hide_a_good_one(tmp_path):
    write_colmap(tmp_path, binary=True)
    shutil.copytree(tmp_path / "sparse" / "0", tmp_path / "sparse" / "1")
    (tmp_path / "sparse" / "0" / "images.bin").write_bytes(b"\1")
    loaded = load_photos(tmp_path, UNIT)
    assert len(loaded.photos) == 5
    assert loaded.notes == ("of several COLMAP models '1' (5 photos) is read, not 0 (1)",)
    with pytest.raises(UserError, match="cut off"):  # the folder that the user names is read
        load_photos(tmp_path / "sparse" / "0", UNIT)


@pytest.mark.parametrize("every", [1, 2])
def test_models_without_point_lines(tmp_path, every):
    cameras = write_colmap(tmp_path, 6, binary=False)
    path = tmp_path / "sparse" / "0" / "images.txt"
    lines = [line for line in path.read_text().splitlines() if ".png" in line]
    kept = [line for k, line in enumerate(lines) for line in (line, *["1 2 -1"][k % every :])]
    path.write_text("\n".join(lines if every == 1 else kept) + "\n")
    assert_same_cameras(
        load_photos(tmp_path, UNIT).photos,
        [replace(camera, distortion=(0.1, -0.02, 1e-3, 2e-3, 0.0)) for camera in cameras],
    )


@pytest.mark.parametrize(
    ("form", "axes"),
    [({}, "format"), ({"per_frame": True}, "format"), ({"opengl": False}, "opencv")],
)
def test_transforms(tmp_path, form, axes):
    cameras = write_transforms(tmp_path, **form)
    loaded = load_photos(tmp_path, LosOptions(camera_axes=axes))
    assert "metres are assumed" in loaded.notes[0]
    assert_same_cameras(loaded.photos, cameras)
    change(tmp_path / "transforms.json", lambda values: values | {"unit": "mm"})
    loaded = load_photos(tmp_path, LosOptions(camera_axes=axes))
    assert loaded.notes == ()
    np.testing.assert_allclose(loaded.photos.cameras[2].position, 1e-3 * cameras[2].position)


def test_images_scaled_down_keep_their_camera(tmp_path):
    cameras = write_transforms(tmp_path)
    image = image_of(*SIZE)
    write_image(tmp_path / "photo2.png", np.ascontiguousarray(image[::2, ::2]))
    write_image(tmp_path / "photo3.png", np.ascontiguousarray(image[::2]))
    loaded = load_photos(tmp_path)
    assert loaded.photos.names == ("photo0.png", "photo1.png", "photo2.png")
    assert "another shape than its camera" in loaded.notes[-1]
    small = loaded.photos.cameras[2]
    assert (small.width, small.height) == (SIZE[0] // 2, SIZE[1] // 2)
    np.testing.assert_allclose(2.0 * small.project(POINTS), cameras[2].project(POINTS), atol=1e-6)


def test_synthetic_sets_of_nerf(tmp_path):
    """They have one angle for all, no size, no extension, and transparency."""
    cameras, (width, height) = ring_of_cameras(4), SIZE
    rgba = np.full((height, width, 4), 255, np.uint8)
    rgba[:, : width // 2, 3] = 0
    (tmp_path / "train").mkdir()
    frames = []
    for index, camera in enumerate(cameras):
        Image.fromarray(rgba).save(tmp_path / "train" / f"r.{index}.png")
        matrix = (camera.camera_to_world @ OPENGL_TO_OPENCV).tolist()
        frames.append({"file_path": f"./train/r.{index}", "transform_matrix": matrix})
    values = {"camera_angle_x": 0.6, "frames": frames}
    (tmp_path / "transforms_train.json").write_text(json.dumps(values))
    (tmp_path / "train" / "r.3.png").unlink()
    loaded = load_photos(tmp_path)
    assert len(loaded.photos) == 3
    assert "no such image './train/r.3'" in loaded.notes[0]
    focal = 0.5 * width / np.tan(0.3)
    lens = np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    expected = replace(cameras[1], intrinsics=lens).project(POINTS)
    np.testing.assert_allclose(loaded.photos.cameras[1].project(POINTS), expected, atol=1e-6)
    assert loaded.photos.masks[0][:, width // 2 :].all()
    assert not loaded.photos.masks[0][:, : width // 2].any()


@pytest.mark.parametrize(
    ("pattern", "folder"),
    [
        ("/elsewhere/scan/images/{}", "images"),
        ("C:\\Users\\someone\\scan\\images\\{}", "images"),
        ("../other/scan/{}", ""),
        ("D:/flat/{}", "images"),
    ],
)
def test_images_of_foreign_paths_are_found_beside(tmp_path, pattern, folder):
    write_transforms(tmp_path)
    (tmp_path / folder).mkdir(exist_ok=True)

    def move(values):
        for index, frame in enumerate(values["frames"]):
            photo = (tmp_path / f"photo{index}.png").rename(tmp_path / folder / f"photo{index}.png")
            shutil.copy(photo, photo.with_name(f"mask{index}.png"))
            frame["file_path"] = pattern.format(f"photo{index}.png")
            frame["mask_path"] = pattern.format(f"mask{index}.png")

    change(tmp_path / "transforms.json", move)
    loaded = load_photos(tmp_path)
    found = (tmp_path / folder / "photo0.png").relative_to(tmp_path).as_posix()
    assert loaded.photos.names[0] == found
    assert len(loaded.photos) == len(loaded.photos.masks) == 4
    missed = f"4 images are not at the paths of transforms.json ({pattern.format('photo0.png')}"
    assert missed in loaded.notes[0]
    assert f"as {found}" in loaded.notes[0]


@pytest.mark.parametrize("name", ["../secret.png", "x/../../secret.png", "..\\secret.png"])
def test_no_path_is_looked_for_above_the_folder(tmp_path, name):
    folder = tmp_path / "scan"
    folder.mkdir()
    write_transforms(folder)
    write_image(tmp_path / "secret.png", image_of(*SIZE))
    path = folder / "transforms.json"
    change(path, lambda values: values["frames"][0].update(file_path="/nowhere/" + name))
    loaded = load_photos(folder)
    assert len(loaded.photos) == 3
    assert any("no such image" in note for note in loaded.notes)


@pytest.mark.parametrize("kind", ["binary", "text", "transforms"])
def test_names_in_other_capitals_are_found(tmp_path, kind):
    if kind == "transforms":
        write_transforms(tmp_path)
    else:
        write_colmap(tmp_path, 4, binary=kind == "binary")
    for path in sorted(tmp_path.rglob("*"), key=lambda path: -len(path.parts)):
        path.rename(path.with_name(path.name.upper()))
    assert len(load_photos(tmp_path, UNIT).photos) == 4


def mirror(values):
    row = values["frames"][0]["transform_matrix"][0]
    row[:] = [-value for value in row]


def no_pose(values):
    del values["frames"][0]["transform_matrix"]


@pytest.mark.parametrize(("edit", "words"), [(no_pose, "'photo0.png'"), (mirror, "handed")])
def test_one_bad_frame_is_left_out(tmp_path, edit, words):
    write_transforms(tmp_path)
    change(tmp_path / "transforms.json", edit)
    loaded = load_photos(tmp_path, UNIT)
    assert len(loaded.photos) == 3
    assert words in loaded.notes[0]
