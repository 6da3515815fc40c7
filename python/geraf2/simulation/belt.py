"""Scans of a moving parcel by fixed arrays: positions of every chirp, recorded and true.

In the frame of the parcel an array at station X lies at X - s(t) along x when the belt has
travelled s(t); s = 0 when the middle of the parcel is at station 0.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from geraf2._types import Floats
from geraf2.io.belt_file import BeltRecord, BeltStation
from geraf2.simulation.belt_spec import BeltArraySpec, BeltSpec
from geraf2.simulation.scan import ScanPlane, plane_frame
from geraf2.simulation.streams import stream

# Angle and elevation of the arrays' middles, seen from the parcel [degrees].
_SIDES = {"left": (90.0, 0.0), "right": (-90.0, 0.0), "above": (90.0, 90.0), "below": (90.0, -90.0)}
# Frequencies of the vibration [Hz]: belt rollers and supports.
_VIBRATION_HZ, _N_VIBRATIONS = (4.0, 25.0), 4


def belt_record(belt: BeltSpec) -> BeltRecord:
    """Arrays and timing, for belt.json."""
    return BeltRecord(
        arrays=tuple(_station(array, belt.chirp_s) for array in belt.arrays),
        speed_m_per_s=belt.speed_m_per_s,
        frame_s=belt.frame_m / belt.speed_m_per_s,
        travel_m=belt.travel_m,
        has_encoder=belt.encoder,
    )


def _station(array: BeltArraySpec, chirp_s: float) -> BeltStation:
    outward, axes = plane_frame(*_SIDES[array.side], 0.0)
    middle = array.standoff_m * outward + array.offset_m * axes[2] + [array.station_m, 0.0, 0.0]
    tx, rx, turn = array.channels()
    positions = [middle + arrays[:, :1] * axes[2] + arrays[:, 1:] * axes[1] for arrays in (tx, rx)]
    tx_m, rx_m = (tuple(map(tuple, rows.tolist())) for rows in positions)
    return BeltStation(
        name=array.name or array.side,
        station_m=array.station_m,
        tx_m=tx_m,
        rx_m=rx_m,
        delays_s=tuple((chirp_s * (turn - 0.5 * turn.max())).tolist()),
    )


def belt_planes(belt: BeltSpec, seed: int) -> Iterator[tuple[ScanPlane, ScanPlane]]:
    """Yield the planes of a belt's scan, each as it is recorded and as it is.

    seed: of vibration and encoder.
    """
    record, motion = belt_record(belt), _Motion(belt, seed)
    for spec, array in zip(belt.arrays, record.arrays, strict=True):
        angle, elevation = _SIDES[spec.side]
        first = (array.station_m - 0.5 * belt.travel_m) / belt.speed_m_per_s / record.frame_s
        frames = np.arange(np.ceil(first - 1e-9), first + belt.travel_m / belt.frame_m + 1e-9)
        n_planes = max(1, round(belt.travel_m / belt.segment_m))
        tx, rx, delays = (np.array(x) for x in (array.tx_m, array.rx_m, array.delays_s))
        for number, own in enumerate(np.array_split(frames, n_planes)):
            times = own[:, None] * record.frame_s + delays
            back = motion.recorded_m(own, times)[:, :, None] * [1.0, 0.0, 0.0]
            common: dict[str, Any] = {
                "axes": plane_frame(angle, elevation, 0.0)[1],
                "angle_deg": angle,
                "shape": None,
                "spacing_m": belt.frame_m,
                "name": f"{array.name}/{number}",
            }
            yield (
                ScanPlane(tx=(tx - back).reshape(-1, 3), rx=(rx - back).reshape(-1, 3), **common),
                ScanPlane(
                    tx=motion.transform_to_parcel(tx, times),
                    rx=motion.transform_to_parcel(rx, times),
                    **common,
                ),
            )


class _Motion:
    """True motion of the parcel, and what is recorded of it."""

    def __init__(self, belt: BeltSpec, seed: int) -> None:
        self.belt, self.seed = belt, seed
        rng = stream(seed, "vibration")
        self.hz = rng.uniform(*_VIBRATION_HZ, (2, _N_VIBRATIONS))
        self.phases = rng.uniform(0.0, 2.0 * np.pi, (2, _N_VIBRATIONS))

    def travel_m(self, times: Floats) -> Floats:
        """Return the true travel [m]."""
        belt = self.belt
        nominal = belt.speed_m_per_s * times
        return nominal * (1.0 + 0.5 * belt.speed_change * nominal / belt.travel_m)

    def recorded_m(self, frames: Floats, times: Floats) -> Floats:
        """Return the recorded travel of each chirp, (n_frames, n_channels) [m]."""
        belt = self.belt
        if not belt.encoder:
            return (1.0 + belt.speed_error) * belt.speed_m_per_s * times
        steps = [stream(self.seed, "encoder", int(frame) + 10**6).normal() for frame in frames]
        jitter = belt.encoder_jitter_m * np.array(steps)[:, None]
        return (1.0 + belt.speed_error) * self.travel_m(times) + jitter

    def transform_to_parcel(self, positions: Floats, times: Floats) -> Floats:
        """Positions (n_channels, 3) in the frame of the parcel at each time, (n_antennas, 3)."""
        belt, travel = self.belt, self.travel_m(times)
        waves = np.cos(2.0 * np.pi * self.hz * times[..., None, None] + self.phases).sum(axis=-1)
        vibration = belt.vibration_rms_m * np.sqrt(2.0 / _N_VIBRATIONS) * waves
        moved = positions - np.concatenate([travel[..., None], vibration], axis=-1)
        yaw = -np.deg2rad(belt.yaw_drift_deg) * travel / belt.travel_m
        x, y, z = np.moveaxis(moved, -1, 0)
        cos, sin = np.cos(yaw), np.sin(yaw)
        return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1).reshape(-1, 3)
