"""Walls of real boxes: bulged, skewed, turned, lossy, with edges and tape that echo."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from geraf2._types import Floats
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Wall, Waveform
from geraf2.simulation.spec import SceneSpec
from geraf2.simulation.streams import stream

# Half waves of a bulge along each side of a wall; weights fall as a clamped plate's do, with the
# square of their number.
_N_MODES = 3
_N_PROBES = 41  # per side, on which the largest displacement is found
_LINE_STEP_M = 0.0009  # a quarter of the wavelength at 81 GHz
_LIFT_M = 1e-4  # lines lie this far outside the box, so that the nearer ones do not cross it
_TAPE_WIDTH_M, _TAPE_END_M = 0.048, 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxScene:
    """Object, walls and chirp, the common part of all echo computations."""

    blocker: MeshScene
    """The metal object, which hides. Walls attenuate and delay, but do not hide."""
    walls: tuple[Wall, ...]
    """Boxes that rays cross, outermost first; all antennas are outside."""
    waveform: Waveform
    """The chirp."""
    wall_amplitude: float = 1.0
    """Amplitude factor of one crossing of a wall, beside the reflection of its faces."""
    num_threads: int = 1
    """Threads to use."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WallShape:
    """Deviation of the six walls of a box from planes; both faces of a wall deviate equally.

    The displacement of wall (axis, side) at (u, v), measured outward, is

        d(u, v) = sum_mn w_mn sin(m pi (u + U) / 2U) sin(n pi (v + V) / 2V) + skew,

    u and v the coordinates along the axes (axis + 1) mod 3 and (axis + 2) mod 3 from the box's
    centre, U and V its outer half sides. skew = side * tan(skew angle) * u on the walls across x,
    where u is y: the box's cross section is a parallelogram.
    """

    half_m: Floats
    """Outer half sides, (3,) [m]."""
    weights_m: Floats
    """w, (axis, side 0 negative or 1 positive, m - 1, n - 1), (3, 2, 3, 3) [m]."""
    skew: float = 0.0
    """Tangent of the skew angle."""

    def displacement(self, axis: int, side: float, u: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Displacement d (...) [m], and its derivatives along u and v, (..., 2).

        axis: normal to the wall.
        side: -1 or 1.
        u, v: positions on the wall, see above, equal shapes [m].
        """
        weights = self.weights_m[axis, int(side > 0)]
        number = np.arange(1, _N_MODES + 1)
        rates = [0.5 * np.pi * number / self.half_m[(axis + k) % 3] for k in (1, 2)]
        angles = [
            (position + self.half_m[(axis + k) % 3])[..., None] * rate
            for k, position, rate in zip((1, 2), (u, v), rates, strict=True)
        ]
        (sin_u, sin_v), (cos_u, cos_v) = (
            [np.asarray(f(angle)) for angle in angles] for f in (np.sin, np.cos)
        )
        shift = np.einsum("...m,mn,...n->...", sin_u, weights, sin_v)
        along_u = np.einsum("...m,mn,...n->...", cos_u * rates[0], weights, sin_v)
        along_v = np.einsum("...m,mn,...n->...", sin_u, weights, cos_v * rates[1])
        if axis == 0:
            shift, along_u = shift + side * self.skew * u, along_u + side * self.skew
        return np.asarray(shift), np.stack([along_u, along_v], axis=-1)

    @property
    def reach_m(self) -> float:
        """Upper bound of the displacement of all walls [m]."""
        return float(np.abs(self.weights_m).sum(axis=(2, 3)).max() + self.skew * self.half_m[1])


def wall_shapes(spec: SceneSpec, seed: int) -> tuple[WallShape | None, ...]:
    """Shape of each box's walls; None each where they are plane.

    spec: the scene; each wall bulges by `world.wall_bulge_m` at most, in or out.
    seed: of the bulges.
    """
    world = spec.world
    if not world.wall_bulge_m and not world.box_skew_deg:
        return (None,) * len(spec.walls)
    return tuple(
        WallShape(
            half_m=0.5 * np.asarray(wall.size_m),
            weights_m=world.wall_bulge_m * _unit_bulges(stream(seed, "bulge", number)),
            skew=float(np.tan(np.deg2rad(world.box_skew_deg))),
        )
        for number, wall in enumerate(spec.walls)
    )


def _unit_bulges(rng: np.random.Generator) -> Floats:
    """Random weights of six walls, each with a largest displacement of one."""
    number = np.arange(1, _N_MODES + 1)
    fall = 2.0 / (np.square(number)[:, None] + np.square(number))
    weights = fall * rng.normal(size=(3, 2, _N_MODES, _N_MODES))
    sines = np.sin(np.pi * np.linspace(0.0, 1.0, _N_PROBES)[:, None] * number)
    bulges = np.einsum("im,asmn,jn->asij", sines, weights, sines)
    return np.asarray(weights / np.abs(bulges).max(axis=(2, 3), keepdims=True))


def box_turn(spec: SceneSpec) -> tuple[Floats, Floats]:
    """Rotation from the capture's frame into that of the turned boxes, and its centre.

    The simulator works in the frame of the boxes, in which they are not turned: object and
    antennas are turned oppositely about the outermost box's vertical axis.

    Returns the rotation, (3, 3), and the centre, (3,) [m].
    """
    center = np.asarray(spec.walls[0].center_m) if spec.walls else np.zeros(3)
    turn = Rotation.from_euler("z", -spec.world.box_turn_deg, degrees=True)
    return turn.as_matrix(), center


def edge_lines(wall: Wall) -> list[Floats]:
    """Points along the twelve edges of a box and along its tape, (n, 3) each [m].

    The tape lies along y over the middle of top and bottom, and 5 cm down the sides; its two edges
    are lines.

    wall: the box.
    """
    half = 0.5 * np.asarray(wall.size_m) + _LIFT_M
    ends = [
        (np.roll([-half[k], y, z], k), np.roll([half[k], y, z], k))
        for k in range(3)
        for y in (-half[(k + 1) % 3], half[(k + 1) % 3])
        for z in (-half[(k + 2) % 3], half[(k + 2) % 3])
    ]
    for x in (-0.5 * _TAPE_WIDTH_M, 0.5 * _TAPE_WIDTH_M):
        for up in (-1.0, 1.0):
            top = up * half[2]
            below = up * max(half[2] - _TAPE_END_M, 0.0)
            ends.append((np.array([x, -half[1], top]), np.array([x, half[1], top])))
            ends += [(np.array([x, y, top]), np.array([x, y, below])) for y in (-half[1], half[1])]
    lines = []
    for start, end in ends:
        n = int(np.ceil(np.linalg.norm(end - start) / _LINE_STEP_M))
        share = (np.arange(n)[:, None] + 0.5) / n
        lines.append(start + share * (end - start) + np.asarray(wall.center_m))
    return lines
