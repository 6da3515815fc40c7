"""How far a part is from its model, where it was seen, and whether that is within a tolerance."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats, Ints
from geraf2.geometry.transforms import apply_rigid
from geraf2.geometry.triangles import face_areas, split_triangles, unit_normals
from geraf2.inspection.bodies import PATCH_M, Body
from geraf2.inspection.registration import Placement
from geraf2.io.mesh import TriangleMesh, merge_duplicate_vertices
from geraf2.ops.visibility import MeshScene
from geraf2.surfaces.isosurface import face_components

MIN_REGION_M2 = 20e-6
"""Regions below this do not count [m^2]: less than half of the top of an 8 mm screw head."""
_CERTAIN = 1.96
"""Standard uncertainties by which a deviation must exceed the tolerance."""
_MODEL_EDGE_M = 0.003
"""Longest edge of the pieces in which a model is looked at [m]."""
_START_M = 1e-4
"""Rays begin this far above their own face [m]."""
_LEAST_SIGMA_M = 0.002
"""Of places of a model that no measured surface comes near [m]."""


@dataclass(frozen=True, kw_only=True)
class Region:
    """A connected place where two surfaces differ beyond tolerance and uncertainty."""

    what: str
    """`too much` outside of the model, `too little` inside it, `absent`: it should have echoed."""
    center_m: tuple[float, float, float]
    """Its middle, in the capture's frame [m]."""
    area_m2: float
    """Area [m^2]."""
    deviation_m: float
    """Mean signed distance, positive outside [m]."""
    sigma_m: float
    """Mean standard uncertainty [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Deviation:
    """A part against its model."""

    values_m: Floats
    """Signed distance of each vertex of the part to the model, positive outside, (n_vertices,)
    [m]."""
    sigma_m: Floats
    """Standard uncertainty of that, with the pose's, (n_vertices,) [m]."""
    seen_fraction: float
    """Share of the model's area with a seen surface within 10 mm that faces alike."""
    regions: tuple[Region, ...]
    """Where it is out of tolerance for certain, the largest first."""
    rms_m: float
    """Root mean square deviation over what was seen [m]."""
    within_fraction: float
    """Share of the seen area whose deviation is at most the tolerance."""


def deviation_of(
    body: Body,
    model: TriangleMesh,
    placement: Placement,
    tolerance_m: float,
    planes_m: Floats | None = None,
    *,
    num_threads: int | None = None,
) -> Deviation:
    """Compare a part with its placed model.

    body: measured. model: in its own frame [m]. placement: of the model.
    tolerance_m: largest deviation allowed [m].
    planes_m: corners of the planes of antennas, (n_planes, 4, 3) [m]: tell what of the model should
    have echoed; nothing is called absent without them.
    num_threads: all when None.
    """
    placed = TriangleMesh(vertices=apply_rigid(placement.pose, model.vertices), faces=model.faces)
    scene = MeshScene(placed.vertices, placed.faces, num_threads=num_threads)
    values = scene.signed_distance(body.mesh.vertices)
    sigma = np.hypot(body.sigma_m, pose_sigma(placement, body.mesh.vertices))
    regions = regions_of(body.mesh, values, sigma, body.seen, tolerance_m)
    corners = split_triangles(placed.corners, _MODEL_EDGE_M)
    pieces = merge_duplicate_vertices(
        TriangleMesh(
            vertices=corners.reshape(-1, 3), faces=np.arange(corners.size // 3).reshape(-1, 3)
        )
    )
    near, gap, at_sigma = _nearest_seen(body, pieces)
    areas = face_areas(pieces.corners)
    least = np.maximum(at_sigma, _LEAST_SIGMA_M)
    if planes_m is not None and len(planes_m):
        should = in_sight(pieces, scene, planes_m)
        far = np.asarray(gap > tolerance_m + _CERTAIN * least)
        regions += _absent(pieces, should & far, gap, least)
    areas_here = body.areas_m2 * body.seen
    total = max(float(areas_here.sum()), 1e-30)
    return Deviation(
        values_m=values,
        sigma_m=sigma,
        seen_fraction=float(areas[near].sum() / areas.sum()),
        regions=tuple(sorted(regions, key=lambda region: -region.area_m2)),
        rms_m=float(np.sqrt(np.sum(areas_here * values**2) / total)),
        within_fraction=float(areas_here[np.abs(values) <= tolerance_m].sum() / total),
    )


def pose_sigma(placement: Placement, points: Floats) -> Floats:
    """Uncertainty of the model's place at points (n, 3) [m], over all directions, (n,) [m]."""
    off = points - placement.middle_m
    zero = np.zeros(len(points))
    x, y, z = off.T
    # A small turn w moves a point by w x off.
    turn = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=1).reshape(-1, 3, 3)
    rows = np.concatenate([turn, np.broadcast_to(np.eye(3), (len(points), 3, 3))], axis=2)
    moved = np.einsum("nij,jk,nik->n", rows, placement.covariance, rows)
    return np.asarray(np.sqrt(moved / 3.0))


