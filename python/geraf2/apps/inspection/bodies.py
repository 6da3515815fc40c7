"""Parts of the content: position, size, volume and area, each with an uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from geraf2._types import Bools, Floats, Ints
from geraf2.echoes.glint_set import Glints
from geraf2.geometry.components import connected_labels, face_labels
from geraf2.geometry.transforms import triple
from geraf2.geometry.triangles import (
    closed_edges,
    directed_edges,
    enclosed_volume_m3,
    face_areas,
    face_vectors,
    vertex_areas,
    vertex_normals,
    volume_centroid_m,
)
from geraf2.io.mesh import Evidence, TriangleMesh
from geraf2.surfaces.expected_error import nearness

PATCH_M = 0.010
"""Distance beyond which errors of the surface are independent [m]: about the footprint of a
sub-aperture of 8 cm at 0.4 m."""
UNSEEN_PATCH_M = 0.020
"""The same for unseen surface [m]: its errors correlate by 0.70 to 0.99 over 5 to 10 mm and by 0.34
to 0.72 over 10 to 20 mm, those of seen surface by 0.26 to 0.54 and 0.18 to 0.46."""
COMMON_SHARE = 0.3
"""Share of the variance of the errors that is common to a whole part."""
ERROR_FACTOR = 2.0
"""Ratio of the errors of parts with flats to the expected errors, which were fitted on smooth
objects: root mean square over the vertices of four development parts of
`bench/python/inspection.py`, 1.8 to 2.5."""
MIN_PART_SHARE = 0.02
"""Least area of a part relative to the largest, as in the reconstruction."""

# RMS errors near a glint and elsewhere, for meshes without expected errors.
_SEEN_ERROR_M, _GUESSED_ERROR_M = 0.002, 0.006
# Vertices this near to the extreme of a part define its end [m]: a voxel of the usual fit.
_END_REACH_M = 0.003


@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """One part of the content, with uncertainty and evidence of each vertex."""

    mesh: TriangleMesh
    """Its surface [m]."""
    sigma_m: Floats
    """Standard uncertainty of each vertex along its normal, (n_vertices,) [m]."""
    seen: Bools
    """Whether echoes support the vertex, (n_vertices,)."""

    @property
    def areas_m2(self) -> Floats:
        """Area around each vertex, (n_vertices,) [m^2]."""
        return vertex_areas(self.mesh.vertices, self.mesh.faces)


class Content(NamedTuple):
    """What was measured in a box."""

    bodies: Sequence[Body]
    """Its parts."""
    whole: Body
    """All parts in one."""
    glints: Glints | None = None
    """Of the same run."""


@dataclass(frozen=True, kw_only=True)
class Measured:
    """A value with its standard uncertainty."""

    value: float
    """In the unit of its name."""
    sigma: float
    """Standard uncertainty, in the same unit; 95 % of errors are below 1.96 of it."""


@dataclass(frozen=True, kw_only=True)
class BodyReport:
    """A part in numbers."""

    center_m: tuple[float, float, float]
    """Centroid of its volume, in the capture's frame [m]."""
    center_sigma_m: tuple[float, float, float]
    """Standard uncertainty of that, per coordinate [m]."""
    axes: tuple[tuple[float, float, float], ...]
    """Unit vectors of the smallest box around it, the longest side first."""
    extents_m: tuple[float, float, float]
    """Lengths along the frame's x, y, z [m]."""
    dimensions_m: tuple[Measured, Measured, Measured]
    """Lengths along these axes [m]."""
    volume_m3: Measured
    """Enclosed volume [m^3]."""
    area_m2: Measured
    """Area of its surface [m^2]."""
    seen_fraction: float
    """Share of its area that was seen."""


def body_of(mesh: TriangleMesh, glints: Glints | None = None) -> Body:
    """Body of a mesh, with its own errors and evidence, or estimates from glints.

    mesh: content of a run. glints: oriented points of the same run.
    """
    errors, evidence = mesh.expected_error_m, mesh.evidence
    n = len(mesh.vertices)
    seen = np.ones(n, dtype=bool) if glints is None else nearness(mesh, glints).seen
    if evidence is not None:
        seen = evidence == Evidence.SEEN
    if errors is None:
        errors = np.where(seen, _SEEN_ERROR_M, _GUESSED_ERROR_M)
    return Body(mesh=mesh, sigma_m=np.asarray(errors, dtype=np.float64), seen=seen)


def split_bodies(body: Body) -> list[Body]:
    """Split into connected parts, the largest first.

    Parts below MIN_PART_SHARE of the largest are left out.
    """
    labels, n_parts = face_labels(body.mesh.faces)
    areas = np.bincount(labels, face_areas(body.mesh.corners), minlength=n_parts)
    order = [
        p for p in np.argsort(-areas, kind="stable") if areas[p] >= MIN_PART_SHARE * max(areas)
    ]
    return [part_of(body, body.mesh.faces[labels == part]) for part in order]


