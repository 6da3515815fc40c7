"""Photos of the closed box of a scene: cameras on rings, lens, sensor, recorded poses.

    python bench/photos/carton_photos.py SCENE PHOTOS [--photos 48] [--size-px 640 480]
        [--focal-length-px 640] [--seed 0]

writes photos of the outermost box of SCENE into a folder that `geraf2 los PHOTOS OUT` reads.
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carton_scene import CartonScene, photograph
from geraf2.errors import UserError
from geraf2.io.mesh_colours import to_srgb
from geraf2.scene import Wall
from geraf2.scene.photos import Camera, PhotoSet
from geraf2.scene.store import load_capture
from photo_writing import look_at, save_photos

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


@dataclass(frozen=True, kw_only=True)
class PhotosSpec:
    """Photos of the closed outermost box, taken from rings around it."""

    n_photos: int = 48
    """Photos in all, shared out over the rings."""
    size_px: tuple[int, int] = (640, 480)
    """Width and height of each [pixel]."""
    focal_length_px: float = 640.0
    """Focal length [pixel]."""
    ring_elevations_deg: tuple[float, ...] = (-5.0, 20.0, 45.0)
    """Elevation of each ring from the box's middle; 3 cm above its lowest point at least
    [degrees]."""
    distance_m: float | None = None
    """Camera to the middle of the box; by default the box fills the picture [m]."""
    pose_error_rms_m: float = 0.0002
    """Error of each recorded camera position, per coordinate [m]."""
    pose_error_rms_deg: float = 0.03
    """Error of each recorded orientation, per axis [degrees]."""
    noise_rms: float = 2.0
    """Sensor noise at 18 % grey, which grows as shot noise does, in steps of 1/255."""
    exposure: float = 1.0
    """Gain before the sensor; at 3 the lit faces are over-exposed."""
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3 of the lens, as OpenCV's."""
    masks: bool = True
    """Whether silhouettes of the box are written."""


def simulate_photos(
    spec: PhotosSpec,
    walls: tuple[Wall, ...],
    *,
    seed: int,
    num_threads: int | None = None,
) -> PhotoSet:
    """Photos of the outermost box, with the poses that a user would record.

    spec: cameras, sensor, errors.
    walls: boxes of the scene, outermost first; only the first can be seen.
    seed: of print, positions, pose errors and noise; the same seed gives the same photos.

    Returns images by the true poses, cameras with the recorded ones, masks that show the box
    (None where `spec.masks` is off).
    """
    if not walls:
        raise UserError(what="there is no box to photograph", hint="a scene with [[walls]]")
    scene = CartonScene(walls[0], seed, num_threads)
    cameras = ring_cameras(spec, walls[0], seed)
    noise = np.random.default_rng([seed, _SENSOR])
    images, masks = [], []
    for camera in cameras:
        picture = photograph(scene.trace, camera)
        images.append(expose(picture.radiance, spec, noise))
        masks.append(np.asarray(picture.coverage >= 0.5))
    return PhotoSet(
        names=tuple(f"photo_{index:03d}.png" for index in range(len(cameras))),
        cameras=recorded_cameras(cameras, spec, seed),
        images=tuple(images),
        masks=tuple(masks) if spec.masks else None,
    )


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("photos", type=Path)
    parser.add_argument("--photos", dest="n_photos", type=int, default=PhotosSpec.n_photos)
    parser.add_argument("--size-px", type=int, nargs=2, default=PhotosSpec.size_px)
    parser.add_argument("--focal-length-px", type=float, default=PhotosSpec.focal_length_px)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    spec = PhotosSpec(
        n_photos=given.n_photos,
        size_px=tuple(given.size_px),
        focal_length_px=given.focal_length_px,
    )
    walls = load_capture(given.scene).walls
    save_photos(simulate_photos(spec, walls, seed=given.seed), given.photos)


if __name__ == "__main__":
    main()
