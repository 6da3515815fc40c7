"""Small photo sets on disk, in the formats that are read."""

import numpy as np

from geraf2.io.photos.images import write_image
from geraf2.scene.photos import Camera

SIZE = (64, 48)
INTRINSICS = np.array([[60.0, 0.0, 32.5], [0.0, 60.0, 24.5], [0.0, 0.0, 1.0]])


def image_of(width, height, seed=0):
    return np.random.default_rng(seed).integers(20, 220, (height, width, 3), dtype=np.uint8)


def ring_of_cameras(n_photos, radius=0.5, height=0.2, distortion=(0.0,) * 5, arc=2.0 * np.pi):
    """Cameras around the origin that look at it."""
    cameras = []
    for angle in arc * np.arange(n_photos) / n_photos:
        eye = np.array([radius * np.cos(angle), radius * np.sin(angle), height])
        forward = -eye / np.linalg.norm(eye)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3] = np.stack([right, np.cross(forward, right), forward, eye], axis=1)
        cameras.append(
            Camera(
                intrinsics=INTRINSICS,
                camera_to_world=pose,
                width=SIZE[0],
                height=SIZE[1],
                distortion=distortion,
            )
        )
    return cameras


def write_images(folder, n_photos):
    for index in range(n_photos):
        write_image(folder / f"photo{index}.png", image_of(*SIZE, seed=index))


def write_middlebury(folder, n_photos=6, **options):
    """A `_par.txt` with images; returns the cameras."""
    cameras = ring_of_cameras(n_photos, **options)
    lines = [str(n_photos)]
    for index, camera in enumerate(cameras):
        rotation = camera.camera_to_world[:3, :3].T
        intrinsics = camera.intrinsics.copy()
        intrinsics[:2, 2] -= 0.5
        values = [*intrinsics.ravel(), *rotation.ravel(), *(-rotation @ camera.position)]
        lines.append(f"photo{index}.png " + " ".join(f"{value:.15g}" for value in values))
    (folder / "ring_par.txt").write_text("\n".join(lines) + "\n")
    write_images(folder, n_photos)
    return cameras
