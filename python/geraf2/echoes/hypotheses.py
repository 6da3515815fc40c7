"""Candidates for the reflector of each peak: one per period of the direction cosines.

Antennas d apart do not distinguish the direction cosines u and u + wavelength / (2 d). Each peak
has a candidate in the direction of the image. It has one more for each period whose direction
exists and that lies in the box or on its wall (docs/math/images.md#direction-aliases).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from geraf2._types import Bools, Floats, Ints
from geraf2.echoes.wall_delay import box_delay_m
from geraf2.imaging.peaks import PeakSet, directions_at
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Pose, Wall

_LARGEST_COSINE = 0.9
"""Largest sine of the angle between a candidate's direction and the plane's normal: antennas do not
radiate beyond."""
_MAX_PERIODS = 2
"""Largest distance from the image's direction along each axis, in periods."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidates:
    """Possible reflectors of the peaks, as oriented points."""

    peaks: Ints
    """Peak of each candidate, (n,)."""
    positions: Floats
    """(n, 3) [m], corrected for the walls' delay."""
    normals: Floats
    """Unit vectors towards the antennas, (n, 3)."""
    is_alias: Bools
    """Whether the image shows a grating lobe of it, (n,)."""
    depth_m: Floats
    """Depth below the surface of the box, by the uncorrected range, (n,) [m]."""
    presence: Floats
    """Probability that the box extends to it, 1 where its faces are known, (n,)."""

    def __len__(self) -> int:
        return len(self.peaks)

    def select(self, keep: Bools | Ints) -> "Candidates":
        """Subset by mask or index."""
        return Candidates(**{name: getattr(self, name)[keep] for name in self.__dataclass_fields__})


def find_candidates(
    peaks: PeakSet,
    poses: Sequence[Pose],
    scene: MeshScene,
    walls: tuple[Wall, ...],
    *,
    wall_margin_m: float,
    range_correction_m: float | None = None,
) -> Candidates:
    """Candidates of all peaks: in the image's direction, and aliases in the box or on its wall.

    peaks: of any planes of `poses`.
    scene: outer surface of the box.
    walls: of the box, outermost first.
    wall_margin_m: half thickness of the layer with the wall's own echoes [m].
    range_correction_m: subtracted from every range [m]; None: by the walls.
    """
    parts = [
        _plane_candidates(peaks, number, poses[number].axes) for number in np.unique(peaks.planes)
    ]
    if not parts:
        nothing = np.zeros(0)
        return Candidates(
            peaks=np.zeros(0, dtype=np.int64),
            positions=np.zeros((0, 3)),
            normals=np.zeros((0, 3)),
            is_alias=np.zeros(0, dtype=bool),
            depth_m=nothing,
            presence=nothing,
        )
    peak, ahead, is_alias = (np.concatenate([part[k] for part in parts]) for k in range(3))
    centers, ranges_m = peaks.centers[peak], peaks.ranges_m[peak]
    positions = centers + ranges_m[:, None] * ahead
    depth_m = -scene.signed_distance(positions)
    found = Candidates(
        peaks=peak,
        positions=positions,
        normals=-ahead,
        is_alias=is_alias,
        depth_m=depth_m,
        presence=np.ones(len(peak)),
    ).select(~is_alias | (depth_m > -wall_margin_m))
    correction = (
        box_delay_m(
            scene, walls, peaks.centers[found.peaks], -found.normals, peaks.ranges_m[found.peaks]
        )
        if range_correction_m is None
        else np.full(len(found), range_correction_m)
    )
    return replace(found, positions=found.positions + correction[:, None] * found.normals)


def _plane_candidates(peaks: PeakSet, number: int, axes: Floats) -> tuple[Ints, Floats, Bools]:
    """Peak index, direction and alias flag of each candidate of a plane."""
    own = np.flatnonzero(peaks.planes == number)
    cosines = peaks.directions[own] @ axes[1:].T
    shifts = [
        period * np.arange(-_MAX_PERIODS, _MAX_PERIODS + 1) if np.isfinite(period) else (0.0,)
        for period in peaks.periods[peaks.subapertures[own[0]]]
    ]
    index, ahead, is_alias = [own], [peaks.directions[own]], [np.zeros(len(own), dtype=bool)]
    for shift in product(*shifts):
        if not any(shift):
            continue
        shifted = cosines + shift
        exists = (shifted**2).sum(axis=1) < _LARGEST_COSINE**2
        index.append(own[exists])
        ahead.append(directions_at(shifted[exists], axes))
        is_alias.append(np.ones(int(exists.sum()), dtype=bool))
    return np.concatenate(index), np.concatenate(ahead), np.concatenate(is_alias)
