"""Record of a belt's arrays, belt.json beside the planes of a scene.

The frame of such a scene moves with the belt: an array at `station_m` that recorded when the belt
had travelled s lies at its positions here minus s along x. A plane is named ARRAY/NUMBER and holds
successive frames of one array; the channels of a frame are in the order of the record.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval, MinLen

from geraf2._bounds import Bounded, LengthM, Seconds, SignedM, Triple
from geraf2._types import Floats
from geraf2.errors import UserError
from geraf2.io.atomic import write_json_atomic
from geraf2.io.text import read_object
from geraf2.io.toml import from_table, to_table

BELT_NAME = "belt.json"
BELT_FORMAT = "geraf2-belt"
MOTION_KEY = "belt_motion"
"""Entry of the provenance of a parcel's scan: its motion, which the antennas' positions contain."""


@dataclass(frozen=True, kw_only=True)
class BeltStation(Bounded):
    """One fixed array."""

    name: str
    station_m: SignedM
    """Its position along the belt [m]."""
    tx_m: Annotated[tuple[Triple, ...], MinLen(1)]
    """Transmitter of each channel before the belt moves, (n_channels, 3) [m]."""
    rx_m: Annotated[tuple[Triple, ...], MinLen(1)]
    """Receiver of each channel, (n_channels, 3) [m]."""
    delays_s: tuple[float, ...]
    """Chirp of each channel after the time of its frame, (n_channels,) [s]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        counts = {len(self.tx_m), len(self.rx_m), len(self.delays_s)}
        if len(counts) > 1:
            msg = f"tx_m, rx_m and delays_s of array {self.name!r} differ in length"
            raise ValueError(msg)

    @property
    def n_channels(self) -> int:
        """Channels of a frame."""
        return len(self.tx_m)

    @property
    def phase_centers_m(self) -> Floats:
        """Middle of transmitter and receiver, (n_channels, 3) [m]."""
        return np.asarray(0.5 * (np.array(self.tx_m) + np.array(self.rx_m)))


@dataclass(frozen=True, kw_only=True)
class BeltRecord(Bounded):
    """Arrays of a belt and its timing."""

    arrays: Annotated[tuple[BeltStation, ...], MinLen(1)]
    speed_m_per_s: Annotated[float, Interval(gt=0.0, le=10.0)]
    """Nominal speed [m/s]."""
    frame_s: Seconds
    """From one recorded frame to the next [s]."""
    travel_m: LengthM
    """Travel past each array that belongs to a parcel, half of it before [m]."""
    has_encoder: bool = True
    """Whether the positions of the planes are an encoder's; else nominal speed times time."""
    format: Literal["geraf2-belt"] = "geraf2-belt"
    format_version: Literal[1] = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        names = [array.name for array in self.arrays]
        if len(set(names)) < len(names) or any("/" in name or not name for name in names):
            msg = f"arrays need different names without a slash, got {names}"
            raise ValueError(msg)

    def of_plane(self, name: str) -> BeltStation:
        """Array of a plane, by its name ARRAY/NUMBER; UserError for an unknown one."""
        wanted = name.rpartition("/")[0]
        for array in self.arrays:
            if array.name == wanted:
                return array
        raise UserError(
            what=f"plane {name!r} is of no array of the belt",
            expected=", ".join(array.name for array in self.arrays),
        )


def is_belt(scene: Path) -> bool:
    """Whether a scene folder has the record of a belt."""
    return (scene / BELT_NAME).is_file()


def read_belt(scene: Path) -> BeltRecord:
    """Read the record of a scene folder; UserError where there is none."""
    path = scene / BELT_NAME
    if not path.is_file():
        raise UserError(
            what=f"has no {BELT_NAME}", where=scene, hint="make a recording with its belt's arrays"
        )
    table = read_object(path)
    if table.get("format") != BELT_FORMAT:
        raise UserError(what="is no belt", where=path, expected=f'"format": "{BELT_FORMAT}"')
    return from_table(table, BeltRecord, path)


def write_belt(scene: Path, record: BeltRecord) -> None:
    """Write the record into a scene folder, whole or not at all."""
    write_json_atomic(scene / BELT_NAME, to_table(record))
