"""Outside of a box or tube from a scan, with standard deviations and bounds for unseen faces."""

from dataclasses import dataclass, field, replace
from enum import IntEnum
from itertools import product
from typing import Any

import numpy as np

from geraf2._types import Floats, Ints
from geraf2.errors import UserError
from geraf2.geometry.boxes import FACES, SIGNS
from geraf2.geometry.transforms import triple
from geraf2.scene import LosPrior

SKEW_RAD = float(np.deg2rad(0.34))
"""RMS angle by which a carton's opposite walls are off a right angle to the others, a property of
the simulated population [rad]. The yaw is the mean of both pairs, or that of one of them."""
_N_SIDES = 128
"""Sides of the polygon that stands for a tube: within 0.1 mm of a radius of 0.3 m."""


class Seen(IntEnum):
    """Evidence of a face of the box."""

    NOT = 0
    """None: its position is a bound."""
    EDGES = 1
    """Echoes of its edges on neighbouring faces."""
    SQUARELY = 2
    """Flashes: antennas see it at a right angle, from the front or from behind."""
    GIVEN = 3
    """By the given prior."""


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

    @property
    def normals(self) -> Floats:
        """Outward unit normals of the faces, (3, 2, 3)."""
        return _along(self.axes)

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

    def _seen_text(self) -> str:
        """Faces by their evidence."""
        kinds = {
            kind: [name for name, k, side in face_names() if self.seen[k, side] == kind]
            for kind in (Seen.SQUARELY, Seen.EDGES, Seen.GIVEN, Seen.NOT)
        }
        where = " ".join(f"{1e3 * off:.0f}" for off in self.offsets_m[self.seen == Seen.NOT])
        texts = (
            "seen squarely",
            "by their edges",
            "as given",
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


@dataclass(frozen=True, kw_only=True, eq=False)
class FoundTube(FoundBox):
    """A tube or drum: the upright cylinder in this cuboid."""

    @property
    def radius_m(self) -> float:
        """Radius of the outer side [m]."""
        return 0.25 * float(self.size_m[:2].sum())

    @property
    def prior(self) -> LosPrior:
        """Line-of-sight prior of the cylinder, without walls."""
        turn = 2.0 * np.pi * np.arange(_N_SIDES) / _N_SIDES
        rim = self.radius_m * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        half = 0.5 * self.size_m[2]
        ends = [np.column_stack([rim, np.full(_N_SIDES, z)]) for z in (-half, half)]
        vertices = np.concatenate([*ends, [[0.0, 0.0, -half], [0.0, 0.0, half]]])
        i = np.arange(_N_SIDES)
        j, low, high = (i + 1) % _N_SIDES, np.full(_N_SIDES, 2 * _N_SIDES), 2 * _N_SIDES + 1
        faces = np.concatenate(
            [
                np.stack([i, j, j + _N_SIDES], axis=1),
                np.stack([i, j + _N_SIDES, i + _N_SIDES], axis=1),
                np.stack([low, j, i], axis=1),
                np.stack([np.full(_N_SIDES, high), i + _N_SIDES, j + _N_SIDES], axis=1),
            ]
        )
        return LosPrior(vertices=vertices @ self.axes + self.center_m, faces=faces)

    def numbers(self) -> dict[str, Any]:
        """Entry of run.json: of the faces, top and bottom alone."""
        numbers = super().numbers()
        numbers["faces"] = {name: numbers["faces"][name] for name in ("-z", "+z")}
        sigma_m = 0.5 * float(np.linalg.norm(self.sigmas_m[0]))
        return {
            "shape": "tube",
            "radius_m": _json_number(self.radius_m),
            "radius_sigma_m": _json_number(sigma_m),
            **{key: numbers[key] for key in ("size_m", "center_m", "axes", "faces")},
        }

    def __str__(self) -> str:
        sigma_mm = 500.0 * float(np.linalg.norm(self.sigmas_m[0]))
        ends = replace(self, seen=np.where([[False], [False], [True]], self.seen, -1))
        return (
            f"tube of radius {1e3 * self.radius_m:.1f} +- {sigma_mm:.1f} mm, "
            f"{1e3 * self.size_m[2]:.0f} mm high; ends {ends._seen_text()}"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class FoundBody(FoundBox):
    """A box of six planes that is no cuboid: its corners are skewed, or its walls lean."""

    planes: Floats
    """Outward unit normals of the faces, (3, 2, 3)."""
    angle_sigmas_rad: Floats
    """Standard deviations of their yaw and lean, (3, 2, 2) [rad]."""

    @property
    def normals(self) -> Floats:
        """Outward unit normals of the faces, (3, 2, 3)."""
        return self.planes

    @property
    def prior(self) -> LosPrior:
        """Line-of-sight prior of the body, without walls."""
        of = np.arange(3), (SIGNS > 0.0).astype(np.int64)
        corners = np.linalg.solve(self.planes[of], self.offsets_m[of][..., None])[..., 0]
        return LosPrior(vertices=np.asarray(corners), faces=FACES.copy())

    @property
    def angles_rad(self) -> Floats:
        """Yaw of each wall from the side of the nearest cuboid, and outward lean, (2, 2, 2)."""
        walls, sides = self.planes[:2] @ self.axes.T, _along(np.eye(3))[:2]
        lean = np.arcsin(walls[..., 2])
        yaw = np.arctan2(np.cross(sides, walls)[..., 2], (sides * walls)[..., :2].sum(axis=-1))
        return np.stack([yaw, lean], axis=-1)

    def contradiction(self) -> float:
        """Deviation of the seen walls from the best cuboid: root of chi-square."""
        k, side = np.nonzero(self.seen[:2] == Seen.SQUARELY)
        # A cuboid's turn changes all yaws alike, and leans of opposite walls against each other.
        turns = np.zeros((len(k), 2, 3))
        turns[:, 0, 2] = 1.0
        turns[np.arange(len(k)), 1, k] = 2.0 * side - 1.0
        sigmas = np.hypot(self.angle_sigmas_rad[k, side], SKEW_RAD)
        matrix = (turns / sigmas[..., None]).reshape(-1, 3)
        values = (self.angles_rad[k, side] / sigmas).ravel()
        rest = values - matrix @ np.linalg.lstsq(matrix, values, rcond=None)[0]
        return float(np.linalg.norm(rest))

    def numbers(self) -> dict[str, Any]:
        """Entry of run.json, with each normal and the errors of its yaw and lean."""
        numbers = super().numbers() | {"shape": "no cuboid"}
        for name, k, side in face_names():
            numbers["faces"][name] |= {
                "normal": self.planes[k, side].round(6).tolist(),
                "angle_sigmas_deg": _json_number(np.rad2deg(self.angle_sigmas_rad[k, side])),
            }
        return numbers

    def __str__(self) -> str:
        yaw, lean = np.rad2deg(np.moveaxis(self.angles_rad, -1, 0))
        sigmas = np.rad2deg(self.angle_sigmas_rad[self.seen == Seen.SQUARELY])
        # Corners in a turn: +x +y, +y -x, -x -y, -y +x.
        turn = np.array([yaw[0, 1], yaw[1, 1], yaw[0, 0], yaw[1, 0]])
        corners = 90.0 - (np.roll(turn, -1) - turn)
        size = " x ".join(f"{1e3 * side:.1f}" for side in self.size_m)
        return (
            f"box of {size} mm that is no cuboid: corners of "
            f"{' '.join(f'{c:.1f}' for c in corners)} degrees, walls "
            f"{' '.join(n for n, *_ in face_names()[:4])} lean outward by "
            f"{' '.join(f'{a:z.1f}' for a in lean.ravel())} +- {sigmas.max(initial=0.0):.1f} "
            f"degrees; faces {self._seen_text()}"
        )


def _along(axes: Floats) -> Floats:
    """Outward normals of a cuboid's faces, (3, 2, 3)."""
    return np.stack([-axes, axes], axis=1)


def face_names() -> list[tuple[str, int, int]]:
    """Name, axis and column of each face of a box."""
    return [(f"{'-+'[side]}{'xyz'[k]}", k, side) for k in range(3) for side in range(2)]


def _json_number(values: Floats | float) -> Any:
    """Lengths as JSON numbers, rounded to a micrometre; None if not finite."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim:
        return [_json_number(value) for value in array]
    return round(float(array), 6) if np.isfinite(array) else None


class WallsNotFoundError(UserError):
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
