"""Outside of a box from a scan, with standard deviations and bounds for unseen faces."""

from dataclasses import dataclass, field, replace
from enum import IntEnum
from itertools import product
from typing import Any

import numpy as np

from geraf2._types import Floats, Ints
from geraf2.calibration.cuboid_search import DelayOdds
from geraf2.errors import UserError
from geraf2.geometry.transforms import triple
from geraf2.scene import LosPrior

SKEW_RAD = float(np.deg2rad(0.34))
"""RMS angle by which a carton's opposite walls are off a right angle to the others, a property of
the simulated population [rad]. The yaw is the mean of both pairs, or that of one of them."""


class Seen(IntEnum):
    """Evidence of a face of the box."""

    NOT = 0
    """None: its position is a bound."""
    EDGES = 1
    """Echoes of its edges on neighbouring faces."""
    SQUARELY = 2
    """Flashes: antennas see it at a right angle, from the front or from behind."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FoundBox:
    """A cuboid of any orientation.

    Arrays (3, 2) of faces have one row per axis: the face against it, then the face along it.
    """

    axes: Floats
    """Unit vectors in rows; the last is nearest to the vertical, (3, 3)."""
    turn_sigma_rad: Floats
    """Standard deviations of rotations about the frame's axes, (3,) [rad]."""
    offsets_m: Floats
    """Offsets of the faces, outward from the frame's origin, (3, 2) [m]."""
    sigmas_m: Floats
    """Standard deviations of the offsets; infinite for unseen faces, (3, 2) [m]."""
    bounds_m: Floats
    """95 % intervals of the offsets, (3, 2, 2) [m]; infinite without a bound."""
    seen: Ints
    """`Seen` of each face, (3, 2)."""
    correlations: Floats = field(default_factory=lambda: np.zeros(3))
    """Of the offsets of opposite faces, which share the delay and the walls' thickness, (3,)."""
    content_share: float = 0.0
    """Share of the energy from within; near zero if the planes are those of a metal body."""
    delay: DelayOdds | None = None
    """Delays at which near and far walls lie on it."""
    delay_change_m: float = 0.0
    """Change of the recorded delay that it was found with, on the two-way path [m]."""

    @property
    def normals(self) -> Floats:
        """Outward unit normals of the faces, (3, 2, 3)."""
        return np.stack([-self.axes, self.axes], axis=1)

    @property
    def size_m(self) -> Floats:
        """Distances of opposite faces through the centre, (3,) [m]."""
        return np.asarray((self.offsets_m - self.normals @ self.center_m).sum(axis=1))

    @property
    def size_sigma_m(self) -> Floats:
        """Standard deviations of the sides, (3,) [m]; infinite with an unseen face."""
        finite = np.where(np.isfinite(self.sigmas_m), self.sigmas_m, 0.0)
        common = 2.0 * self.correlations * finite.prod(axis=1)
        return np.asarray(np.sqrt((self.sigmas_m**2).sum(axis=1) + common))

    @property
    def center_m(self) -> Floats:
        """Point as far from each face as from the opposite one, (3,) [m]."""
        (low, high), (against, along) = self.offsets_m.T, np.moveaxis(self.normals, 1, 0)
        return np.asarray(np.linalg.solve(along - against, high - low))

    @property
    def yaw_deg(self) -> float:
        """Rotation about the vertical from the nearest axis of the frame, -45 to 45 [degrees]."""
        first, nearest = self.axes[0], int(np.abs(self.axes[0]).argmax())
        frame = np.sign(first[nearest]) * np.eye(3)[nearest]
        return float(np.rad2deg(np.arctan2(self.axes[2] @ np.cross(frame, first), frame @ first)))

    @property
    def yaw_sigma_deg(self) -> float:
        """Standard deviation of the yaw [degrees]."""
        return float(np.rad2deg(np.linalg.norm(self.axes[2] * self.turn_sigma_rad)))

    def moved(self, shift_m: Floats) -> "FoundBox":
        """Box in a frame with a shifted origin."""
        shift = self.normals @ shift_m
        return replace(
            self, offsets_m=self.offsets_m + shift, bounds_m=self.bounds_m + shift[..., None]
        )

    @property
    def prior(self) -> LosPrior:
        """Line-of-sight prior with these sides, without walls; assumed faces are uncertain."""
        prior = LosPrior.from_box(triple(self.size_m), triple(self.center_m), axes=self.axes)
        if (self.seen != Seen.NOT).all():
            return prior
        least = np.where(self.seen == Seen.NOT, self.bounds_m[..., 0], self.offsets_m)
        corners = np.array(list(product(*(least * [-1.0, 1.0])))) @ self.axes
        return replace(prior, certain=corners)

    def numbers(self) -> dict[str, Any]:
        """Entry of run.json: lengths in metres, angles in degrees; None without a bound."""
        return {
            "size_m": _json_number(self.size_m),
            "size_sigma_m": _json_number(self.size_sigma_m),
            "center_m": _json_number(self.center_m),
            "axes": self.axes.round(6).tolist(),
            "yaw_deg": round(self.yaw_deg, 4),
            "yaw_sigma_deg": round(self.yaw_sigma_deg, 4),
            **self._delay_numbers(),
            "faces": {
                name: {
                    "seen": Seen(int(self.seen[k, side])).name.lower(),
                    "offset_m": _json_number(self.offsets_m[k, side]),
                    "sigma_m": _json_number(self.sigmas_m[k, side]),
                    "interval_m": _json_number(self.bounds_m[k, side]),
                }
                for name, k, side in face_names()
            },
        }

    def _delay_numbers(self) -> dict[str, float]:
        if self.delay is None:
            return {}
        return {
            "delay_odds": round(self.delay.odds, 2),
            "other_delay_m": round(self.delay.other_m, 4),
            "delay_change_m": round(self.delay_change_m, 4),
        }

    def _seen_text(self) -> str:
        """Faces by their evidence."""
        kinds = {
            kind: [name for name, k, side in face_names() if self.seen[k, side] == kind]
            for kind in (Seen.SQUARELY, Seen.EDGES, Seen.NOT)
        }
        where = " ".join(f"{1e3 * off:.0f}" for off in self.offsets_m[self.seen == Seen.NOT])
        texts = (
            "seen squarely",
            "by their edges",
            f"not seen: assumed {where} mm from the frame's origin",
        )
        return ", ".join(
            f"{' '.join(n)} {t}" for n, t in zip(kinds.values(), texts, strict=True) if n
        )

    def __str__(self) -> str:
        sizes = []
        for size, sigma in zip(self.size_m, self.size_sigma_m, strict=True):
            error = f" +- {1e3 * sigma:.1f}" if np.isfinite(sigma) else ""
            sizes.append(f"{1e3 * size:.1f}{error}")
        turn = f"{self.yaw_deg:z.2f} +- {self.yaw_sigma_deg:.2f} degrees"
        return f"box of {' x '.join(sizes)} mm, turned by {turn}; faces {self._seen_text()}"


