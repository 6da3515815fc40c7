"""How far a part is from its model, where it was seen, and whether that is within a tolerance."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats, Ints
from geraf2.apps.inspection.bodies import PATCH_M, Body
from geraf2.apps.inspection.expected_echoes import Patches
from geraf2.apps.inspection.registration import Placement
from geraf2.echoes.glint_set import Glints
from geraf2.geometry.transforms import apply_rigid
from geraf2.geometry.triangles import face_areas, split_triangles, unit_normals, vertex_normals
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
_N_ECHOES, _ECHO_REACH_M = 5, 0.005
"""So many glints on a place of a surface, no farther than this along it, confirm it [m]: an 8 mm
screw head has 65 to 80, ghosts beside a part 2 to 5."""
_FLAT_REACH_M, _FLAT_COSINE = 0.02, float(np.cos(np.deg2rad(6.0)))
"""Faces no farther away and no more turned are the same flat [m]."""
_FLAT_HEIGHT_M = 0.001
_N_FLAT_PLACES = 1000
_HALF_APERTURE_M, _WAVELENGTH_M = 0.04, 0.0039
"""Half of a sub-aperture, and a wavelength at 77 GHz [m]."""
_LEAST_SIGMA_M = 0.003
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
    glints: Glints | None = None,
    echoes: Patches | None = None,
    num_threads: int | None = None,
) -> Deviation:
    """Compare a part with its placed model.

    body: measured. model: in its own frame [m]. placement: of the model.
    tolerance_m: largest deviation allowed [m].
    planes_m: corners of the planes of antennas, (n_planes, 4, 3) [m]: tell what of the model should
    have echoed; nothing is called absent without them.
    glints: of the same run. Where they lie on the model within the tolerance, and face as it does,
    it is confirmed, and nothing else is told of that place: metal hides what lies behind it.
    echoes: how much of the model's echoes came: they alone tell what is absent, and they confirm.
    num_threads: all when None.
    """
    placed = TriangleMesh(vertices=apply_rigid(placement.pose, model.vertices), faces=model.faces)
    scene = MeshScene(placed.vertices, placed.faces, num_threads=num_threads)
    values = scene.signed_distance(body.mesh.vertices)
    sigma = np.hypot(body.sigma_m, pose_sigma(placement, body.mesh.vertices))
    corners = split_triangles(placed.corners, _MODEL_EDGE_M)
    pieces = merge_duplicate_vertices(
        TriangleMesh(
            vertices=corners.reshape(-1, 3), faces=np.arange(corners.size // 3).reshape(-1, 3)
        )
    )
    centers, normals = pieces.corners.mean(axis=1), unit_normals(pieces.corners)
    confirmed = confirmed_by(glints, centers, normals, tolerance_m)
    if echoes is not None:
        confirmed |= _echoed(echoes, placement, centers)
    _, at = KDTree(centers).query(body.mesh.vertices)
    known = body.seen & ~confirmed[at]
    if glints is not None:
        facing = vertex_normals(body.mesh.vertices, body.mesh.faces)
        known &= confirmed_by(glints, body.mesh.vertices, facing, tolerance_m)
    regions = regions_of(body.mesh, values, sigma, known, tolerance_m)
    near, gap, at_sigma = _nearest_seen(body, pieces)
    areas = face_areas(pieces.corners)
    least = np.maximum(at_sigma, _LEAST_SIGMA_M)
    if echoes is not None:
        regions += _silent(echoes, placement, (centers, gap, least), tolerance_m)
    elif planes_m is not None and len(planes_m):
        should = in_sight(pieces, scene, planes_m) & ~confirmed
        far = np.asarray(gap > tolerance_m + _CERTAIN * least)
        asked = np.flatnonzero(should & far)
        lacks = np.zeros(len(centers), dtype=bool)
        lacks[asked[~of_flats(centers, normals, asked, np.flatnonzero(confirmed))]] = True
        regions += _absent(pieces, lacks, gap, least)
    areas_here = body.areas_m2 * body.seen
    total = max(float(areas_here.sum()), 1e-30)
    return Deviation(
        values_m=values,
        sigma_m=sigma,
        seen_fraction=float(areas[near | confirmed].sum() / areas.sum()),
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
    """Whether each face should have sent an echo to a plane of antennas, (n_faces,).

    Its normal, prolonged, meets the plane where the middle of a sub-aperture may be, and nothing
    before. A flat of side s sends its echo into lambda / (2 s) around, so the normal of a small one
    may miss by this, but not the plane.

    pieces: faces of a surface. scene: what may stand in between. planes_m: corners of the planes in
    turn, (n_planes, 4, 3) [m].
    """
    points, normals = pieces.corners.mean(axis=1), unit_normals(pieces.corners)
    lobes = _WAVELENGTH_M / (2.0 * _flat_sides(pieces, points, normals))
    seen = np.zeros(len(points), dtype=bool)
    for corners in planes_m:
        origin, u, v = corners[0], corners[1] - corners[0], corners[3] - corners[0]
        look = np.cross(u, v)
        along = normals @ look
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = (origin - points) @ look / along
            hits = points + reach[:, None] * normals
            inside = reach > 0
            spare = np.maximum(_HALF_APERTURE_M - np.abs(reach) * lobes, 0.0)
            for side in (u, v):
                off = np.abs((hits - origin) @ side / (side @ side) - 0.5)
                inside &= off * np.linalg.norm(side) <= 0.5 * np.linalg.norm(side) - spare
        ask = np.flatnonzero(inside & ~seen)
        if ask.size:
            hidden = scene.occluded(points[ask] + _START_M * normals[ask], hits[ask])
            seen[ask[~hidden]] = True
    return seen


def _flat_sides(pieces: TriangleMesh, points: Floats, normals: Floats) -> Floats:
    """Side of the flat around each face: root of the area near it that faces alike, (n_faces,)."""
    areas = face_areas(pieces.corners)
    # A model of 50,000 faces has 10^8 pairs; a thousand places, evenly by area, tell the same.
    cumulative = np.cumsum(areas)
    at = (np.arange(_N_FLAT_PLACES) + 0.5) / _N_FLAT_PLACES * cumulative[-1]
    some = np.minimum(np.searchsorted(cumulative, at), len(areas) - 1)
    pairs = KDTree(points).sparse_distance_matrix(
        KDTree(points[some]), _FLAT_REACH_M, output_type="ndarray"
    )
    i, j = pairs["i"], some[pairs["j"]]
    alike = np.einsum("nk,nk->n", normals[i], normals[j]) > _FLAT_COSINE
    count = np.bincount(i[alike], minlength=len(areas))
    share = cumulative[-1] / _N_FLAT_PLACES
    return np.asarray(np.sqrt(np.maximum(count * share, areas)))


def confirmed_by(
    glints: Glints | None, places: Floats, normals: Floats, tolerance_m: float
) -> Bools:
    """Whether echoes came from places of a surface: enough glints lie on it around, (n,).

    glints: of the run. places, normals: (n, 3) [m]. tolerance_m: of a glint off the surface [m].
    """
    if glints is None or not len(glints):
        return np.zeros(len(places), dtype=bool)
    pairs = KDTree(places).sparse_distance_matrix(
        KDTree(glints.positions), float(np.hypot(_ECHO_REACH_M, tolerance_m)), output_type="ndarray"
    )
    i, j = pairs["i"], pairs["j"]
    off = np.abs(np.einsum("nk,nk->n", normals[i], glints.positions[j] - places[i]))
    alike = np.einsum("nk,nk->n", normals[i], glints.normals[j]) > np.sqrt(0.5)
    on = alike & (off <= tolerance_m)
    return np.asarray(np.bincount(i[on], minlength=len(places)) >= _N_ECHOES)


def of_flats(places: Floats, normals: Floats, asked: Ints, confirmed: Ints) -> Bools:
    """Whether each asked place lies on one flat with a confirmed one, (n_asked,).

    A flat echoes from where its normal meets the antennas, and from nowhere else.

    places, normals: of faces, (n, 3) [m]. asked, confirmed: indices of them.
    """
    some = confirmed[:: max(1, len(confirmed) // _N_FLAT_PLACES)]
    if not (len(asked) and len(some)):
        return np.zeros(len(asked), dtype=bool)
    alike = normals[asked] @ normals[some].T > _FLAT_COSINE
    height = np.einsum("nk,nk->n", normals[asked], places[asked])
    off = np.abs(normals[asked] @ places[some].T - height[:, None])
    return np.asarray((alike & (off < _FLAT_HEIGHT_M)).any(axis=1))


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


def _echoed(echoes: Patches, placement: Placement, places: Floats) -> Bools:
    """Whether places of a model lie on patches whose echo came for certain, (n,)."""
    value, sigma = echoes.shares.T
    came = np.isfinite(sigma) & (value - _CERTAIN * np.where(np.isfinite(sigma), sigma, 0.0) > 0.5)
    points = apply_rigid(placement.pose, echoes.pieces.points)
    return np.asarray(came[echoes.patch][KDTree(points).query(places)[1]])


def _silent(
    echoes: Patches,
    placement: Placement,
    near: tuple[Floats, Floats, Floats],
    tolerance_m: float,
) -> list[Region]:
    """Regions of a model whose echo did not come; how far what was found lies from them.

    Where that is within the tolerance the surface is there, and an echo that lacks tells no more.
    near: places of the model, distance of the nearest surface, its uncertainty.
    """
    centers, gap, sigma = near
    points, areas = apply_rigid(placement.pose, echoes.pieces.points), echoes.pieces.areas
    nearest = KDTree(centers).query(points)[1]
    found = []
    for group, _ in echoes.silent:
        own = np.flatnonzero(np.isin(echoes.patch, group))
        area = float(areas[own].sum())
        if area < MIN_REGION_M2:
            continue
        share = areas[own] / area
        gap_m = float(share @ gap[nearest[own]])
        if gap_m <= tolerance_m:
            continue
        x, y, z = share @ points[own]
        found.append(
            Region(
                what="absent",
                center_m=(float(x), float(y), float(z)),
                area_m2=area,
                deviation_m=-gap_m,
                sigma_m=float(share @ sigma[nearest[own]]),
            )
        )
    return found


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
