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
from geraf2.freespace.specular import specular_visibility
from geraf2.geometry.components import face_labels
from geraf2.geometry.transforms import apply_rigid, triple
from geraf2.geometry.triangles import face_areas, split_triangles, unit_normals, vertex_normals
from geraf2.io.mesh import TriangleMesh, merge_duplicate_vertices
from geraf2.io.planes import ScannedPlanes
from geraf2.ops.visibility import MeshScene
from geraf2.scene.aperture import Aperture, apertures_at

MIN_REGION_M2 = 20e-6
"""Regions below this do not count [m^2]: less than half of the top of an 8 mm screw head."""
_CERTAIN = 1.96
"""Standard uncertainties by which a deviation must exceed the tolerance."""
_MODEL_EDGE_M = 0.003
"""Longest edge of the pieces into which a model is divided [m]."""
_N_ECHOES, _ECHO_REACH_M = 5, 0.005
"""So many glints within this distance along the surface confirm a point of it [m]: an 8 mm screw
head has 65 to 80, ghosts beside a part 2 to 5."""
_FLAT_REACH_M, _FLAT_COSINE = 0.02, float(np.cos(np.deg2rad(6.0)))
"""Faces no farther away and no more turned are the same flat [m]."""
_FLAT_HEIGHT_M = 0.001
_N_FLAT_POINTS = 1000
_HALF_APERTURE_M = 0.04
"""Half of a sub-aperture [m]."""
_MIN_SIGMA_M = 0.003
"""Least uncertainty of a point of a model without a measured surface near it [m]."""


@dataclass(frozen=True, kw_only=True)
class Region:
    """A connected region in which two surfaces differ beyond tolerance and uncertainty."""

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
    planes: ScannedPlanes | None = None,
    *,
    glints: Glints | None = None,
    echoes: Patches | None = None,
    num_threads: int | None = None,
) -> Deviation:
    """Compare a part with its placed model.

    body: measured. model: in its own frame [m]. placement: of the model.
    tolerance_m: largest deviation allowed [m].
    planes: of the run's antennas, which give what of the model should have echoed; nothing is
    called absent without them, or where their wavelength is not recorded.
    glints: of the same run. Where they lie on the model within the tolerance, and face as it does,
    it is confirmed, and nothing else is reported there: metal hides what lies behind it.
    echoes: measured shares of the model's echoes. Only they show that a part is absent; they also
    confirm.
    num_threads: all when None.
    """
    placed = model.moved(placement.pose)
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
    confirmed = find_confirmed(glints, centers, normals, tolerance_m)
    if echoes is not None:
        confirmed |= _find_echoed(echoes, placement, centers)
    _, at = KDTree(centers).query(body.mesh.vertices)
    known = body.seen & ~confirmed[at]
    if glints is not None:
        facing = vertex_normals(body.mesh.vertices, body.mesh.faces)
        known &= find_confirmed(glints, body.mesh.vertices, facing, tolerance_m)
    excess, faces = known & (np.abs(values) - _CERTAIN * sigma > tolerance_m), body.mesh.faces
    of_faces, regions = (values[faces].mean(axis=1), sigma[faces].mean(axis=1)), list[Region]()
    for what, side in (("too much", values > 0), ("too little", values < 0)):
        regions += _regions(what, body.mesh, (excess & side)[faces].all(axis=1), *of_faces)
    near, gap, at_sigma = _find_nearest_seen(body, pieces)
    areas = face_areas(pieces.corners)
    least = np.maximum(at_sigma, _MIN_SIGMA_M)
    if echoes is not None:
        regions += _silent_regions(echoes, placement, (centers, gap, least), tolerance_m)
    elif planes is not None and planes.wavelength_m is not None and len(planes.corners_m):
        apertures = apertures_at(planes.corners_m)
        should = find_in_sight(pieces, scene, apertures, planes.wavelength_m) & ~confirmed
        far = np.asarray(gap > tolerance_m + _CERTAIN * least)
        asked = np.flatnonzero(should & far)
        lacks = np.zeros(len(centers), dtype=bool)
        lacks[asked[~find_on_flats(centers, normals, asked, np.flatnonzero(confirmed))]] = True
        regions += _regions("absent", pieces, lacks, -gap, least)
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
    """Uncertainty of the model's position at points (n, 3) [m], over all directions, (n,) [m]."""
    variances = np.trace(placement.covariances_at(points), axis1=1, axis2=2) / 3.0
    return np.asarray(np.sqrt(variances))


