"""Photos of the closed box or the bare object: cameras on rings, lens, sensor, recorded poses."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Floats, Progress
from geraf2.errors import UserError
from geraf2.geometry.transforms import rigid, triple, upright_axes
from geraf2.io.mesh import TriangleMesh
from geraf2.io.mesh_colours import to_srgb
from geraf2.scene import Wall
from geraf2.scene.photos import Camera, PhotoSet
from geraf2.simulation.object_scene import ObjectScene
from geraf2.simulation.photo_scene import CartonScene, photograph
from geraf2.simulation.photo_spec import PhotosSpec

# Independent random streams of one seed.
_POSITIONS, _POSES, _SENSOR = range(5, 8)

_FILL = 0.92
"""Diameter of the box's bounding sphere over the shorter side of the picture."""
_LOWEST_M = 0.03
_AIM_RMS = 0.02  # of the box's size: a hand does not aim exactly
_ROLL_RMS_DEG = 2.0
# sRGB rises by this many steps of 1/255 per unit of linear light at 18 % grey.
_SRGB_STEPS_AT_GREY = 304.8
_GREY = 0.18
_READ_NOISE = 0.02  # of full scale: where the noise stops falling with the light


def simulate_photos(
    spec: PhotosSpec,
    walls: tuple[Wall, ...],
    *,
    seed: int,
    content: TriangleMesh | None = None,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> PhotoSet:
    """Photos of the outermost box or of the bare object, with the poses that a user would record.

    spec: cameras, sensor, errors.
    walls: boxes of the scene, outermost first; only the first can be seen.
    seed: of print, positions, pose errors and noise; the same seed gives the same photos.
    content: the object [m], for `spec.subject` "content".
    progress: called with the fraction done, after each photo.

    Returns images by the true poses, cameras with the recorded ones, masks that show the subject
    (None where `spec.masks` is off).
    """
    scene, bounds = _subject(spec, walls, content, seed, num_threads)
    cameras = ring_cameras(spec, bounds, seed)
    noise = np.random.default_rng([seed, _SENSOR])
    images, masks = [], []
    for index, camera in enumerate(cameras):
        picture = photograph(scene.trace, camera)
        images.append(expose(picture.radiance, spec, noise))
        masks.append(np.asarray(picture.coverage >= 0.5))
        if progress is not None:
            progress((index + 1) / len(cameras))
    return PhotoSet(
        names=tuple(f"photo_{index:03d}.png" for index in range(len(cameras))),
        cameras=recorded_cameras(cameras, spec, seed),
        images=tuple(images),
        masks=tuple(masks) if spec.masks else None,
    )


def _subject(
    spec: PhotosSpec,
    walls: tuple[Wall, ...],
    content: TriangleMesh | None,
    seed: int,
    num_threads: int | None,
) -> tuple[CartonScene | ObjectScene, Wall]:
    """Scene to be photographed, and the bounding box of its subject."""
    if spec.subject == "content":
        if content is None:
            msg = "photos of the content need `content`, got None"
            raise ValueError(msg)
        low, high = content.vertices.min(axis=0), content.vertices.max(axis=0)
        size, center = triple(high - low), triple(0.5 * (low + high))
        thin = 0.25 * min(size)
        bounds = Wall(size_m=size, thickness_m=thin, permittivity=1.0, center_m=center)
        return ObjectScene(content, seed, num_threads), bounds
    if not walls:
        raise UserError(
            what="there is no box to photograph", expected="[[walls]] in a spec with [photos]"
        )
    return CartonScene(walls[0], seed, num_threads), walls[0]


def ring_cameras(spec: PhotosSpec, wall: Wall, seed: int) -> list[Camera]:
    """List the true cameras, ring by ring, each directed roughly at the middle of a box."""
    width, height = spec.size_px
    center = np.asarray(wall.center_m, dtype=np.float64)
    radius = 0.5 * float(np.linalg.norm(wall.size_m))
    distance = spec.distance_m
    if distance is None:
        half_angle = np.arctan(_FILL * 0.5 * min(width, height) / spec.focal_length_px)
        distance = radius / float(np.sin(half_angle))
    if distance <= radius:
        raise UserError(
            what="photos.distance_m puts the cameras into the box",
            expected=f"more than {radius:.3f} m",
            got=f"{distance} m",
        )
    rng = np.random.default_rng([seed, _POSITIONS])
    floor = center[2] - 0.5 * wall.size_m[2]
    counts = np.diff(np.linspace(0, spec.n_photos, len(spec.ring_elevations_deg) + 1).astype(int))
    cameras = []
    for ring, (elevation_deg, count) in enumerate(
        zip(spec.ring_elevations_deg, counts, strict=True)
    ):
        elevation = np.radians(elevation_deg)
        for number in range(count):
            # Rings are turned against each other by a third of a step.
            azimuth = 2.0 * np.pi * (number + ring / 3.0 + rng.uniform(-0.1, 0.1)) / count
            outward = np.array([np.cos(azimuth), np.sin(azimuth)]) * np.cos(elevation)
            eye = center + distance * np.array([*outward, np.sin(elevation)])
            eye[2] = max(eye[2], floor + _LOWEST_M)
            target = center + rng.normal(0.0, _AIM_RMS * max(wall.size_m), 3)
            roll = np.radians(rng.normal(0.0, _ROLL_RMS_DEG))
            cameras.append(
                Camera(
                    intrinsics=np.array(
                        [
                            [spec.focal_length_px, 0.0, 0.5 * width],
                            [0.0, spec.focal_length_px, 0.5 * height],
                            [0.0, 0.0, 1.0],
                        ]
                    ),
                    camera_to_world=look_at(eye, target, roll),
                    width=width,
                    height=height,
                    distortion=spec.distortion,
                )
            )
    return cameras


def look_at(eye: Floats, target: Floats, roll_rad: float = 0.0) -> Floats:
    """Pose of a camera at `eye` directed at `target`, z up in the picture, (4, 4) [m]."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right, down = upright_axes(forward)
    cos, sin = np.cos(roll_rad), np.sin(roll_rad)
    return rigid(np.stack([cos * right + sin * down, cos * down - sin * right, forward], 1), eye)


def expose(
    radiance: NDArray[np.float32], spec: PhotosSpec, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Eight-bit sRGB picture of a linear one: gain, shot and read noise, saturation."""
    linear = spec.exposure * radiance
    sigma = spec.noise_rms / _SRGB_STEPS_AT_GREY
    scale = np.sqrt((np.maximum(linear, 0.0) + _READ_NOISE) / (_GREY + _READ_NOISE))
    noisy = linear + sigma * scale * rng.standard_normal(linear.shape, dtype=np.float32)
    return np.asarray(np.round(255.0 * to_srgb(np.clip(noisy, 0.0, 1.0))), dtype=np.uint8)


def recorded_cameras(cameras: list[Camera], spec: PhotosSpec, seed: int) -> tuple[Camera, ...]:
    """Cameras with small errors of their poses."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 - used here only

    rng = np.random.default_rng([seed, _POSES])
    recorded = []
    for camera in cameras:
        vector = np.radians(spec.pose_error_rms_deg) * rng.standard_normal(3)
        pose = camera.camera_to_world.copy()
        pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(vector).as_matrix()
        pose[:3, 3] += spec.pose_error_rms_m * rng.standard_normal(3)
        recorded.append(replace(camera, camera_to_world=pose))
    return tuple(recorded)
