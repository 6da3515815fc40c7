"""What a scan rules out: the smallest balls that would have been found in parts of the box."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from geraf2._types import Bools, Floats
from geraf2.echoes.detectability import Detector
from geraf2.echoes.reflectivity import face_reflection
from geraf2.ops.visibility import MeshScene
from geraf2.scene import LosPrior

_GRID_M, _MOST = 0.045, 6
"""Spacing of the positions that are looked at [m], and most of them along a side."""
_MARGIN_M = 0.02
"""Positions nearer to the outside of the box are left out: walls hide what touches them [m]."""
_CLEAR_M = 0.01
"""Positions nearer to the content are part of it [m]."""
_LARGEST_RADIUS_M = 0.02
"""A place where no smaller ball stands out is out of sight [m]."""
_SHARE = 0.95
"""Share of the places that a stated size holds for."""
PLASTIC = 2.7
"""Permittivity of printed plastic, whose front face alone is counted."""


@dataclass(frozen=True, kw_only=True)
class Region:
    """Part of the box outside the content."""

    name: str
    """"in the box", "below the content", or its heights."""
    metal_mm: float | None
    """Diameter above which a metal ball would have been found, at 95 % of its places; None where
    more of them are out of sight [mm]."""
    plastic_mm: float | None
    """The same of plastic [mm]."""
    unseen_share: float
    """Share of its places that are out of sight."""


def rule_out(
    detector: Detector,
    prior: LosPrior,
    content: MeshScene,
) -> list[Region]:
    """Smallest balls that would have been found in the box, in parts of it, and by height.

    prior: outside of the box. content: surface of what was found, which hides what is behind it.
    """
    points = _places(prior, content)
    if not len(points):
        return []
    radii = detector.smallest_radii(points, content)
    low, high = content.vertices.min(axis=0), content.vertices.max(axis=0)
    z = points[:, 2]
    over = ((points > low) & (points < high))[:, :2].all(axis=1)
    parts: list[tuple[str, Bools]] = [
        ("in the box", np.ones(len(points), dtype=bool)),
        ("below the content", over & (z < low[2])),
        ("above the content", over & (z > high[2])),
        ("beside the content", ~over),
    ]
    edges = np.linspace(z.min() - 1e-9, z.max() + 1e-9, 4)
    parts += [
        (f"z = {1e3 * start:z.0f} to {1e3 * end:z.0f} mm", (z >= start) & (z < end))
        for start, end in pairwise(edges)
    ]
    return [_region(name, radii[which]) for name, which in parts if which.any()]


def _places(prior: LosPrior, content: MeshScene) -> Floats:
    """Places in the box and outside the content, on a coarse grid, (n, 3) [m]."""
    cuboid = prior.cuboid
    axes, size, middle = (np.eye(3), np.array(prior.size_m), np.array(prior.center_m))
    if cuboid is not None:
        axes, size, middle = cuboid
    half = np.maximum(0.5 * size - _MARGIN_M, 0.0)
    lines = [np.linspace(-h, h, int(np.clip(round(2.0 * h / _GRID_M) + 1, 2, _MOST))) for h in half]
    points = middle + np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3) @ axes
    if cuboid is None:
        points = points[MeshScene(prior.vertices, prior.faces).contains(points)]
    clear = content.distance(points) > _CLEAR_M
    return np.asarray(points[clear & ~content.contains(points)])


def _region(name: str, radii: Floats) -> Region:
    seen = radii < _LARGEST_RADIUS_M
    radius = float(np.quantile(radii, _SHARE, method="higher"))
    plastic = radius / abs(face_reflection(PLASTIC))

    def diameter_mm(radius_m: float) -> float | None:
        return round(2e3 * radius_m, 1) if radius_m < _LARGEST_RADIUS_M else None

    return Region(
        name=name,
        metal_mm=diameter_mm(radius),
        plastic_mm=diameter_mm(plastic),
        unseen_share=round(float(1.0 - seen.mean()), 3),
    )


def region_numbers(regions: Sequence[Region]) -> dict[str, Any]:
    """For run.json; empty without regions."""
    return {"ruled_out": [asdict(region) for region in regions]} if regions else {}


def ruled_out_of(numbers: Mapping[str, Any]) -> list[Region]:
    """Read the regions from the numbers of the stage `mesh` in run.json; none of other runs."""
    return [Region(**region) for region in numbers.get("ruled_out", ())]


def describe_ruled_out(regions: Sequence[Region]) -> str:
    """One line; empty without regions."""
    if not regions:
        return ""
    whole, *parts = regions
    below = next((one for one in parts if one.name == "below the content"), None)
    texts = []
    for kind, size, more in (
        ("metal", whole.metal_mm, below and below.metal_mm),
        ("plastic", whole.plastic_mm, below and below.plastic_mm),
    ):
        if size is None:
            limit = 2e3 * _LARGEST_RADIUS_M
            texts.append(f"a {kind} ball of {limit:.0f} mm cannot be ruled out in 5 % of the box")
            continue
        text = f"no {kind} ball above {size:.2g} mm in 95 % of the box"
        if below is not None:
            text += ", " + (f"{more:.2g} mm" if more else "none ruled out") + " below the content"
        texts.append(text)
    return "; ".join(texts)


def ruled_out_rows(regions: Sequence[Region]) -> list[tuple[str, str, str, str]]:
    """Name, diameters of metal and plastic [mm], and share out of sight [%] of each region."""
    return [
        (
            region.name,
            _diameter(region.metal_mm),
            _diameter(region.plastic_mm),
            f"{100.0 * region.unseen_share:.0f}",
        )
        for region in regions
    ]


def _diameter(value_mm: float | None) -> str:
    return "none" if value_mm is None else f"{value_mm:.1f}"
