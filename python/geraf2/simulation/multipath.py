"""Multipath via object and wall, by the mirror images of the antennas.

Equations: docs/math/echo-models.md#multipath-via-a-wall.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Bools, Floats
from geraf2.geometry.transforms import triple
from geraf2.ops.physical_optics import AntennaBlocks, SurfaceElements, physical_optics
from geraf2.scene import Wall
from geraf2.simulation.dielectric import face_reflection, n_crossings
from geraf2.simulation.elements import select
from geraf2.simulation.scan import block_centers
from geraf2.simulation.walls import BoxScene

_LIFT_M = 2e-5  # rays leave a facet this far above it


@dataclass(frozen=True, kw_only=True)
class Mirror:
    """Inner side of one wall of a box."""

    wall: int
    """Number of the box."""
    axis: int
    """Axis normal to the wall."""
    side: float
    """-1 or 1."""

    def position_m(self, walls: Sequence[Wall]) -> float:
        """Coordinate of its plane on the axis [m]."""
        wall = walls[self.wall]
        half = 0.5 * wall.size_m[self.axis] - wall.thickness_m
        return float(wall.center_m[self.axis] + self.side * half)

    def image(self, positions: Floats, walls: Sequence[Wall]) -> Floats:
        """Mirror images of positions, (n, 3) [m]."""
        found = positions.copy()
        found[..., self.axis] = 2.0 * self.position_m(walls) - found[..., self.axis]
        return found


def unfold_walls(walls: Sequence[Wall], mirror: Mirror) -> tuple[Wall, ...]:
    """Boxes that a straight path to a mirror image crosses.

    The mirror's box and those around it are joined with their image: the path does not cross the
    wall that reflects it. Boxes within occur twice.

    walls: the boxes, outermost first.
    """
    position_m, found = mirror.position_m(walls), []
    for number, wall in enumerate(walls):
        center, size = np.array(wall.center_m), np.array(wall.size_m)
        if number <= mirror.wall:
            open_end = center[mirror.axis] - mirror.side * 0.5 * size[mirror.axis]
            center[mirror.axis] = position_m
            size[mirror.axis] = 2.0 * abs(position_m - open_end)
            found.append(replace(wall, center_m=triple(center), size_m=triple(size)))
        else:
            image = mirror.image(center, walls)
            found += [wall, replace(wall, center_m=triple(image))]
    return tuple(found)


def multipath_echo(
    facets: SurfaceElements, areas: Floats, antennas: AntennaBlocks, scene: BoxScene
) -> NDArray[np.complex64]:
    """Multipath via each wall: antenna, object, wall, antenna, and the reverse.

    The wall is plane; it reflects with both of its faces, seen from the middle of each block.

    facets: of the object.
    areas: of the facets, times their reflectivity, (n_points,) [m^2].
    antennas: of one plane, in blocks.
    scene: the boxes.

    Returns the signal, (n_antennas, n_samples).
    """
    signal = np.zeros((len(antennas.tx), scene.waveform.n_samples), dtype=np.complex64)
    for wall, axis, side in product(range(len(scene.walls)), range(3), (-1.0, 1.0)):
        mirror = Mirror(wall=wall, axis=axis, side=side)
        height = mirror.side * (mirror.position_m(scene.walls) - antennas.tx[:, mirror.axis])
        if height.min() <= 0.0:  # the antennas lie behind this wall
            continue
        seen = _find_visible(facets, antennas, mirror, scene)
        used = np.asarray(seen.any(axis=0))
        if used.any():
            weights = seen[:, used] * areas[used]
            signal += _mirror_echo(select(facets, used), weights, antennas, mirror, scene)
    return signal


def _find_visible(
    facets: SurfaceElements, antennas: AntennaBlocks, mirror: Mirror, scene: BoxScene
) -> Bools:
    """Whether a facet sees a block's centre, and sees it in the mirror, (n_blocks, n_points)."""
    points, normals, walls, blocker = facets.points, facets.normals, scene.walls, scene.blocker
    assert normals is not None
    wall = walls[mirror.wall]
    across = [k for k in range(3) if k != mirror.axis]
    half = 0.5 * np.asarray(wall.size_m)[across] - wall.thickness_m
    starts = points + _LIFT_M * normals
    centers = block_centers(antennas)
    seen = np.zeros((len(centers), len(points)), dtype=np.bool_)
    for block, center in enumerate(centers):
        image = mirror.image(center, walls)
        lit = (np.einsum("pi,pi->p", center - points, normals) > 0.0) & (
            np.einsum("pi,pi->p", image - points, normals) > 0.0
        )
        at = starts[lit]
        share = (mirror.position_m(walls) - at[:, mirror.axis]) / (image - at)[:, mirror.axis]
        met = at + share[:, None] * (image - at)
        off = np.abs(met - np.asarray(wall.center_m))[:, across]
        rows = np.flatnonzero(lit)[(off < half).all(axis=1)]
        at, met = starts[rows], met[(off < half).all(axis=1)]
        to_center = np.broadcast_to(center, at.shape)
        hidden = blocker.occluded(at, met) | blocker.occluded(at, to_center)
        hidden |= blocker.occluded(met, to_center)
        seen[block, rows[~hidden]] = True
    return seen