def regions_of(
    mesh: TriangleMesh, values: Floats, sigma: Floats, seen: Bools, tolerance_m: float
) -> list[Region]:
    """Find connected regions whose deviation is beyond tolerance and uncertainty, for certain.

    mesh: where the values are. values, sigma: of each vertex, (n_vertices,) [m]. seen: others do
    not count, (n_vertices,).
    """
    found: list[Region] = []
    excess = np.abs(values) - _CERTAIN * sigma > tolerance_m
    for what, side in (("too much", values > 0), ("too little", values < 0)):
        marked = excess & seen & side
        found += _regions(mesh, np.asarray(marked[mesh.faces].all(axis=1)), values, sigma, what)
    return found


def in_sight(pieces: TriangleMesh, scene: MeshScene, planes_m: Floats) -> Bools:
    """Whether the normal of each face, prolonged, meets a plane of antennas and nothing before.

    pieces: faces of a surface. scene: what may stand in between. planes_m: corners of the planes in
    turn, (n_planes, 4, 3) [m].
    """
    points, normals = pieces.corners.mean(axis=1), unit_normals(pieces.corners)
    seen = np.zeros(len(points), dtype=bool)
    for corners in planes_m:
        origin, u, v = corners[0], corners[1] - corners[0], corners[3] - corners[0]
        look = np.cross(u, v)
        along = normals @ look
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = (origin - points) @ look / along
            hits = points + reach[:, None] * normals
            a, b = (hits - origin) @ u / (u @ u), (hits - origin) @ v / (v @ v)
            inside = (np.abs(a - 0.5) <= 0.5) & (np.abs(b - 0.5) <= 0.5) & (reach > 0)
        ask = np.flatnonzero(inside & ~seen)
        if ask.size:
            hidden = scene.occluded(points[ask] + _START_M * normals[ask], hits[ask])
            seen[ask[~hidden]] = True
    return seen


def _nearest_seen(body: Body, pieces: TriangleMesh) -> tuple[Bools, Floats, Floats]:
    """Of each face of a model: is a seen surface near, how far is any, and how certain is that."""
    centers, normals = pieces.corners.mean(axis=1), unit_normals(pieces.corners)
    faces = body.mesh.faces
    places, facing = body.mesh.corners.mean(axis=1), unit_normals(body.mesh.corners)
    gap, hit = KDTree(places).query(centers)
    sigma = body.sigma_m[faces].max(axis=1)[hit]
    seen = np.flatnonzero(body.seen[faces].all(axis=1))
    near = np.zeros(len(centers), dtype=bool)
    if seen.size:
        distance, partner = KDTree(places[seen]).query(centers)
        alike = np.einsum("nk,nk->n", normals, facing[seen[partner]]) > np.sqrt(0.5)
        near = (distance < PATCH_M) & alike
    return near, gap, sigma


def _absent(pieces: TriangleMesh, marked: Bools, gap: Floats, sigma: Floats) -> list[Region]:
    """Regions of a model that should have echoed, and where nothing is."""
    n_vertices = len(pieces.vertices)
    count = np.bincount(pieces.faces.reshape(-1), minlength=n_vertices)
    of_vertex = [
        np.bincount(pieces.faces.reshape(-1), np.repeat(values, 3), minlength=n_vertices) / count
        for values in (-gap, sigma)
    ]
    return _regions(pieces, marked, of_vertex[0], of_vertex[1], "absent")


def _regions(
    mesh: TriangleMesh, marked: Bools, values: Floats, sigma: Floats, what: str
) -> list[Region]:
    faces = mesh.faces[marked]
    if not len(faces):
        return []
    labels, n_regions = face_components(TriangleMesh(vertices=mesh.vertices, faces=faces))
    areas = face_areas(mesh.vertices[faces])
    total = np.bincount(labels, areas, minlength=n_regions)
    kept = np.flatnonzero(total >= MIN_REGION_M2)
    return [
        _region(mesh, faces[labels == r], areas[labels == r], values, sigma, what) for r in kept
    ]


def _region(
    mesh: TriangleMesh, faces: Ints, areas: Floats, values: Floats, sigma: Floats, what: str
) -> Region:
    share = areas / areas.sum()
    x, y, z = share @ mesh.vertices[faces].mean(axis=1)
    return Region(
        what=what,
        center_m=(float(x), float(y), float(z)),
        area_m2=float(areas.sum()),
        deviation_m=float(share @ values[faces].mean(axis=1)),
        sigma_m=float(share @ sigma[faces].mean(axis=1)),
    )


def listed(regions: Sequence[Region]) -> str:
    """Regions in words, the first three."""
    texts = [
        f"{r.what} ({1e3 * r.deviation_m:+.1f} mm over {1e6 * r.area_m2:.0f} mm²)" for r in regions
    ]
    more = f" and {len(texts) - 3} more" if len(texts) > 3 else ""
    return ", ".join(texts[:3]) + more
