"""Zero levels of signed distance grids as closed triangle meshes."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats, Ints
from geraf2.fields import SdfGrid
from geraf2.geometry.components import face_labels
from geraf2.geometry.triangles import (
    closed_edges,
    enclosed_volume_m3,
    face_areas,
    six_fold_volumes,
)
from geraf2.io.mesh import TriangleMesh
from geraf2.ops.visibility import MeshScene

MIN_AREA_FRACTION = 0.02
"""Least area of a kept component relative to the main one; chance blobs stay below 0.01."""

MIN_SUPPORT = 10
"""Glints that keep a smaller component: several sub-apertures see a real facet's echo."""

MIN_SUPPORT_SHARE = 0.02
"""And at least this share of the main component's glints: ghosts have 10 to 60."""

MIN_SUPPORTED_AREA_FRACTION = 0.001
"""Below this even those go: 0.3 cm^2 of a 12 cm figure is less than one 4 mm voxel around."""

MIN_SUPPORT_DENSITY = 0.1
"""Least glints per area relative to the main component; a grown ghost had 0.04 of it."""

SUPPORT_REACH_M = 0.005
"""A glint supports a component within this distance [m]: 98 % of good glints lie within 5 mm."""


@dataclass(frozen=True, kw_only=True)
class SurfaceReport:
    """What kind of surface a mesh is."""

    n_vertices: int
    """Number of vertices."""
    n_faces: int
    """Number of triangles."""
    n_components: int
    """Connected pieces."""
    is_watertight: bool
    """Whether every edge is shared by exactly two consistently wound faces."""
    area_m2: float
    """Total area [m^2]."""
    volume_m3: float | None
    """Enclosed volume, None unless watertight [m^3]."""
    n_holes: int | None = None
    """Holes through the pieces, the sum of their genera; None unless watertight."""


@dataclass(frozen=True, kw_only=True)
class ComponentReport:
    """Which connected pieces were kept, and why the others were not."""

    n_kept: int
    """Components kept."""
    n_fragments: int
    """Dropped: small beside the main component and seen by few glints, or thinly seen."""
    n_unsupported: int
    """Dropped: no glint within reach."""
    n_voids: int
    """Dropped: closed surfaces that face inwards; a radar cannot see into what reflects it."""
    dropped_area_m2: float
    """Total area dropped [m^2]."""


def extract_surface(sdf: SdfGrid, level: float = 0.0) -> TriangleMesh:
    """Triangles of the level set f(x) = level [m], wound counter-clockwise seen from f > level.

    Marching cubes on the samples as they are: crossings are interpolated linearly along grid
    edges, so that a plane comes out exactly where it is, whatever |grad f|. Where the level set
    runs into the grid's border the surface is open there. Empty when nothing crosses the level.
    """
    from skimage.measure import marching_cubes  # noqa: PLC0415 - heavy, needed only here

    values = sdf.values
    if min(values.shape) < 2 or not values.min() < level <= values.max():
        return TriangleMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int64))
    # With "descent" scikit-image winds faces so that they face the larger values, the air.
    vertices, faces, _, _ = marching_cubes(
        values, level=level, gradient_direction="descent", allow_degenerate=False
    )
    placed = np.asarray(sdf.grid.origin_m) + sdf.grid.spacing_m * vertices.astype(np.float64)
    return TriangleMesh(vertices=placed, faces=faces.astype(np.int64))


