"""Photographs with known cameras, in the capture frame."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geraf2._types import Bools, Floats
from geraf2._validation import require_least, require_positive, require_shape

# Newton steps that remove distortion; they stop earlier, far below a thousandth of a pixel.
_MAX_STEPS = 20
_STEP_TOLERANCE = 1e-12
_SMALLEST_DETERMINANT = 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class Camera:
    """Pinhole camera with the lens distortion of Brown, as OpenCV writes it.

    With (x, y) = (X / Z, Y / Z) in the camera's frame and r^2 = x^2 + y^2, the image of a point is

        x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
        y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y
        (u, v, 1) = K (x', y', 1)

    in pixels to the right and down; the middle of the upper left pixel is (0.5, 0.5).
    """

    intrinsics: Floats
    """K, upper triangular, (3, 3) [pixel]."""
    camera_to_world: Floats
    """Rigid transform from camera axes x right, y down, z forward, (4, 4) [m]."""
    width: int
    """Columns of the image."""
    height: int
    """Rows of the image."""
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3."""

    def __post_init__(self) -> None:
        require_shape("intrinsics", self.intrinsics, (3, 3))
        require_shape("camera_to_world", self.camera_to_world, (4, 4))
        require_positive("intrinsics[0, 0]", float(self.intrinsics[0, 0]))
        require_positive("intrinsics[1, 1]", float(self.intrinsics[1, 1]))
        require_least(self, width=1, height=1)

    @property
    def position(self) -> Floats:
        """Centre of projection, (3,) [m]."""
        return np.asarray(self.camera_to_world[:3, 3])

    @property
    def view_direction(self) -> Floats:
        """Unit vector along the optical axis, (3,)."""
        return np.asarray(self.camera_to_world[:3, 2])

    def pixel_centers(self) -> Floats:
        """Middle of every pixel, row by row, (height width, 2) [pixel]."""
        rows, columns = np.indices((self.height, self.width))
        return np.stack([columns.ravel() + 0.5, rows.ravel() + 0.5], axis=1)

    def rays(self, pixels: ArrayLike) -> tuple[Floats, Floats]:
        """Rays through image points, undistorted.

        pixels: (n, 2), to the right and down; see :meth:`pixel_centers` [pixel].

        Returns origins (n, 3) [m] and unit directions (n, 3) in the capture frame.
        """
        points = np.asarray(pixels, dtype=np.float64)
        require_shape("pixels", points, (None, 2))
        ones = np.ones((points.shape[0], 1))
        plane = np.linalg.solve(self.intrinsics, np.concatenate([points, ones], axis=1).T).T
        undistorted = self._undistort(plane[:, :2])
        directions = np.concatenate([undistorted, ones], axis=1) @ self.camera_to_world[:3, :3].T
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return np.broadcast_to(self.position, directions.shape).copy(), directions

    def project(self, points: ArrayLike) -> Floats:
        """Image of points (n, 3) [m], (n, 2) [pixel]; NaN for points behind the camera."""
        world = np.asarray(points, dtype=np.float64)
        require_shape("points", world, (None, 3))
        local = (world - self.position) @ self.camera_to_world[:3, :3]
        depth = np.where(local[:, 2:] > 0.0, local[:, 2:], np.nan)
        plane, _ = self._distort(local[:, :2] / depth)
        return np.asarray(plane @ self.intrinsics[:2, :2].T + self.intrinsics[:2, 2])

    def contains(self, pixels: Floats) -> Bools:
        """Whether image points (n, 2) [pixel] lie in the picture, (n,); NaN does not."""
        with np.errstate(invalid="ignore"):
            inside = (pixels >= 0.0) & (pixels < (self.width, self.height))
        return np.asarray(inside.all(axis=1))

    def resize(self, width: int, height: int) -> "Camera":
        """Camera of the same picture in another number of pixels."""
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return replace(self, intrinsics=scale @ self.intrinsics, width=width, height=height)

    def join_pixels(self, step: int) -> "Camera":
        """Camera of a picture in which step x step pixels are one; what fills no block is cut."""
        if step < 1 or step > min(self.width, self.height):
            msg = f"step must be from 1 to the image's shorter side, got {step}"
            raise ValueError(msg)
        intrinsics = np.diag([1.0 / step, 1.0 / step, 1.0]) @ self.intrinsics
        width, height = self.width // step, self.height // step
        return replace(self, intrinsics=intrinsics, width=width, height=height)

    def _distort(self, plane: Floats) -> tuple[Floats, Floats]:
        """Distorted points of the plane z = 1, (n, 2), and the derivative, (n, 2, 2)."""
        k1, k2, p1, p2, k3 = self.distortion
        x, y = plane[:, 0], plane[:, 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))  # d radial / d(x, y) = slope (x, y)
        distorted = np.stack(
            [
                x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            ],
            axis=1,
        )
        derivative = np.empty((plane.shape[0], 2, 2))
        derivative[:, 0, 0] = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
        derivative[:, 0, 1] = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
        derivative[:, 1, 0] = derivative[:, 0, 1]
        derivative[:, 1, 1] = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
        return distorted, derivative

    def _undistort(self, plane: Floats) -> Floats:
        """Newton's inverse of :meth:`_distort`."""
        if not any(self.distortion):
            return plane
        points = plane.copy()
        for _ in range(_MAX_STEPS):
            distorted, derivative = self._distort(points)
            a, b, d = derivative[:, 0, 0], derivative[:, 0, 1], derivative[:, 1, 1]
            missing = plane - distorted
            # Beyond the radius where a polynomial turns back there is no inverse, and no harm in
            # a point that is merely finite.
            determinant = np.maximum(a * d - b * b, _SMALLEST_DETERMINANT)
            step = np.stack(
                [d * missing[:, 0] - b * missing[:, 1], a * missing[:, 1] - b * missing[:, 0]],
                axis=1,
            )
            step = np.clip(step / determinant[:, None], -1.0, 1.0)
            points += step
            if np.abs(step).max(initial=0.0) < _STEP_TOLERANCE:
                break
        return points