def _mirror_echo(
    facets: SurfaceElements,
    weights: Floats,
    antennas: AntennaBlocks,
    mirror: Mirror,
    scene: BoxScene,
) -> NDArray[np.complex64]:
    """Both directions of the path via one mirror, by both faces of its wall."""
    walls, waveform, wall_amplitude = scene.walls, scene.waveform, scene.wall_amplitude
    slab, boxes = walls[mirror.wall], unfold_walls(walls, mirror)
    centers = block_centers(antennas)
    images = mirror.image(centers, walls)
    if wall_amplitude != 1.0:
        crossed = n_crossings(centers, facets.points, boxes)
        weights = weights * wall_amplitude ** (crossed + n_crossings(images, facets.points, boxes))
    k = 2.0 * np.pi / waveform.center_wavelength_m
    signal = np.zeros((len(antennas.tx), waveform.n_samples), dtype=np.complex64)
    for there, back in ((antennas.tx, antennas.rx), (antennas.rx, antennas.tx)):
        # From `there` to the object, via the wall to `back`; both directions have the same echo.
        ends = replace(antennas, tx=there, rx=mirror.image(back, walls), pattern_exponent=0)
        leg = block_centers(replace(ends, tx=ends.rx))[:, None] - facets.points
        cosine = np.abs(leg[..., mirror.axis]) / np.linalg.norm(leg, axis=2)
        gain = _gain(antennas, facets.points, leg, mirror)
        r = face_reflection(cosine, slab.permittivity)
        # The second face's path differs from facet to facet: its mean is path, the rest is phase.
        extra_m = 2.0 * slab.thickness_m * np.sqrt(slab.permittivity - 1.0 + cosine**2)
        mean_m = float(extra_m[weights != 0].mean())
        second = -r * (1.0 - r**2) * wall_amplitude**2 * np.exp(-1j * k * (extra_m - mean_m))
        for reflected, more_m in ((gain * r, 0.0), (gain * second, mean_m)):
            signal += physical_optics(
                facets,
                (weights * reflected).astype(np.complex64),
                ends,
                replace(waveform, path_bias_m=waveform.path_bias_m + more_m),
                walls=boxes,
                num_threads=scene.num_threads,
            ).astype(np.complex64)
    return signal


def _gain(antennas: AntennaBlocks, points: Floats, leg: Floats, mirror: Mirror) -> Floats:
    """Antenna pattern towards the object and towards the wall, (n_blocks, n_points)."""
    # leg: from the points to the images of the blocks' middles, (n_blocks, n_points, 3) [m].
    if antennas.pattern_exponent == 0:
        return np.ones(leg.shape[:2])
    real = -leg
    real[..., mirror.axis] *= -1.0
    cosines = [
        np.maximum(w @ antennas.boresight, 0.0) / np.linalg.norm(w, axis=2)
        for w in (points - block_centers(antennas)[:, None], real)
    ]
    return np.asarray((cosines[0] * cosines[1]) ** antennas.pattern_exponent)