def part_of(body: Body, faces: Ints) -> Body:
    """Cut out some of the faces of a body, with the vertices that they use."""
    used = np.unique(faces)
    mesh = TriangleMesh(vertices=body.mesh.vertices[used], faces=np.searchsorted(used, faces))
    return replace(body, mesh=mesh, sigma_m=body.sigma_m[used], seen=body.seen[used])


def capped(body: Body) -> Body:
    """Close the holes of a cut body with fans about their centres, marked as unseen."""
    mesh = body.mesh
    rim = directed_edges(mesh.faces)[~closed_edges(mesh.faces)]
    if not len(rim):
        return body
    n = len(mesh.vertices)
    labels = connected_labels(rim[:, 0], rim[:, 1], n)
    holes, hole = np.unique(labels[rim[:, 0]], return_inverse=True)
    middles = [mesh.vertices[np.unique(rim[hole == k])].mean(axis=0) for k in range(len(holes))]
    fan = np.c_[rim[:, ::-1], n + hole]
    return replace(
        body,
        mesh=TriangleMesh(
            vertices=np.concatenate([mesh.vertices, middles]),
            faces=np.concatenate([mesh.faces, fan]),
        ),
        sigma_m=np.append(body.sigma_m, np.full(len(holes), _GUESSED_ERROR_M)),
        seen=np.append(body.seen, np.zeros(len(holes), dtype=bool)),
    )


def measure(body: Body) -> BodyReport:
    """Position, lengths along its own axes, volume and area of a part.

    A displacement d(x) of the surface along its normal changes volume, centre and area by

        dV = int d dA,   dc = int (x - c) d dA / V,   dA = int 2 H d dA,

    H the mean curvature. The variance of d is sigma^2 of the vertices times ERROR_FACTOR^2. Its
    COMMON_SHARE is common to the part; the rest is independent between patches (PATCH_M, or
    UNSEEN_PATCH_M where unseen).
    """
    import trimesh  # noqa: PLC0415 - takes 0.3 s

    mesh, areas = body.mesh, body.areas_m2
    volume = enclosed_volume_m3(mesh.vertices, mesh.faces)
    center = volume_centroid_m(mesh.vertices, mesh.faces)
    arms = (mesh.vertices - center) / max(volume, 1e-12)
    bounds = trimesh.bounds.oriented_bounds(mesh.vertices, ordered=True)
    lengths, axes = np.asarray(bounds[1]), np.asarray(bounds[0])[:3, :3]
    order = np.argsort(-lengths, kind="stable")
    axes = axes[order]
    return BodyReport(
        center_m=triple(center),
        center_sigma_m=triple(_spread(body, arms[:, axis], areas) for axis in range(3)),
        axes=tuple(triple(axis) for axis in axes),
        extents_m=triple(np.ptp(mesh.vertices, axis=0)),
        dimensions_m=tuple(_length(body, axis) for axis in axes),  # type: ignore[arg-type]
        volume_m3=Measured(value=volume, sigma=_spread(body, np.ones(len(areas)), areas)),
        area_m2=Measured(
            value=float(areas.sum()), sigma=_spread(body, _twice_curvature(mesh, areas), areas)
        ),
        seen_fraction=float(areas[body.seen].sum() / max(areas.sum(), 1e-30)),
    )


def _spread(body: Body, weight: Floats, areas: Floats) -> float:
    """Return the standard deviation of int weight d dA, see `measure`."""
    common = float(np.sum(weight * body.sigma_m * areas)) ** 2
    patch = np.where(body.seen, PATCH_M, UNSEEN_PATCH_M)
    single = float(np.sum(patch**2 * weight**2 * body.sigma_m**2 * areas))
    return ERROR_FACTOR * float(np.sqrt(COMMON_SHARE * common + (1.0 - COMMON_SHARE) * single))


def _length(body: Body, axis: Floats) -> Measured:
    """Extent along an axis, its uncertainty from that of the vertices at both ends."""
    along = body.mesh.vertices @ axis
    low, high = float(along.min()), float(along.max())
    ends = (along <= low + _END_REACH_M, along >= high - _END_REACH_M)
    variance = sum(float(np.mean(body.sigma_m[end] ** 2)) for end in ends)
    return Measured(value=high - low, sigma=ERROR_FACTOR * float(np.sqrt(variance)))


def _twice_curvature(mesh: TriangleMesh, areas: Floats) -> Floats:
    """Twice the mean curvature, 2 H, (n_vertices,) [1/m]."""
    corners, gain = mesh.corners, np.zeros_like(mesh.vertices)
    normals = face_vectors(corners)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
    for corner in range(3):
        # The area of a triangle grows by half of the opposite edge, turned into its plane.
        edge = corners[:, (corner + 2) % 3] - corners[:, (corner + 1) % 3]
        np.add.at(gain, mesh.faces[:, corner], 0.5 * np.cross(normals, edge))
    outward = np.einsum("nk,nk->n", gain, vertex_normals(mesh.vertices, mesh.faces))
    return np.asarray(outward / np.maximum(areas, 1e-12))
