"""Parts of the content: position, size, volume and area, each with an uncertainty."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import repeat
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats, Ints
from geraf2.apps.inspection.material import UNKNOWN, Material, Measured
from geraf2.echoes.glint_set import Glints
from geraf2.errors import UserError
from geraf2.geometry.components import connected_labels, face_labels
from geraf2.geometry.transforms import triple
from geraf2.geometry.triangles import (
    closed_edges,
    directed_edges,
    enclosed_volume_m3,
    face_areas,
    vertex_areas,
    vertex_normals,
    volume_centroid_m,
)
from geraf2.io.mesh import Evidence, TriangleMesh
from geraf2.io.text import interval_text
from geraf2.pipeline.reconstruction import Reconstruction
from geraf2.surfaces.error_field import N_SAMPLES, unit_errors
from geraf2.surfaces.expected_error import nearness

PATCH_M = 0.010
"""Distance beyond which errors of the surface are independent [m]: about the footprint of a
sub-aperture of 8 cm at 0.4 m."""
_MIN_PART_SHARE = 0.02
"""Least area of a part relative to the largest, as in the reconstruction."""
_MIN_GLINTS = 3
"""Fewest glints of a body that is too small to be a part."""

# RMS errors near a glint and elsewhere, for meshes without expected errors.
_SEEN_ERROR_M, _GUESSED_ERROR_M = 0.002, 0.006


@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """One part of the content, with uncertainty and evidence of each vertex."""

    mesh: TriangleMesh
    """Its surface [m]."""
    sigma_m: Floats
    """Standard uncertainty of each vertex along its normal, (n_vertices,) [m]."""
    seen: Bools
    """Whether echoes support the vertex, (n_vertices,)."""
    moved_m: Floats
    """How far samples of the surface move each vertex outwards, (n_samples, n_vertices) [m]."""
    probability: float = 1.0
    """That it exists."""

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
class BodyReport:
    """A part in numbers."""

    center_m: tuple[float, float, float]
    """Centroid of its volume, in the capture's frame [m]."""
    center_sigma_m: tuple[float, float, float] | None
    """Standard uncertainty of that, per coordinate [m]; None as those of lengths."""
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
    probability: float | None
    """That it exists, and is no ghost; None of a scan that is not to be trusted."""
    material: Material
    """What it is made of."""

    @property
    def center_text(self) -> str:
        """Centre with its interval [mm]."""
        return position_text(self.center_m, self.center_sigma_m, max(self.extents_m))

    def weighed(self, share: float) -> "BodyReport":
        """Weigh what is known by the probability that the scan is right; at 0 nothing is."""
        found = replace(self, material=self.material.weighed(share))
        if share > 0.0:
            return replace(found, probability=share * (self.probability or 0.0))
        one, two, three = (replace(length, sigma=None) for length in self.dimensions_m)
        return replace(
            found,
            probability=None,
            center_sigma_m=None,
            dimensions_m=(one, two, three),
            volume_m3=replace(self.volume_m3, sigma=None),
            area_m2=replace(self.area_m2, sigma=None),
        )


def position_text(center_m: Iterable[float], sigma_m: Iterable[float] | None, size_m: float) -> str:
    """Coordinates with their intervals [mm]; size_m: of the thing, which bounds an interval."""
    sigmas = repeat(None) if sigma_m is None else sigma_m
    return ", ".join(
        interval_text(1e3 * v, None if s is None else 1.96e3 * s, scale=1e3 * size_m)
        for v, s in zip(center_m, sigmas, strict=False)
    )


def body_of(
    mesh: TriangleMesh, glints: Glints | None = None, moved_m: Floats | None = None
) -> Body:
    """Body of a mesh, with its own errors and evidence, or estimates from glints.

    mesh: content of a run. glints: oriented points of the same run.
    moved_m: samples of its surface, (n_samples, n_vertices) [m]; drawn from its errors when None.
    """
    errors, evidence = mesh.expected_error_m, mesh.evidence
    n = len(mesh.vertices)
    seen = np.ones(n, dtype=bool) if glints is None else nearness(mesh, glints).seen
    if evidence is not None:
        seen = evidence == Evidence.SEEN
    if errors is None:
        errors = np.where(seen, _SEEN_ERROR_M, _GUESSED_ERROR_M)
    sigma_m = np.asarray(errors, dtype=np.float64)
    if moved_m is None:
        moved_m = sigma_m * unit_errors(mesh.vertices, N_SAMPLES, np.random.default_rng(0))
    return Body(mesh=mesh, sigma_m=sigma_m, seen=seen, moved_m=moved_m)


