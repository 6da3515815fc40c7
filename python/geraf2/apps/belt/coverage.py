"""What the arrays of a belt see of a parcel, and what they cost."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from geraf2._types import Floats, Ints
from geraf2.freespace.specular import inner_points, received_normals, sphere_points
from geraf2.scene.aperture import Aperture
from geraf2.simulation.belt import belt_planes, belt_record
from geraf2.simulation.belt_spec import BeltSpec

SIDES = ("front", "back", "left", "right", "above", "below")
"""Sides of a parcel: of normals along x, -x, y, -y, z and -z, the nearest of these."""
# Transmitters and receivers of one radar chip.
_CHIP_TX, _CHIP_RX = 3, 4
# A side of which less is seen counts as never seen: 4,000 normals, 9 points.
_MIN_SEEN = 0.005


@dataclass(frozen=True, kw_only=True)
class Coverage:
    """What the arrays up to one of a list see together."""

    array: str
    """Name of the last array."""
    n_boards: int
    """Of all these arrays."""
    n_chips: int
    """Radar chips of 3 transmitters and 4 receivers on them."""
    seen_share: float
    """Of the sphere of normals, mean over the middle of the parcel."""
    by_side: dict[str, float]
    """The same for the normals of each side of the parcel."""

    @property
    def never_seen(self) -> tuple[str, ...]:
        """Sides of which no normal is seen."""
        return tuple(side for side, share in self.by_side.items() if share < _MIN_SEEN)


def coverage(belt: BeltSpec, box_m: tuple[float, float, float]) -> Iterator[Coverage]:
    """Yield what the first array sees, the first two, and so on.

    belt: arrays and travel. box_m: sides of the parcel, whose inner third holds the content [m].
    """
    normals, points = sphere_points(4000), inner_points(np.zeros(3), np.array(box_m))
    sides, record = _sides(normals), belt_record(belt)
    whole = belt_planes(replace(belt, segment_m=belt.travel_m), 0)
    seen = np.zeros((len(points), len(normals)), dtype=bool)
    n_boards, n_chips = 0, 0
    for spec, station, (plane, _) in zip(belt.arrays, record.arrays, whole, strict=True):
        positions = 0.5 * (plane.tx + plane.rx) @ plane.axes.T
        aperture = Aperture(
            axes=plane.axes, low_m=positions.min(axis=0), high_m=positions.max(axis=0)
        )
        seen |= [received_normals([aperture], normals, point)[:, 0] for point in points]
        n_tx, n_rx = spec.n_antennas_of_board()
        n_boards += spec.n_boards
        n_chips += spec.n_boards * max(-(-n_tx // _CHIP_TX), -(-n_rx // _CHIP_RX))
        share = seen.mean(axis=0)
        yield Coverage(
            array=station.name,
            n_boards=n_boards,
            n_chips=n_chips,
            seen_share=float(share.mean()),
            by_side={name: float(share[sides == k].mean()) for k, name in enumerate(SIDES)},
        )


def _sides(normals: Floats) -> Ints:
    """Index into SIDES of each normal, (n,)."""
    axis = np.abs(normals).argmax(axis=1)
    return np.asarray(2 * axis + (normals[np.arange(len(normals)), axis] < 0.0))