def find_in_sight(
    pieces: TriangleMesh, scene: MeshScene, apertures: Sequence[Aperture], wavelength_m: float
) -> Bools:
    """Whether each face should have sent an echo to a plane of antennas, (n_faces,).

    The mirror point lies where the middle of a sub-aperture may be, and nothing blocks the path. A
    flat of side s sends its echo into a lobe lambda / (2 s) around, so the mirror point of a small
    flat may lie nearer to the edge by this, but not beyond it.

    pieces: faces of a surface. scene: what may block. apertures: of the planes of antennas.
    wavelength_m: at mid-band [m].
    """
    points, normals = pieces.corners.mean(axis=1), unit_normals(pieces.corners)
    lobes = wavelength_m / (2.0 * _flat_sides(pieces, points, normals))
    reach = [np.abs(one.mirror(points, normals).distances_m) for one in apertures]
    spare = np.maximum(_HALF_APERTURE_M - np.stack(reach, axis=1) * lobes[:, None], 0.0)
    margins = specular_visibility(points, normals, apertures, scene, min_m=spare)
    return np.asarray((margins > -np.inf).any(axis=1))


def _flat_sides(pieces: TriangleMesh, points: Floats, normals: Floats) -> Floats:
    """Side of the flat around each face: root of the area near it that faces alike, (n_faces,)."""
    areas = face_areas(pieces.corners)
    # A model of 50,000 faces has 10^8 pairs; a thousand points, evenly by area, suffice.
    cumulative = np.cumsum(areas)
    at = (np.arange(_N_FLAT_POINTS) + 0.5) / _N_FLAT_POINTS * cumulative[-1]
    some = np.minimum(np.searchsorted(cumulative, at), len(areas) - 1)
    pairs = KDTree(points).sparse_distance_matrix(
        KDTree(points[some]), _FLAT_REACH_M, output_type="ndarray"
    )
    i, j = pairs["i"], some[pairs["j"]]
    alike = np.einsum("nk,nk->n", normals[i], normals[j]) > _FLAT_COSINE
    count = np.bincount(i[alike], minlength=len(areas))
    share = cumulative[-1] / _N_FLAT_POINTS
    return np.asarray(np.sqrt(np.maximum(count * share, areas)))


def find_confirmed(
    glints: Glints | None, points: Floats, normals: Floats, tolerance_m: float
) -> Bools:
    """Whether echoes came from points of a surface: enough glints lie on it around them, (n,).

    glints: of the run. points, normals: (n, 3) [m]. tolerance_m: of a glint off the surface [m].
    """
    if glints is None or not len(glints):
        return np.zeros(len(points), dtype=bool)
    pairs = KDTree(points).sparse_distance_matrix(
        KDTree(glints.positions), float(np.hypot(_ECHO_REACH_M, tolerance_m)), output_type="ndarray"
    )
    i, j = pairs["i"], pairs["j"]
    off = np.abs(np.einsum("nk,nk->n", normals[i], glints.positions[j] - points[i]))
    alike = np.einsum("nk,nk->n", normals[i], glints.normals[j]) > np.sqrt(0.5)
    on = alike & (off <= tolerance_m)
    return np.asarray(np.bincount(i[on], minlength=len(points)) >= _N_ECHOES)


