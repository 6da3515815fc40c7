"""What stands on the floor of its box goes down to it unseen.

Echoes near a wall are taken for the wall's own, and the antennas end before the floor does, so that
the lowest part of what stands is not seen even where it faces them. A thing in a box stands, unless
something says that it does not: then feet that are seen close above the floor go straight down to
it (docs/math/surface-fit.md#support). Nobody saw that: such a surface is guessed.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, binary_erosion, binary_fill_holes, label
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats
from geraf2.echoes.glint_set import Glints
from geraf2.fields import SdfGrid
from geraf2.freespace.caps import flatness
from geraf2.freespace.silhouettes import Silhouettes
from geraf2.scene import Capture, LosPrior

_BESIDE = np.ones((3, 3), dtype=bool)


@dataclass(frozen=True, kw_only=True)
class Support:
    """Feet that were taken to stand on the floor; possibly none."""

    floor_m: float
    """Height of the floor [m]."""
    heights_m: tuple[float, ...] = ()
    """How far above it each goes straight down from [m]."""
    areas_m2: tuple[float, ...] = ()
    """Area of each [m^2]."""
    overruled: Counter[str] = field(default_factory=Counter)
    """Number of feet that do not stand, by what says so."""

    def numbers(self) -> dict[str, Any]:
        """For run.json; {} where nothing was changed or could have been."""
        parts = []
        if n_feet := len(self.heights_m):
            low, high = (f"{1e3 * end(self.heights_m):.0f}" for end in (min, max))
            parts.append(
                f"{n_feet} {'foot' if n_feet == 1 else 'feet'}, {1e4 * sum(self.areas_m2):.1f} "
                f"cm^2, from {low if low == high else f'{low} to {high}'} mm above it down"
            )
        if not parts and not self.overruled:
            return {}
        stands = "stand" if parts else "stand nowhere"
        parts += [f"not {n}, where {why}" for why, n in self.overruled.items()]
        where = f"the content was taken to {stands} on the floor at z = {1e3 * self.floor_m:.1f} mm"
        return {"support": f"{where}: {'; '.join(parts)}"}


def floor_of(capture: Capture, prior: LosPrior) -> float | None:
    """Height of the floor, the inner face of the innermost box's bottom [m]; None if unknown.

    It is known where walls are, the bottom of the prior is flat and level, and the planes stand
    upright around the frame's z axis: then that is the vertical. Of planes that all look one way
    nothing says so.
    """
    walls = prior.walls or capture.walls
    axes = np.array([pose.axes for pose in capture.poses]).reshape(-1, 3, 3)
    looking, vertical = axes[:, 0], axes[:, 2, 2]
    turned = len(axes) > 0 and (looking @ looking.T).min() < 0.5
    if not walls or not turned or vertical.min() < -0.1 or vertical.mean() < 0.5:
        return None
    low, high = prior.bounds
    corners = prior.vertices[prior.faces]
    bottom = corners[(corners[:, :, 2] < low[2] + walls[0].thickness_m).all(axis=1), :, :2]
    area = 0.5 * np.abs(np.linalg.det(bottom[:, 1:] - bottom[:, :1])).sum()
    if area < 0.5 * np.prod(high[:2] - low[:2]):
        return None
    inner = walls[-1]
    return float(inner.center_m[2] - 0.5 * inner.size_m[2] + inner.thickness_m)


def stand_on(
    sdf: SdfGrid,
    floor_m: float,
    seen: Glints,
    *,
    reach_m: float,
    clearance_m: float,
    lean: tuple[float, float],
    outlines: Silhouettes | None = None,
) -> tuple[SdfGrid, Support]:
    """Continue feet straight down to the floor, and cut off what lies below it.

    A foot is a part of a level section of the content, the lowest with a glint beside a third of
    its outline or more. What is above that section stays as it is.

    sdf: signed distance of the content.
    floor_m: its height [m].
    seen: glints of first surfaces.
    reach_m: feet are seen down to this height above the floor, or less [m].
    clearance_m: a glint this near is beside a place [m].
    lean: cosines of :func:`geraf2.freespace.caps.cap_retreat`: what rounds off does not stand.
    outlines: shadows; where a level of the lines of sight under a foot is free, it does not stand.
    """
    values = np.array(sdf.values, dtype=np.float32)
    heights, areas, overruled = [], [], Counter[str]()
    low = seen.select(seen.positions[:, 2] <= floor_m + reach_m)
    for foot in _feet(sdf, floor_m, reach_m, low, clearance_m) if len(low) else ():
        down = np.broadcast_to([0.0, 0.0, -1.0], foot.places.shape)
        if flatness(foot.places, down, seen, lean).mean() < 0.5:
            overruled["the sides lean inwards"] += 1
        elif outlines is not None and _light(foot, floor_m, outlines):
            overruled["outlines show light below"] += 1
        else:
            _extrude(values, sdf, foot)
            heights.append(foot.height_m - floor_m)
            areas.append(len(foot.places) * sdf.grid.spacing_m**2)
    below = floor_m - _levels(sdf)
    values = np.maximum(values, below.astype(np.float32))
    return SdfGrid(grid=sdf.grid, values=values), Support(
        floor_m=floor_m,
        heights_m=tuple(heights),
        areas_m2=tuple(areas),
        overruled=overruled,
    )


class _Foot(NamedTuple):
    """Part of a level section of a content."""

    height_m: float
    inside: Bools  # where it is, (n_x, n_y)
    section: Floats  # of the field at that height, (n_x, n_y) [m]
    places: Floats  # of `inside`, (n, 3) [m]


def _levels(sdf: SdfGrid) -> Floats:
    return np.asarray(sdf.grid.origin_m[2] + sdf.grid.spacing_m * np.arange(sdf.grid.shape[2]))


def _feet(
    sdf: SdfGrid, floor_m: float, reach_m: float, seen: Glints, clearance_m: float
) -> Iterator[_Foot]:
    """Lowest parts of level sections with glints beside a third of their outlines."""
    taken = np.zeros(0, dtype=bool)
    step_m = 0.5 * sdf.grid.spacing_m
    for number, height in enumerate(floor_m + np.arange(step_m, reach_m, step_m)):
        section, places = _section(sdf, height)
        filled = binary_fill_holes(section < 0.0)
        if number == 0:  # what reaches the floor by itself stands as it is
            taken = filled
            continue
        parts, n_parts = label(filled, _BESIDE)
        # Below the lowest glints of a foot the field only closes it.
        tree = KDTree(seen.positions[seen.positions[:, 2] <= height + step_m])
        for inside in (parts == k for k in range(1, n_parts + 1)):
            rim = places[inside & ~binary_erosion(inside)]
            beside = np.mean(tree.query(rim)[0] <= clearance_m)
            # Planes 30 degrees apart see two thirds of what is round and upright and not hidden.
            # One voxel is a ghost.
            if len(rim) > 1 and not (inside & taken).any() and beside > 1.0 / 3.0:
                taken = taken | inside
                yield _Foot(float(height), inside, section, places[inside])


def _section(sdf: SdfGrid, height_m: float) -> tuple[Floats, Floats]:
    """Field on a level, (n_x, n_y) [m], and the places, (n_x, n_y, 3) [m]."""
    grid = sdf.grid
    x, y = (grid.origin_m[k] + grid.spacing_m * np.arange(grid.shape[k]) for k in range(2))
    places = np.stack(np.meshgrid(x, y, [height_m], indexing="ij"), axis=-1)[:, :, 0]
    return sdf.sample(places.reshape(-1, 3)).reshape(grid.shape[:2]), places


def _light(foot: _Foot, floor_m: float, outlines: Silhouettes) -> bool:
    """Whether most lines of sight are free on some level between foot and floor."""
    levels = np.arange(floor_m, foot.height_m, float(outlines.spacing_m))[1:]
    if not len(levels):
        return False
    gap = np.repeat(foot.places[None], len(levels), axis=0)
    gap[:, :, 2] = levels[:, None]
    free_m = outlines.free_distance(gap.reshape(-1, 3)).reshape(gap.shape[:2])
    return bool((np.mean(free_m > 0.0, axis=1) > 0.5).any())


def _extrude(values: NDArray[np.float32], sdf: SdfGrid, foot: _Foot) -> None:
    """Draw the section down from its height, with the air beside it."""
    beside = binary_dilation(foot.inside, _BESIDE, iterations=2)
    section = np.where(foot.inside | (beside & (foot.section > 0.0)), foot.section, np.inf)
    # Nobody can see into holes of it.
    section[foot.inside & (foot.section > 0.0)] = -0.5 * sdf.grid.spacing_m
    low = _levels(sdf) < foot.height_m
    values[:, :, low] = np.minimum(values[:, :, low], section[:, :, None])