def face_names() -> list[tuple[str, int, int]]:
    """Name, axis and column of each face of a box."""
    return [(f"{'-+'[side]}{'xyz'[k]}", k, side) for k in range(3) for side in range(2)]


def _json_number(values: Floats | float) -> Any:
    """Lengths as JSON numbers, rounded to a micrometre; None if not finite."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim:
        return [_json_number(value) for value in array]
    return round(float(array), 6) if np.isfinite(array) else None


class NoBoxError(UserError):
    """A scan shows no box."""

    delay_change_m = 0.0
    """Change of the recorded delay, on the two-way path, that the scan shows nevertheless [m]."""


class NoCuboidError(NoBoxError):
    """The walls that a scan shows are not those of a cuboid."""

    def __init__(self) -> None:
        super().__init__(
            what="the walls of the box fit no cuboid",
            expected="four upright walls at right angles",
            got="echoes of walls in other directions, as of a tube",
            hint="give the outside of the box with --los MESH, or --box X Y Z if it is a cuboid",
        )


class WallsNotFoundError(NoBoxError):
    """A scan shows no walls of a box."""

    def __init__(self, seen: str) -> None:
        super().__init__(
            what="no walls of a box are found in the scan",
            expected="flashes of at least one flat wall that antennas face squarely",
            got=seen,
            hint="give the outside of the box with --box X Y Z or --los MESH",
        )
        self.seen = seen
        """Description of what the scan shows instead."""
