"""Photos of a coloured ball, drawn by the equation of a ball."""

from functools import cache

import numpy as np

from geraf2.scene.photos import Camera, PhotoSet
from photo_writing import look_at

CENTER = np.array([0.02, -0.01, 0.03])
RADIUS_M = 0.08
SIZE = (48, 36)


def colour_of(normals):
    """Smooth colours from the position on the ball."""
    return 0.5 + 0.4 * np.sin(4.0 * normals + np.array([0.0, 1.0, 2.0]))


def cameras(n_photos, distance=0.45):
    intrinsics = np.array([[70.0, 0.0, 24.0], [0.0, 70.0, 18.0], [0.0, 0.0, 1.0]])
    made = []
    for index in range(n_photos):
        angle, height = 2.0 * np.pi * index / n_photos, 0.15 * (-1) ** index
        eye = CENTER + np.array([distance * np.cos(angle), distance * np.sin(angle), height])
        pose = look_at(eye, CENTER)
        made.append(
            Camera(intrinsics=intrinsics, camera_to_world=pose, width=SIZE[0], height=SIZE[1])
        )
    return made


def photo(camera, background=(0.1, 0.2, 0.3)):
    origins, directions = camera.rays(camera.pixel_centers())
    offset = origins - CENTER
    middle = -(offset * directions).sum(axis=1)
    inside = RADIUS_M**2 - (offset**2).sum(axis=1) + middle**2
    hit = inside > 0.0
    position = offset + (middle - np.sqrt(np.maximum(inside, 0.0)))[:, None] * directions
    colour = np.where(hit[:, None], colour_of(position / RADIUS_M), background)
    shape = (camera.height, camera.width)
    return np.round(255.0 * colour).astype(np.uint8).reshape(*shape, 3), hit.reshape(shape)


@cache
def photo_set(n_photos):
    made = cameras(n_photos)
    pictures = [photo(camera) for camera in made]
    return PhotoSet(
        names=tuple(f"{index}.png" for index in range(n_photos)),
        cameras=tuple(made),
        images=tuple(image for image, _ in pictures),
        masks=tuple(mask for _, mask in pictures),
    )
