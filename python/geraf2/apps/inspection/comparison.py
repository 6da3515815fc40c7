"""Two scans of the same box: what changed."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from geraf2.apps.inspection.bodies import PATCH_M, Body
from geraf2.apps.inspection.deviation import Region, regions_of
from geraf2.ops.visibility import MeshScene


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """What differs between a run and an earlier one of the same box, in the same frame."""

    regions: tuple[Region, ...]
    """Where the surfaces differ for certain; positive: here is more than there was."""
    n_parts: tuple[int, int]
    """Parts here, and there."""
    compared_fraction: float
    """Share of the area here that was seen in both."""

    @property
    def changed(self) -> bool:
        """Whether anything did."""
        return bool(self.regions) or self.n_parts[0] != self.n_parts[1]


def compare(
    here: Body,
    there: Body,
    n_parts: tuple[int, int],
    tolerance_m: float,
    *,
    num_threads: int | None = None,
) -> Comparison:
    """Compare the content of two runs; nothing is aligned: boxes must lie in the same frame.

    here, there: all of the content. n_parts: of each. tolerance_m: smaller changes are none [m].
    """
    regions: list[Region] = []
    shares = []
    for one, other, sign in ((here, there, 1.0), (there, here, -1.0)):
        scene = MeshScene(other.mesh.vertices, other.mesh.faces, num_threads=num_threads)
        values = sign * scene.signed_distance(one.mesh.vertices)
        places = other.mesh.corners.mean(axis=1)
        gap, hit = KDTree(places).query(one.mesh.vertices)
        sigma = np.hypot(one.sigma_m, other.sigma_m[other.mesh.faces].max(axis=1)[hit])
        seen = one.seen & np.asarray(other.seen[other.mesh.faces].all(axis=1))[hit]
        # Far from all that was there, a seen surface is new, whatever was seen of the rest.
        alone = one.seen & (gap > 2.0 * PATCH_M)
        found = regions_of(one.mesh, values, sigma, seen | alone, tolerance_m)
        regions += [r for r in found if sign > 0 or not _told(r, regions)]
        areas = one.areas_m2
        shares.append(float(areas[seen].sum() / max(areas.sum(), 1e-30)))
    return Comparison(
        regions=tuple(sorted(regions, key=lambda region: -region.area_m2)),
        n_parts=n_parts,
        compared_fraction=shares[0],
    )


def _told(region: Region, regions: list[Region]) -> bool:
    """Whether the same change was found from the other side."""
    reach = PATCH_M + abs(region.deviation_m)
    return any(
        np.linalg.norm(np.subtract(region.center_m, other.center_m)) < reach
        and region.deviation_m * other.deviation_m > 0
        for other in regions
    )
