"""True positions of antennas, against those that a capture records."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from geraf2._types import Floats
from geraf2.simulation.scan import ScanPlane
from geraf2.simulation.spec import ScanSpec, SceneSpec
from geraf2.simulation.streams import stream

# A drift is the sum of this many cosines over the antennas of a plane, the slowest a constant.
_N_DRIFT_TERMS = 5


def true_plane(plane: ScanPlane, spec: SceneSpec, seed: int, number: int) -> ScanPlane:
    """Return a plane at its true position in the object's frame.

    Its antennas are displaced (:func:`position_error`); then all of it is turned about the frame's
    origin by the tilt of the axis, equally towards the radar and across, and about the axis by the
    error of its angle.

    plane: as it is recorded.
    spec: the scene.
    seed: of jitter, drift and angles.
    number: of the plane.
    """
    shift = position_error(plane, spec.scan, seed, number)
    moved = replace(plane, tx=plane.tx + shift, rx=plane.rx + shift)
    world = spec.world
    if not world.plane_angle_rms_deg and not world.axis_tilt_deg:
        return moved
    tilt = np.deg2rad(world.axis_tilt_deg / np.sqrt(2.0)) * (plane.axes[0] + plane.axes[1])
    off = np.deg2rad(world.plane_angle_rms_deg) * stream(seed, "angles", number).normal()
    turn = Rotation.from_rotvec([0.0, 0.0, off]) * Rotation.from_rotvec(tilt)
    return turned_plane(moved, turn.as_matrix())


def turned_plane(plane: ScanPlane, turn: Floats, center_m: Floats | float = 0.0) -> ScanPlane:
    """Plane turned about a point.

    plane: the plane to turn.
    turn: rotation, (3, 3).
    center_m: the point, (3,) [m].
    """
    return replace(
        plane,
        tx=(plane.tx - center_m) @ turn.T + center_m,
        rx=(plane.rx - center_m) @ turn.T + center_m,
        axes=plane.axes @ turn.T,
    )


def position_error(plane: ScanPlane, scan: ScanSpec, seed: int, number: int) -> Floats:
    """Difference of the true from the recorded position of each antenna, (n_antennas, 3) [m].

    Transmitter and receiver move together. The object turns about an axis that lies at
    `axis_offset_m`; in the object's frame, the radar is displaced in the opposite direction.
    """
    n = len(plane.tx)
    jitter = stream(seed, "jitter", number).normal(size=(n, 3))
    amplitudes = stream(seed, "drift", number).normal(size=(_N_DRIFT_TERMS, 3))
    amplitudes /= np.sqrt(1.0 + 0.5 * (_N_DRIFT_TERMS - 1))  # one constant, the others cosines
    phase = np.pi * (np.arange(n)[:, None] + 0.5) / n * np.arange(_N_DRIFT_TERMS)
    radial, across = scan.axis_offset_m
    axis = -radial * plane.axes[0] + across * plane.axes[1]
    return np.asarray(
        scan.position_jitter_rms_m * jitter
        + scan.position_drift_rms_m * (np.cos(phase) @ amplitudes)
        - axis
    )
