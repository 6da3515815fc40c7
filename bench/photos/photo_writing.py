"""Poses of cameras, and photo sets as files that `geraf2 los` reads."""

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from geraf2._types import Floats
from geraf2.geometry.transforms import OPENGL_TO_OPENCV, rigid
from geraf2.io.photo_files import DISTORTION, TRANSFORMS_NAME
from geraf2.scene.photos import Camera, PhotoSet


def upright_axes(forward: Floats) -> tuple[Floats, Floats]:
    """Right and down directions of a view along a unit vector (3,), with z up; (3,) each."""
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return right, np.cross(forward, right)


def look_at(eye: Floats, target: Floats, roll_rad: float = 0.0) -> Floats:
    """Pose of a camera at `eye` directed at `target`, z up in the picture, (4, 4) [m]."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right, down = upright_axes(forward)
    cos, sin = np.cos(roll_rad), np.sin(roll_rad)
    return rigid(np.stack([cos * right + sin * down, cos * down - sin * right, forward], 1), eye)


def write_image(path: Path, image: NDArray[np.uint8]) -> None:
    """Write a PNG (height, width, 3) or (height, width)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(image).save(path, format="PNG")


def save_photos(photos: PhotoSet, folder: Path) -> None:
    """Write a photo set as PNG files, masks and transforms.json in metres."""
    frames = []
    for index, (name, camera) in enumerate(zip(photos.names, photos.cameras, strict=True)):
        file = Path(name).with_suffix(".png").name
        write_image(folder / file, photos.images[index])
        pose = (camera.camera_to_world @ OPENGL_TO_OPENCV).tolist()
        entry = {"file_path": file, "transform_matrix": pose, **_intrinsics_of(camera)}
        if photos.masks is not None:
            entry["mask_path"] = f"masks/{file}"
            write_image(
                folder / "masks" / file, np.where(photos.masks[index], 255, 0).astype(np.uint8)
            )
        frames.append(entry)
    head = {"camera_model": "OPENCV", "unit": "m", "frame": photos.frame, "frames": frames}
    (folder / TRANSFORMS_NAME).write_text(json.dumps(head, indent=1), encoding="utf-8")


def _intrinsics_of(camera: Camera) -> dict[str, float | int]:
    k = camera.intrinsics
    names = dict(zip(DISTORTION, map(float, camera.distortion), strict=True))
    focal = {"fl_x": float(k[0, 0]), "fl_y": float(k[1, 1])}
    size = {"w": camera.width, "h": camera.height}
    return size | focal | {"cx": float(k[0, 2]), "cy": float(k[1, 2])} | names
