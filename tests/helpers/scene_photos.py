"""Small photo sets on disk, in the formats that are read."""

import struct

import numpy as np
from scipy.spatial.transform import Rotation

from geraf2.scene.photos import Camera, PhotoSet
from photo_writing import look_at, save_photos, write_image

SIZE = (64, 48)
INTRINSICS = np.array([[60.0, 0.0, 32.5], [0.0, 60.0, 24.5], [0.0, 0.0, 1.0]])


def image_of(width, height, seed=0):
    return np.random.default_rng(seed).integers(20, 220, (height, width, 3), dtype=np.uint8)


def ring_of_cameras(n_photos, radius=0.5, height=0.2, distortion=(0.0,) * 5, arc=2.0 * np.pi):
    """Cameras around the origin that look at it."""
    cameras = []
    for angle in arc * np.arange(n_photos) / n_photos:
        eye = np.array([radius * np.cos(angle), radius * np.sin(angle), height])
        cameras.append(
            Camera(
                intrinsics=INTRINSICS,
                camera_to_world=look_at(eye, np.zeros(3)),
                width=SIZE[0],
                height=SIZE[1],
                distortion=distortion,
            )
        )
    return cameras


def write_images(folder, n_photos):
    for index in range(n_photos):
        write_image(folder / f"photo{index}.png", image_of(*SIZE, seed=index))


def write_photo_set(folder, n_photos=6, **options):
    """A transforms.json with images; returns the cameras."""
    cameras = ring_of_cameras(n_photos, **options)
    names = tuple(f"photo{index}.png" for index in range(n_photos))
    images = tuple(image_of(*SIZE, seed=index) for index in range(n_photos))
    save_photos(PhotoSet(names=names, cameras=tuple(cameras), images=images), folder)
    return cameras


def write_colmap(
    folder, n_photos=5, *, binary, model="OPENCV", distortion=(0.1, -0.02, 1e-3, 2e-3)
):
    """A COLMAP model with ids that have gaps, images in `images`; returns the cameras."""
    cameras = ring_of_cameras(
        n_photos, distortion=tuple(distortion) + (0.0,) * (5 - len(distortion))
    )
    sparse = folder / "sparse" / "0"
    sparse.mkdir(parents=True)
    (folder / "images").mkdir()
    write_images(folder / "images", n_photos)
    focal = {"OPENCV": [60.0, 60.0], "PINHOLE": [60.0, 60.0]}.get(model, [60.0])
    parameters = [*focal, 32.5, 24.5, *distortion]
    poses = []
    for index, camera in enumerate(cameras):
        rotation = Rotation.from_matrix(camera.camera_to_world[:3, :3].T)
        x, y, z, w = rotation.as_quat()
        translation = -rotation.apply(camera.position)
        poses.append((7 * index + 3, [w, x, y, z, *translation], f"photo{index}.png"))
    poses.reverse()  # COLMAP keeps no order
    write = _write_binary if binary else _write_text
    write(sparse, model, parameters, poses)
    return cameras


_NUMBERS = {"SIMPLE_PINHOLE": 0, "PINHOLE": 1, "SIMPLE_RADIAL": 2, "RADIAL": 3, "OPENCV": 4}


def _write_binary(sparse, model, parameters, poses):
    cameras = struct.pack("<Q", 1) + struct.pack("<iiQQ", 42, _NUMBERS[model], *SIZE)
    cameras += struct.pack(f"<{len(parameters)}d", *parameters)
    (sparse / "cameras.bin").write_bytes(cameras)
    images = struct.pack("<Q", len(poses))
    for image_id, values, name in poses:
        images += struct.pack("<i7di", image_id, *values, 42) + name.encode() + b"\0"
        images += struct.pack("<Q", 2) + 2 * struct.pack("<ddq", 1.0, 2.0, -1)
    (sparse / "images.bin").write_bytes(images)


def _write_text(sparse, model, parameters, poses):
    line = f"42 {model} {SIZE[0]} {SIZE[1]} " + " ".join(f"{v:.17g}" for v in parameters)
    (sparse / "cameras.txt").write_text(f"# cameras\n{line}\n")
    lines = ["# images", "# two lines each"]
    for number, (image_id, values, name) in enumerate(poses):
        lines.append(f"{image_id} " + " ".join(f"{v:.17g}" for v in values) + f" 42 {name}")
        lines.append("" if number % 2 else "1.0 2.0 -1 3.0 4.0 17")
    (sparse / "images.txt").write_text("\n".join(lines) + "\n")