def content_of(result: Reconstruction, *, has_samples: bool = True) -> tuple[Body, list[Body]]:
    """All of the content of a run, and its parts; UserError where there is none.

    has_samples: whether to draw samples of the run's surface, which takes a second.
    """
    content = result.content_mesh
    if not len(content.faces):
        raise UserError(
            what="nothing was found in the box: its surface is empty", where=result.path
        )
    try:
        moved = result.samples().displacements_m if has_samples else None
    except UserError:  # a preset that states no errors, or a run without its files
        moved = None
    whole = body_of(content, result.glints, moved)
    return whole, split_bodies(whole)


def split_bodies(body: Body) -> list[Body]:
    """Split into connected parts, the largest first.

    Parts below _MIN_PART_SHARE of the largest are left out.
    """
    labels, n_parts = face_labels(body.mesh.faces)
    areas = np.bincount(labels, face_areas(body.mesh.corners), minlength=n_parts)
    order = [
        p for p in np.argsort(-areas, kind="stable") if areas[p] >= _MIN_PART_SHARE * max(areas)
    ]
    confidence = body.mesh.confidence
    parts = [body.mesh.faces[labels == part] for part in order]
    return [
        replace(
            part_of(body, faces),
            probability=1.0 if confidence is None else float(confidence[faces[0, 0]]),
        )
        for faces in parts
    ]


def small_bodies(bodies: Sequence[Body], glints: Glints | None) -> list[str]:
    """Sentence on each group of glints that is too small to be a part."""
    if glints is None or not len(glints):
        return []
    near = KDTree(np.concatenate([body.mesh.vertices for body in bodies]))
    apart = np.flatnonzero(near.query(glints.positions)[0] > PATCH_M)
    i, j = KDTree(glints.positions[apart]).query_pairs(PATCH_M, output_type="ndarray").T
    group = connected_labels(i, j, len(apart))
    found = []
    for number in np.unique(group):
        own = apart[group == number]
        n_planes = len(np.unique(glints.poses[own]))
        if len(own) < _MIN_GLINTS or n_planes < 2:
            continue
        at = ", ".join(f"{1e3 * v:z.0f}" for v in glints.positions[own].mean(axis=0))
        found.append(
            f"echoes of a small body, which is no part, come from ({at}) mm: {len(own)} glints of "
            f"{n_planes} planes"
        )
    return found


def part_of(body: Body, faces: Ints) -> Body:
    """Cut out some of the faces of a body, with the vertices that they use."""
    used = np.unique(faces)
    mesh = TriangleMesh(vertices=body.mesh.vertices[used], faces=np.searchsorted(used, faces))
    return replace(
        body,
        mesh=mesh,
        sigma_m=body.sigma_m[used],
        seen=body.seen[used],
        moved_m=body.moved_m[:, used],
    )


def close_holes(body: Body) -> Body:
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
        moved_m=np.pad(body.moved_m, ((0, 0), (0, len(holes)))),
        seen=np.append(body.seen, np.zeros(len(holes), dtype=bool)),
    )


def measure(body: Body, material: Material = UNKNOWN) -> BodyReport:
    """Position, lengths along its own axes, volume and area of a part.

    Standard uncertainties are those of the values over the samples.
    """
    import trimesh  # noqa: PLC0415 - takes 0.3 s

    mesh = body.mesh
    bounds = trimesh.bounds.oriented_bounds(mesh.vertices, ordered=True)
    lengths, axes = np.asarray(bounds[1]), np.asarray(bounds[0])[:3, :3]
    axes = axes[np.argsort(-lengths, kind="stable")]

    def sizes(vertices: Floats) -> Floats:
        moved = replace(mesh, vertices=vertices)
        volume = enclosed_volume_m3(vertices, mesh.faces)
        center = volume_centroid_m(vertices, mesh.faces)
        area = float(face_areas(moved.corners).sum())
        return np.array([*center, *np.ptp(vertices @ axes.T, axis=0), volume, area])

    normals = vertex_normals(mesh.vertices, mesh.faces)
    values = sizes(mesh.vertices)
    drawn = [sizes(mesh.vertices + moved[:, None] * normals) for moved in body.moved_m]
    sigmas = np.std(drawn, axis=0, ddof=1)
    pairs = zip(values, sigmas, strict=True)
    measured = [Measured(value=float(value), sigma=float(sigma)) for value, sigma in pairs]
    areas = body.areas_m2
    return BodyReport(
        center_m=triple(values[:3]),
        center_sigma_m=triple(sigmas[:3]),
        axes=tuple(triple(axis) for axis in axes),
        extents_m=triple(np.ptp(mesh.vertices, axis=0)),
        dimensions_m=(measured[3], measured[4], measured[5]),
        volume_m3=measured[6],
        area_m2=measured[7],
        seen_fraction=float(areas[body.seen].sum() / max(areas.sum(), 1e-30)),
        probability=body.probability,
        material=material,
    )
