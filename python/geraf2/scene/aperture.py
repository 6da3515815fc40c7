"""Rectangle that the antennas of one plane cover, and where a specular return meets it.

A smooth surface returns a monostatic echo along its normal: the antenna that receives it lies where
the normal, prolonged, meets the plane of antennas (docs/math/echoes.md#glints).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from geraf2._types import Bools, Floats
from geraf2.records import RawPose

# Normals more than 84 degrees off the boresight meet no antenna: it receives nothing from there.
_MIN_COSINE = 0.1


class MirrorPoints(NamedTuple):
    """Where the normals of surface points meet the planes of apertures, (n,) of each."""

    positions_m: Floats
    """(n, 3) [m]."""
    edges_m: Floats
    """Distance inside the left, lower, right and upper edge, negative beyond it, (n, 4) [m]."""
    distances_m: Floats
    """From the surface point, (n,) [m]."""
    received: Bools
    """Whether the normal points at the plane, (n,)."""

    @property
    def margins_m(self) -> Floats:
        """Distance inside the nearest edge; -inf where the normal points away, (n,) [m]."""
        return np.asarray(np.where(self.received, self.edges_m.min(axis=1), -np.inf))


@dataclass(frozen=True, kw_only=True, eq=False)
class Aperture:
    """Rectangle that the antennas of one plane cover.

    It receives from both of its sides: a scene lies on one of them, and corners do not show which.
    """

    axes: Floats
    """Rows boresight, horizontal and vertical, (3, 3)."""
    low_m: Floats
    """Smallest coordinates of the antennas along these axes, (3,) [m]."""
    high_m: Floats
    """Largest coordinates, (3,) [m]."""

    @classmethod
    def from_pose(cls, pose: RawPose) -> "Aperture":
        """Rectangle of a pose's phase centres."""
        local = pose.phase_centers @ pose.axes.T
        return cls(axes=pose.axes, low_m=local.min(axis=0), high_m=local.max(axis=0))

    @classmethod
    def from_rectangle(cls, middle_m: Floats, axes: Floats, half_m: Floats) -> "Aperture":
        """Rectangle of a middle (3,) [m], axes (3, 3), and half width and height (2,) [m]."""
        middle, reach = axes @ middle_m, np.array([0.0, *half_m])
        return cls(axes=axes, low_m=middle - reach, high_m=middle + reach)

    @classmethod
    def from_corners(cls, corners_m: Floats) -> "Aperture":
        """Rectangle of corners in turn, (4, 3) [m]; a side of no length gets some direction."""
        across, up = corners_m[1] - corners_m[0], corners_m[3] - corners_m[0]
        half = 0.5 * np.array([np.linalg.norm(across), np.linalg.norm(up)])
        across = across if half[0] > 0.0 else _perpendicular(up)
        up = up if half[1] > 0.0 else _perpendicular(across)
        boresight = np.cross(across, up)
        boresight /= np.linalg.norm(boresight)
        horizontal = across / np.linalg.norm(across)
        axes = np.stack([boresight, horizontal, np.cross(boresight, horizontal)])
        return cls.from_rectangle(corners_m.mean(axis=0), axes, half)

    @property
    def middle_m(self) -> Floats:
        """Middle, (3,) [m]."""
        return np.asarray(0.5 * (self.low_m + self.high_m) @ self.axes)

    @property
    def half_m(self) -> Floats:
        """Half width and height, (2,) [m]."""
        return np.asarray(0.5 * (self.high_m - self.low_m)[1:])

    @property
    def corners_m(self) -> Floats:
        """Corners in turn, (4, 3) [m]."""
        return self.points_at(np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]))

    def points_at(self, shares: Floats) -> Floats:
        """Points of the rectangle at shares -1 to 1 of its half sides, (n, 2) -> (n, 3) [m]."""
        return np.asarray(self.middle_m + (shares * self.half_m) @ self.axes[1:])

    def turn_right_handed(self) -> "Aperture":
        """Return the same rectangle with axes that are a rotation."""
        axes = np.stack([self.axes[0], np.cross(self.axes[2], self.axes[0]), self.axes[2]])
        return Aperture.from_rectangle(self.middle_m, axes, self.half_m)

    def mirror(self, points: Floats, normals: Floats) -> MirrorPoints:
        """Where the normals of surface points meet the plane, points and normals (n, 3) [m]."""
        local, slope = points @ self.axes.T, normals @ self.axes.T
        steep = np.abs(slope[:, 0]) > _MIN_COSINE
        depth = 0.5 * (self.low_m[0] + self.high_m[0])
        step = (depth - local[:, 0]) / np.where(steep, slope[:, 0], 1.0)
        at = local + step[:, None] * slope
        edges = np.concatenate([at[:, 1:] - self.low_m[1:], self.high_m[1:] - at[:, 1:]], axis=1)
        return MirrorPoints(at @ self.axes, edges, step, steep & (step > 0.0))


def _perpendicular(vector: Floats) -> Floats:
    """Return some vector perpendicular to one, (3,)."""
    if not vector.any():
        return np.array([1.0, 0.0, 0.0])
    return np.asarray(np.cross(vector, np.eye(3)[np.argmin(np.abs(vector))]))


def apertures_at(corners_m: Floats) -> list[Aperture]:
    """Apertures of the corners of planes, (n_planes, 4, 3) [m]."""
    return [Aperture.from_corners(corners) for corners in corners_m]
