"""What the box's walls add to the range of an echo from inside."""

from dataclasses import dataclass

import numpy as np

from geraf2._types import Floats
from geraf2.geometry.boxes import beyond_sides
from geraf2.geometry.triangles import unit_normals
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Wall

# A wall's own echo lies within this of the prior's surface [m]: 4 mm of cardboard put it 2.5 mm
# behind the outer face, and priors are a few millimetres off.
_WALL_SEARCH_M = 0.010
# Wall echoes are used where the line of sight meets the wall within this angle [rad].
_WALL_ANGLE_RAD = 0.1
# Fewer wall echoes than this do not make an estimate.
_MIN_WALL_ECHOES = 12


def box_delay_m(
    scene: MeshScene, walls: tuple[Wall, ...], centers: Floats, directions: Floats, ranges_m: Floats
) -> Floats:
    """Excess one-way path of plane walls between each antenna and its echo, (n,) [m].

    A slab of thickness t and permittivity eps, met at the angle theta, adds
    t (sqrt(eps - sin^2 theta) - cos theta). Every wall is met at the angle at which the line of
    sight enters the prior's surface; inner walls count where the echo lies inside them.

    scene: the prior's outer surface.
    walls: outermost first.
    centers: antenna positions, (n, 3) [m].
    directions: unit vectors to the echoes, (n, 3).
    ranges_m: distances of the echoes, (n,) [m].
    """
    if len(ranges_m) == 0:
        return np.zeros(0)
    entry, face = scene.closest_hit(centers, directions)
    normals = unit_normals(scene.vertices[scene.faces])
    cosine = np.abs(np.einsum("ij,ij->i", directions, normals[np.maximum(face, 0)]))
    entered = (face >= 0) & (entry < ranges_m)
    positions = centers + directions * ranges_m[:, None]
    total = np.zeros(len(ranges_m))
    for number, wall in enumerate(walls):
        excess = wall.thickness_m * (np.sqrt(wall.permittivity - 1.0 + cosine**2) - cosine)
        if number == 0:
            crossed = entered
        else:
            beyond = beyond_sides(positions, wall.center_m, wall.size_m)
            crossed = entered & (beyond <= 0.0).all(axis=1)
        total += np.where(crossed, excess, 0.0)
    return total


@dataclass(frozen=True, kw_only=True, eq=False)
class WallEcho:
    """Echoes among which those of the walls are."""

    centers: Floats
    """(n, 3) [m]."""
    directions: Floats
    """(n, 3)."""
    ranges_m: Floats
    """(n,) [m]."""
    magnitudes: Floats
    """(n,)."""
    depth_m: Floats
    """Signed distance below the prior's surface, (n,) [m]."""


def learn_wall_delay(echoes: WallEcho, scene: MeshScene) -> float:
    """Range correction for echoes from inside, from the echoes of the walls themselves [m].

    With wall thickness t, index n = sqrt(eps) and a constant range error b, the near wall's two
    faces echo as one from n t / 2 + b behind the outer face, the far wall, seen through the near
    one, from 3 n t / 2 - 2 t + b behind its outer face; their mean is (n - 1) t + b, just what an
    echo from inside is late by (docs/math/echoes.md#wall-delay). When no far wall is seen, half of
    the near wall's offset stands in for it (exact for n = 4/3); 0 when no wall is seen at all.
    """
    if len(echoes.ranges_m) == 0:
        return 0.0
    crossings = scene.entry_exit(echoes.centers, echoes.directions)
    if crossings.t_entry.shape[1] == 0:
        return 0.0
    t_near, t_far = crossings.t_entry[:, 0], crossings.t_exit[:, 0]
    near = _median_offset(echoes, scene, t_near)
    far = _median_offset(echoes, scene, t_far)
    if near is None:
        return 0.0
    if far is None:
        return 0.5 * near
    return 0.5 * (near + far)


def _median_offset(echoes: WallEcho, scene: MeshScene, t_wall: Floats) -> float | None:
    """Strength-weighted median of range minus the wall's distance [m]; None without echoes."""
    seen = np.isfinite(t_wall)
    t_wall = np.where(seen, t_wall, 0.0)
    offset = echoes.ranges_m - t_wall
    seen &= np.abs(offset) < _WALL_SEARCH_M
    points = echoes.centers + echoes.directions * t_wall[:, None]
    # Normal of the surface from the change of its distance over 1 mm along the line of sight.
    step = 1e-3
    before = scene.signed_distance(points - step * echoes.directions)
    seen &= np.abs(np.abs(before) / step) > np.cos(_WALL_ANGLE_RAD)
    if int(seen.sum()) < _MIN_WALL_ECHOES:
        return None
    order = np.argsort(offset[seen])
    weight = np.cumsum(echoes.magnitudes[seen][order])
    middle = int(np.searchsorted(weight, 0.5 * weight[-1]))
    return float(offset[seen][order][middle])