def redistance(
    sdf: SdfGrid, surface: TriangleMesh | None = None, *, num_threads: int | None = None
) -> SdfGrid:
    """Replace each sample by its distance to the zero level, the zero level unmoved.

    f'(x) = sign(f(x)) min_y |x - y| over the triangles y of the zero level. A fitted field has
    the right zero level but a gradient of 0.2 to 0.75; afterwards |grad f'| = 1. Triangles cut
    the corners of a curved surface, which would pull it inwards by h^2 / (8 r), 0.04 mm for
    voxels of h = 4 mm on a radius of 30 mm; the samples beside the zero level are therefore
    corrected until it crosses the grid's edges where it did.

    sdf: field whose zero level is meant.
    surface: closed zero level to measure to, when parts of the field's own were dropped; distance
        and sign are then the surface's. By default `extract_surface(sdf)`, with the field's sign.
    num_threads: threads of the distance queries; all cores when None.

    Returns same grid, values [m]. Not differentiable.
    """
    target = extract_surface(sdf) if surface is None else surface
    if target.faces.shape[0] == 0:
        msg = "sdf must have a zero level to measure distances to, got none"
        raise ValueError(msg)
    points = sdf.grid.points()
    distances = signed_distances(target, points, num_threads=num_threads).reshape(sdf.grid.shape)
    if surface is None:
        distances = np.where(sdf.values < 0, -np.abs(distances), np.abs(distances))
    distances = _restore_crossings(distances, sdf.values.astype(np.float64))
    return SdfGrid(grid=sdf.grid, values=distances.astype(np.float32))


def _restore_crossings(distances: Floats, values: Floats) -> Floats:
    """Nudge distances so that each grid edge is crossed where the field `values` crosses it.

    At the crossing t of an edge, r = (1 - t) d_0 + t d_1 should vanish; each end gives way by the
    mean r of its edges. Eight rounds leave less than a tenth of the error. Edges that the
    distances cross elsewhere, because a part was dropped or cut, are left alone.
    """
    edges = []
    agree = (values < 0) == (distances < 0)
    for axis in range(3):
        low = tuple(slice(0, -1) if a == axis else slice(None) for a in range(3))
        high = tuple(slice(1, None) if a == axis else slice(None) for a in range(3))
        crossing = ((values[low] < 0) != (values[high] < 0)) & agree[low] & agree[high]
        difference = np.where(crossing, values[low] - values[high], 1.0)
        edges.append((low, high, crossing, np.where(crossing, values[low] / difference, 0.0)))
    n_edges = np.zeros_like(distances)
    for low, high, crossing, _ in edges:
        n_edges[low] += crossing
        n_edges[high] += crossing
    corrected = distances.copy()
    for _ in range(8):
        residual = np.zeros_like(distances)
        for low, high, crossing, t in edges:
            r = np.where(crossing, (1.0 - t) * corrected[low] + t * corrected[high], 0.0)
            residual[low] += r
            residual[high] += r
        corrected -= residual / np.maximum(n_edges, 1.0)
    # A sample at the zero level itself must not change sides by a rounding.
    return np.where(distances < 0, np.minimum(corrected, -1e-12), np.maximum(corrected, 0.0))


def signed_distances(
    mesh: TriangleMesh, points: Floats, *, num_threads: int | None = None
) -> Floats:
    """Exact distance of points (n, 3) to the triangles, negative inside [m] -> (n,) [m]."""
    return MeshScene(mesh.vertices, mesh.faces, num_threads=num_threads).signed_distance(points)


def surface_report(mesh: TriangleMesh) -> SurfaceReport:
    """Count, closedness, area, volume and holes of a mesh."""
    watertight = mesh.faces.shape[0] > 0 and bool(closed_edges(mesh.faces).all())
    _, n_components = face_labels(mesh.faces)
    return SurfaceReport(
        n_vertices=mesh.vertices.shape[0],
        n_faces=mesh.faces.shape[0],
        n_components=n_components,
        is_watertight=watertight,
        area_m2=float(face_areas(mesh.corners).sum()),
        volume_m3=enclosed_volume_m3(mesh.vertices, mesh.faces) if watertight else None,
        n_holes=_n_holes(mesh, n_components) if watertight else None,
    )


