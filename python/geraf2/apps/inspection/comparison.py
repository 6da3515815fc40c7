"""Changes between two scans of the same box."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from geraf2.apps.inspection.bodies import PATCH_M, Body
from geraf2.apps.inspection.deviation import Region, regions_of
from geraf2.ops.visibility import MeshScene


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Differences of a run from an earlier one of the same box, in the same frame."""

    regions: tuple[Region, ...]
    """Where the surfaces certainly differ; positive: more than in the earlier run."""
    n_parts: tuple[int, int]
    """Numbers of parts now and before."""
    compared_fraction: float
    """Share of the present area that was seen in both runs."""

    @property
    def changed(self) -> bool:
        """Whether anything changed."""
        return bool(self.regions) or self.n_parts[0] != self.n_parts[1]


def compare(
    here: Body,
    there: Body,
    n_parts: tuple[int, int],
    tolerance_m: float,
    *,
    num_threads: int | None = None,
) -> Comparison:
    """Compare the content of two runs in the same frame, without alignment.

    here, there: all of the content. n_parts: of each. tolerance_m: least change [m].
    """
    regions: list[Region] = []
    shares = []
    for one, other, sign in ((here, there, 1.0), (there, here, -1.0)):
        scene = MeshScene(other.mesh.vertices, other.mesh.faces, num_threads=num_threads)
        values = sign * scene.signed_distance(one.mesh.vertices)
        centers = other.mesh.corners.mean(axis=1)
        gap, hit = KDTree(centers).query(one.mesh.vertices)
        sigma = np.hypot(one.sigma_m, other.sigma_m[other.mesh.faces].max(axis=1)[hit])
        seen = one.seen & np.asarray(other.seen[other.mesh.faces].all(axis=1))[hit]
        # Seen surface far from the other run's is new.
        alone = one.seen & (gap > 2.0 * PATCH_M)
        found = regions_of(one.mesh, values, sigma, seen | alone, tolerance_m)
        regions += [r for r in found if sign > 0 or not _is_known(r, regions)]
        areas = one.areas_m2
        shares.append(float(areas[seen].sum() / max(areas.sum(), 1e-30)))
    return Comparison(
        regions=tuple(sorted(regions, key=lambda region: -region.area_m2)),
        n_parts=n_parts,
        compared_fraction=shares[0],
    )


def _is_known(region: Region, regions: list[Region]) -> bool:
    """Whether the same change was found in the other direction."""
    reach = PATCH_M + abs(region.deviation_m)
    return any(
        np.linalg.norm(np.subtract(region.center_m, other.center_m)) < reach
        and region.deviation_m * other.deviation_m > 0
        for other in regions
    )