def find_on_flats(centers: Floats, normals: Floats, asked: Ints, confirmed: Ints) -> Bools:
    """Whether each asked face lies on one flat with a confirmed one, (n_asked,).

    A flat echoes from where its normal meets the antennas, and from nowhere else.

    centers, normals: of faces, (n, 3) [m]. asked, confirmed: indices of them.
    """
    some = confirmed[:: max(1, len(confirmed) // _N_FLAT_POINTS)]
    if not (len(asked) and len(some)):
        return np.zeros(len(asked), dtype=bool)
    alike = normals[asked] @ normals[some].T > _FLAT_COSINE
    height = np.einsum("nk,nk->n", normals[asked], centers[asked])
    off = np.abs(normals[asked] @ centers[some].T - height[:, None])
    return np.asarray((alike & (off < _FLAT_HEIGHT_M)).any(axis=1))


def _find_nearest_seen(body: Body, pieces: TriangleMesh) -> tuple[Bools, Floats, Floats]:
    """Of each face of a model: is a seen surface near, how far is any, and how certain is that."""
    centers, normals = pieces.corners.mean(axis=1), unit_normals(pieces.corners)
    faces = body.mesh.faces
    positions, facing = body.mesh.corners.mean(axis=1), unit_normals(body.mesh.corners)
    gap, hit = KDTree(positions).query(centers)
    sigma = body.sigma_m[faces].max(axis=1)[hit]
    seen = np.flatnonzero(body.seen[faces].all(axis=1))
    near = np.zeros(len(centers), dtype=bool)
    if seen.size:
        distance, partner = KDTree(positions[seen]).query(centers)
        alike = np.einsum("nk,nk->n", normals, facing[seen[partner]]) > np.sqrt(0.5)
        near = (distance < PATCH_M) & alike
    return near, gap, sigma


def _find_echoed(echoes: Patches, placement: Placement, asked: Floats) -> Bools:
    """Whether points of a model lie on patches whose echo certainly came, (n,)."""
    value, sigma = echoes.shares.T
    came = np.isfinite(sigma) & (value - _CERTAIN * np.where(np.isfinite(sigma), sigma, 0.0) > 0.5)
    points = apply_rigid(placement.pose, echoes.pieces.points)
    return np.asarray(came[echoes.patch][KDTree(points).query(asked)[1]])


def _silent_regions(
    echoes: Patches,
    placement: Placement,
    near: tuple[Floats, Floats, Floats],
    tolerance_m: float,
) -> list[Region]:
    """Regions of a model whose echo did not come; how far what was found lies from them."""
    # Where that is within the tolerance the surface exists, and a missing echo shows nothing. near:
    # points of the model, distance of the nearest surface, its uncertainty.
    centers, gap, sigma = near
    points, areas = apply_rigid(placement.pose, echoes.pieces.points), echoes.pieces.areas
    nearest = KDTree(centers).query(points)[1]
    found = []
    for group, _ in echoes.silent:
        own = np.flatnonzero(np.isin(echoes.patch, group))
        if float(areas[own].sum()) < MIN_REGION_M2:
            continue
        at = nearest[own]
        region = _region("absent", points[own], areas[own], -gap[at], sigma[at])
        if -region.deviation_m > tolerance_m:
            found.append(region)
    return found


def _regions(
    what: str, mesh: TriangleMesh, marked: Bools, values: Floats, sigma: Floats
) -> list[Region]:
    """Find connected regions of the marked faces; values and their uncertainties of each face."""
    at = np.flatnonzero(marked)
    if not len(at):
        return []
    labels, corners = face_labels(mesh.faces[at])[0], mesh.corners[at]
    areas = face_areas(corners)
    return [
        _region(what, corners[own].mean(axis=1), areas[own], values[at[own]], sigma[at[own]])
        for own in (labels == r for r in range(int(labels.max()) + 1))
        if areas[own].sum() >= MIN_REGION_M2
    ]


def _region(what: str, points: Floats, areas: Floats, values: Floats, sigma: Floats) -> Region:
    """Region of pieces with a deviation and its uncertainty each."""
    share = areas / areas.sum()
    return Region(
        what=what,
        center_m=triple(share @ points),
        area_m2=float(areas.sum()),
        deviation_m=float(share @ values),
        sigma_m=float(share @ sigma),
    )


def list_regions(regions: Sequence[Region]) -> str:
    """Regions in words, the first three."""
    texts = [
        f"{r.what} ({1e3 * r.deviation_m:+z.1f} mm over {1e6 * r.area_m2:.0f} mm²)" for r in regions
    ]
    more = f" and {len(texts) - 3} more" if len(texts) > 3 else ""
    return ", ".join(texts[:3]) + more