def _n_holes(mesh: TriangleMesh, n_components: int) -> int:
    """Sum of the genera g of closed pieces: V - E + F = sum over pieces of 2 - 2 g."""
    n_vertices, n_faces = len(np.unique(mesh.faces)), len(mesh.faces)
    # Every edge of a closed surface has two faces.
    return n_components - (n_vertices - 3 * n_faces // 2 + n_faces) // 2


def largest_components(
    mesh: TriangleMesh,
    *,
    support: Floats | None = None,
    min_area_fraction: float = MIN_AREA_FRACTION,
    min_support: int = MIN_SUPPORT,
    support_reach_m: float = SUPPORT_REACH_M,
) -> tuple[TriangleMesh, ComponentReport]:
    """Drop what is not a surface that was seen: voids, unsupported pieces, fragments.

    The main component is the one with most `support` (the glints' positions, (n, 3) [m]) within
    `support_reach_m`, or the largest where no support is given. Another component stays if it
    faces outwards and has at least `min_area_fraction` of the main one's area. With `support` it
    also needs MIN_SUPPORT_DENSITY of the main one's points per area, and a smaller one stays if
    it has `min_support` points and MIN_SUPPORT_SHARE of the main one's. The main component always
    stays, so that a surface is never answered by nothing.
    """
    labels, n_components = face_labels(mesh.faces)
    if n_components == 0:
        report = ComponentReport(
            n_kept=0, n_fragments=0, n_unsupported=0, n_voids=0, dropped_area_m2=0.0
        )
        return mesh, report
    areas = np.bincount(labels, face_areas(mesh.corners), minlength=n_components)
    six_fold = six_fold_volumes(mesh.vertices, mesh.faces)
    volumes = np.bincount(labels, six_fold, minlength=n_components)
    is_open = ~closed_edges(mesh.faces)
    n_open = np.bincount(np.tile(labels, 3), is_open, minlength=n_components)
    voids = (volumes < 0) & (n_open == 0)
    if support is None:
        main = int(np.argmax(np.where(voids, -1.0, areas)))
        fragments = areas < min_area_fraction * areas[main]
        unsupported = np.zeros(n_components, dtype=bool)
    else:
        counts = _support_counts(mesh, labels, n_components, support, support_reach_m)
        main = int(np.lexsort((areas, counts, ~voids))[-1])
        small = areas < min_area_fraction * areas[main]
        few = np.maximum(min_support, MIN_SUPPORT_SHARE * counts[main])
        small &= (counts < few) | (areas < MIN_SUPPORTED_AREA_FRACTION * areas[main])
        thin = counts * areas[main] < MIN_SUPPORT_DENSITY * counts[main] * areas
        fragments = small | thin
        unsupported = counts == 0
    voids[main] = unsupported[main] = False
    unsupported &= ~voids
    fragments &= ~voids & ~unsupported
    keep = ~(voids | unsupported | fragments)
    report = ComponentReport(
        n_kept=int(keep.sum()),
        n_fragments=int(fragments.sum()),
        n_unsupported=int(unsupported.sum()),
        n_voids=int(voids.sum()),
        dropped_area_m2=float(areas[~keep].sum()),
    )
    return mesh.with_faces(mesh.faces[keep[labels]]), report


def drop_components(mesh: TriangleMesh, marked: Bools) -> TriangleMesh:
    """Leave out connected pieces with more than half of their area on marked faces."""
    labels, n_components = face_labels(mesh.faces)
    areas = face_areas(mesh.corners)
    total = np.bincount(labels, areas, minlength=n_components)
    share = np.bincount(labels, areas * marked, minlength=n_components)
    return mesh.with_faces(mesh.faces[(share <= 0.5 * total)[labels]])


def _support_counts(
    mesh: TriangleMesh, labels: Ints, n_components: int, support: Floats, reach_m: float
) -> Ints:
    """Points within reach of each component; each point counts for its nearest vertex's."""
    if support.shape[0] == 0:
        return np.zeros(n_components, dtype=np.int64)
    vertex_labels = np.full(mesh.vertices.shape[0], -1, dtype=np.int64)
    vertex_labels[mesh.faces.reshape(-1)] = np.repeat(labels, 3)
    used = np.flatnonzero(vertex_labels >= 0)
    distances, nearest = KDTree(mesh.vertices[used]).query(support)
    within = vertex_labels[used][nearest[distances <= reach_m]]
    return np.bincount(within, minlength=n_components)