def bin_pixels(image: NDArray[np.generic], step: int) -> Floats:
    """Mean of step x step pixels, (height, width, ...); see :meth:`Camera.join_pixels`."""
    height, width = image.shape[0] // step, image.shape[1] // step
    rows = image[: height * step, : width * step].reshape(height, step, width, step, -1)
    blocks = rows.mean(axis=(1, 3), dtype=np.float64)
    return np.asarray(blocks.reshape(height, width, *image.shape[2:]))


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotoSet:
    """Photos of one static scene, with their cameras; sizes may differ."""

    names: tuple[str, ...]
    """One a photo."""
    cameras: tuple[Camera, ...]
    """One a photo, in the capture frame [m]."""
    images: tuple[NDArray[np.uint8], ...]
    """(height, width, 3) each, sRGB."""
    masks: tuple[Bools, ...] | None = None
    """True where the object is, (height, width) each; None: nothing is known."""
    frame: str = "capture"
    """Name of the frame of the cameras."""

    def __post_init__(self) -> None:
        lengths = {len(self.names), len(self.cameras), len(self.images)}
        if self.masks is not None:
            lengths.add(len(self.masks))
        if len(lengths) != 1:
            msg = f"names, cameras, images and masks must be as many, got {sorted(lengths)}"
            raise ValueError(msg)
        for index, camera in enumerate(self.cameras):
            size = (camera.height, camera.width)
            require_shape(f"images[{index}]", self.images[index], (*size, 3))
            if self.masks is not None:
                require_shape(f"masks[{index}]", self.masks[index], size)

    def __len__(self) -> int:
        return len(self.names)

    def subset(self, indices: ArrayLike) -> "PhotoSet":
        """Photos of these indices, in this order."""
        chosen = [int(index) for index in np.asarray(indices).ravel()]
        return replace(
            self,
            names=tuple(self.names[i] for i in chosen),
            cameras=tuple(self.cameras[i] for i in chosen),
            images=tuple(self.images[i] for i in chosen),
            masks=None if self.masks is None else tuple(self.masks[i] for i in chosen),
        )

    @property
    def positions(self) -> Floats:
        """Positions of the cameras, (n, 3) [m]."""
        return np.stack([camera.position for camera in self.cameras])

    def focus(self) -> Floats:
        """Point nearest to all optical axes in the least-squares sense, (3,) [m].

        Parallel axes leave it open; then it is the nearest to the cameras among the best.
        """
        middle = self.positions.mean(axis=0)
        across = [
            np.eye(3) - np.outer(camera.view_direction, camera.view_direction)
            for camera in self.cameras
        ]
        lhs = np.sum(across, axis=0)
        rhs = np.sum(
            [a @ (c.position - middle) for a, c in zip(across, self.cameras, strict=True)], axis=0
        )
        return np.asarray(middle + np.linalg.lstsq(lhs, rhs, rcond=1e-6)[0])
