"""Which isosurface of a relative distance is the surface: that which best explains the signals."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from geraf2._bounds import Bounded, Count, Few, LengthM
from geraf2._types import Bools, Floats, Ints
from geraf2.fields import SdfGrid
from geraf2.geometry.triangles import face_areas, vertex_normals
from geraf2.imaging.volume import pose_image
from geraf2.ops import signal_tracer
from geraf2.scene import Capture, Pose
from geraf2.surfaces.fit import zero_level

Shown = Callable[[Floats, Ints], Ints]
"""Vertices, triangles -> triangles that are to be of the surface."""

# Voxels at which simulated and measured heat maps are compared.
_N_POSITIONS = 2000


LEVEL_VERSION = 2
"""Raised when another level is chosen of the same field."""


@dataclass(frozen=True, kw_only=True)
class LevelConfig(Bounded):
    """How the level of an isosurface is chosen."""

    reach_m: LengthM = 0.02
    """Levels are tried up to this far to both sides [m]."""
    n_levels: Few = 17
    """How many."""
    n_planes: Count = 6
    """Planes on which they are compared."""
    n_points: Annotated[int, Interval(ge=1, le=10**8)] = 20000
    """Points of each isosurface that are simulated."""


def best_level(
    relative: SdfGrid,
    counted: Bools,
    capture: Capture,
    middle_m: float,
    config: LevelConfig,
    *,
    shown: Shown | None = None,
    num_threads: int | None = None,
) -> float:
    """Level whose isosurface, simulated, gives the heat maps most like the measured ones [m].

    Likeness is the mean over some planes of the cosine between the magnitudes of both at random
    voxels; the surface is simulated as equal mirrors on its side that faces the plane.

    relative: distance up to a constant, rising outwards.
    counted: voxels that are not cropped, its grid's shape.
    middle_m: middle of the levels tried [m].
    shown: which triangles of an isosurface are simulated; all when None.
    """
    steps = np.linspace(-config.reach_m, config.reach_m, config.n_levels)
    numbers = np.linspace(0, len(capture.poses), config.n_planes, endpoint=False).astype(int)
    poses = [capture.poses[number] for number in dict.fromkeys(numbers.tolist())]
    rng = np.random.default_rng(0)
    inside = np.flatnonzero(counted.ravel())
    chosen = rng.choice(inside, min(_N_POSITIONS, inside.size), replace=False)
    positions = relative.grid.points()[chosen]
    measured = [_heat(pose.signal, pose, positions, capture, num_threads) for pose in poses]
    scores: list[float] = []
    for level in middle_m + steps:
        vertices, faces = isosurface(relative, counted, level)
        if shown is not None:
            faces = shown(vertices, faces)
        points, normals = _surface_points(vertices, faces, config.n_points, rng)
        score = 0.0
        for pose, heat in zip(poses, measured, strict=True):
            facing = np.einsum("nk,k->n", normals, pose.axes[0]) < 0.0
            if facing.any():
                signal = signal_tracer(
                    np.ones(int(facing.sum()), np.float32),
                    points[facing],
                    pose.tx_positions,
                    pose.rx_positions,
                    capture.waveform,
                    normals=normals[facing],
                    num_threads=num_threads,
                )
                score += _likeness(heat, _heat(signal, pose, positions, capture, num_threads))
        scores.append(score / len(poses))
    return float(middle_m + steps[int(np.argmax(scores))])


def isosurface(relative: SdfGrid, counted: Bools, level: float) -> tuple[Floats, Ints]:
    """Triangles of a level inside the counted voxels; none where the level lies elsewhere."""
    values = np.where(counted, relative.values - np.float32(level), np.float32(1e-3))
    if not values.min() < 0.0:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    return zero_level(SdfGrid(grid=relative.grid, values=values))


def _heat(
    signal: NDArray[np.complex64],
    pose: Pose,
    positions: Floats,
    capture: Capture,
    num_threads: int | None,
) -> Floats:
    image = pose_image(pose, positions, capture.waveform, signal=signal, num_threads=num_threads)
    return np.asarray(np.abs(image), dtype=np.float64)


def _likeness(a: Floats, b: Floats) -> float:
    """Cosine of two heat maps."""
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size > 0.0 else 0.0


def _surface_points(
    vertices: Floats, faces: Ints, n_points: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Points uniform by area, and the normals there, each (n_points, 3)."""
    if not len(faces):
        return np.zeros((0, 3)), np.zeros((0, 3))
    corners = vertices[faces]
    area = face_areas(corners)
    face = rng.choice(len(faces), n_points, p=area / area.sum())
    u, v = np.sqrt(rng.uniform(size=n_points)), rng.uniform(size=n_points)
    weights = np.stack([1.0 - u, u * (1.0 - v), u * v], axis=1)
    smooth = vertex_normals(vertices, faces)[faces[face]]
    normals = np.einsum("nk,nkd->nd", weights, smooth)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return np.einsum("nk,nkd->nd", weights, corners[face]), normals
