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
"""Least area of a kept component relative to the main one; noise blobs have less than 0.01."""

MIN_SUPPORT = 10
"""Least glints on a small kept component: several sub-apertures see a true facet."""

MIN_SUPPORT_SHARE = 0.02
"""Least glints on a small kept component, as a share of the main component's glints."""

MIN_SUPPORTED_AREA_FRACTION = 0.001
"""Least area of a component with enough glints, relative to the main one."""

MIN_SUPPORT_DENSITY = 0.1
"""Least glints per area of a kept component, relative to the main one."""

SUPPORT_REACH_M = 0.005
"""Largest distance of a glint from its component [m]; 98 % of correct glints lie within it."""


@dataclass(frozen=True, kw_only=True)
class SurfaceReport:
    """Topology and size of a mesh."""

    n_vertices: int
    """Number of vertices."""
    n_faces: int
    """Number of triangles."""
    n_components: int
    """Number of connected components."""
    is_watertight: bool
    """Whether every edge is shared by exactly two consistently wound faces."""
    area_m2: float
    """Total area [m^2]."""
    volume_m3: float | None
    """Enclosed volume, None unless watertight [m^3]."""
    n_holes: int | None = None
    """Number of holes, the sum of the components' genera; None unless watertight."""


@dataclass(frozen=True, kw_only=True)
class ComponentReport:
    """Numbers of kept and of dropped connected components."""

    n_kept: int
    """Components kept."""
    n_fragments: int
    """Dropped: small with few glints, or with few glints per area."""
    n_unsupported: int
    """Dropped: no glint within reach."""
    n_voids: int
    """Dropped: closed surfaces that face inwards; a radar cannot see into a reflector."""
    dropped_area_m2: float
    """Total area dropped [m^2]."""


def extract_surface(sdf: SdfGrid, level: float = 0.0) -> TriangleMesh:
    """Triangles of the level set f(x) = level [m], wound counter-clockwise seen from f > level.

    Marching cubes interpolates crossings linearly along grid edges. A plane is therefore exact for
    any |grad f|. The surface is open where the level set meets the grid's border, and empty when
    no value crosses the level.
    """
    from skimage.measure import marching_cubes  # noqa: PLC0415 - heavy, needed only here

    values = sdf.values
    if min(values.shape) < 2 or not values.min() < level <= values.max():
        return TriangleMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int64))
    # "descent" makes scikit-image wind the faces towards the larger values, the air.
    vertices, faces, _, _ = marching_cubes(
        values, level=level, gradient_direction="descent", allow_degenerate=False
    )
    positions = np.asarray(sdf.grid.origin_m) + sdf.grid.spacing_m * vertices.astype(np.float64)
    return TriangleMesh(vertices=positions, faces=faces.astype(np.int64))


def redistance(
    sdf: SdfGrid, surface: TriangleMesh | None = None, *, num_threads: int | None = None
) -> SdfGrid:
    """Replace each sample by its distance to the zero level, which does not move.

    f'(x) = sign(f(x)) min_y |x - y| over the triangles y of the zero level. A fitted field has
    the right zero level but a gradient of 0.2 to 0.75; the result has |grad f'| = 1. Triangles cut
    the corners of a curved surface, which moves it inwards by h^2 / (8 r): 0.04 mm for voxels of
    h = 4 mm and a radius of 30 mm. Samples beside the zero level are therefore corrected until it
    crosses the grid's edges where it did before.

    sdf: field with the zero level.
    surface: closed zero level to use instead, when parts of the field's own were dropped; it then
        determines distance and sign. By default `extract_surface(sdf)`, with the field's sign.
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
    """Correct distances so that they cross each grid edge where the field `values` does.

    At the crossing t of an edge, r = (1 - t) d_0 + t d_1 should vanish. Each voxel subtracts the
    mean r of its edges; eight rounds leave less than a tenth of the error. Edges that the
    distances cross elsewhere, because a component was dropped, stay as they are.
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
    # A sample on the zero level must not change its sign by rounding.
    return np.where(distances < 0, np.minimum(corrected, -1e-12), np.maximum(corrected, 0.0))


def signed_distances(
    mesh: TriangleMesh, points: Floats, *, num_threads: int | None = None
) -> Floats:
    """Exact distance of points (n, 3) to the triangles, negative inside [m] -> (n,) [m]."""
    return MeshScene(mesh.vertices, mesh.faces, num_threads=num_threads).signed_distance(points)


def surface_report(mesh: TriangleMesh) -> SurfaceReport:
    """Report number of elements, closedness, area, volume and holes of a mesh."""
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
    # Each edge of a closed surface has two faces.
    return n_components - (n_vertices - 3 * n_faces // 2 + n_faces) // 2


def largest_components(
    mesh: TriangleMesh,
    *,
    support: Floats | None = None,
    min_area_fraction: float = MIN_AREA_FRACTION,
    min_support: int = MIN_SUPPORT,
    support_reach_m: float = SUPPORT_REACH_M,
) -> tuple[TriangleMesh, ComponentReport]:
    """Drop components that no radar saw as a surface: voids, unsupported pieces, fragments.

    The main component is the one with most points of `support` within `support_reach_m`. `support`
    holds the glints' positions, (n, 3) [m]; without it the largest component is the main one.
    Another component stays if it faces outwards and has at least `min_area_fraction` of the main
    one's area. With `support` it also needs MIN_SUPPORT_DENSITY of the main one's points per area.
    A smaller one stays if it has `min_support` points and MIN_SUPPORT_SHARE of the main one's. The
    main component always stays, so that the result is not empty.
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
    """Drop connected components with more than half of their area on marked faces."""
    labels, n_components = face_labels(mesh.faces)
    areas = face_areas(mesh.corners)
    total = np.bincount(labels, areas, minlength=n_components)
    share = np.bincount(labels, areas * marked, minlength=n_components)
    return mesh.with_faces(mesh.faces[(share <= 0.5 * total)[labels]])


def _support_counts(
    mesh: TriangleMesh, labels: Ints, n_components: int, support: Floats, reach_m: float
) -> Ints:
    """Count the points within reach of each component; each counts for its nearest vertex."""
    if support.shape[0] == 0:
        return np.zeros(n_components, dtype=np.int64)
    vertex_labels = np.full(mesh.vertices.shape[0], -1, dtype=np.int64)
    vertex_labels[mesh.faces.reshape(-1)] = np.repeat(labels, 3)
    used = np.flatnonzero(vertex_labels >= 0)
    distances, nearest = KDTree(mesh.vertices[used]).query(support)
    within = vertex_labels[used][nearest[distances <= reach_m]]
    return np.bincount(within, minlength=n_components)
