"""Meshes of a run from a signed distance field: content, box, and both together."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation

from geraf2._types import Floats
from geraf2.echoes.glint_set import Glints
from geraf2.fields import SdfGrid
from geraf2.geometry.transforms import triple
from geraf2.io.mesh import TriangleMesh
from geraf2.scene import Grid, LosPrior, Wall
from geraf2.surfaces.error_field import sample_surface
from geraf2.surfaces.fit import Evidence
from geraf2.surfaces.isosurface import (
    drop_components,
    extract_surface,
    largest_components,
    signed_distances,
)
from geraf2.surfaces.pieces import separate_pieces
from geraf2.surfaces.samples import SurfaceSamples

MESH_VERSION = 10
"""Increase when the same field gives another mesh or another expected error."""


class ExtractedMeshes(NamedTuple):
    """Boundaries of the nested sets that the field describes, in metres."""

    mesh: TriangleMesh
    """Box and content together."""
    mesh_box: TriangleMesh
    """The box: outer surface of the prior, and inner faces of walls of known thickness."""
    mesh_content: TriangleMesh
    """The content, with expected error, evidence and confidence of each vertex."""
    samples: SurfaceSamples | None = None
    """Samples of the content's surface; None for a field without glints."""
    ghosts: TriangleMesh | None = None
    """Pieces that likely do not exist; None for a field without glints."""


def extract_meshes(
    sdf: SdfGrid,
    evidence: Glints | Evidence,
    prior: LosPrior,
    *,
    num_threads: int | None = None,
) -> ExtractedMeshes:
    """Zero level of a field, separated into box and content by the prior.

    evidence: data of the fit that gave `sdf`.

    The content is the zero level of `sdf` inside the prior's innermost known face, without voids
    and fragments (:func:`content_surface`). Each vertex has its expected error
    (:func:`geraf2.surfaces.error_field.sample_surface`). The box comes from the prior. `mesh` holds
    both: f < 0 in the wall and in the content, f > 0 in the air between them.
    """
    if isinstance(evidence, Glints):
        evidence = Evidence(glints=evidence)
    surface = content_surface(sdf, prior, num_threads=num_threads)
    content, ghosts = separate_pieces(surface, evidence.glints)
    samples = sample_surface(content, evidence)
    samples = replace(samples, mesh=replace(samples.mesh, confidence=content.confidence))
    box = box_surface(prior)
    return ExtractedMeshes(
        mesh=TriangleMesh.joined([box, samples.mesh]),
        mesh_box=box,
        mesh_content=samples.mesh,
        samples=samples,
        ghosts=ghosts,
    )


def content_surface(
    sdf: SdfGrid, prior: LosPrior, *, num_threads: int | None = None
) -> TriangleMesh:
    """Zero level of max(f, b), where b < 0 inside the box.

    b is the signed distance to the prior's surface plus the thickness of the outermost known
    wall. An intersection of sets, unlike a cut of triangles, keeps the surface closed where the
    fitted field meets the wall.
    """
    thickness = prior.walls[0].thickness_m if prior.walls else 0.0
    return extract_surface(_inside(sdf, prior, thickness, num_threads))


def cropped_content(
    sdf: SdfGrid, prior: LosPrior, crop_m: float, *, num_threads: int | None = None
) -> TriangleMesh:
    """Content of a field without glints that includes the box's walls.

    Everything nearer to the prior's surface than `crop_m` [m] is cut off. Residual pieces of a
    wall, with most of their area on the cut, are dropped with voids and fragments.
    """
    surface = extract_surface(_inside(sdf, prior, crop_m, num_threads))
    if surface.faces.shape[0]:
        middles = surface.vertices[surface.faces].mean(axis=1)
        beside = signed_distances(prior.mesh, middles, num_threads=num_threads) + crop_m
        surface = drop_components(surface, np.abs(beside) < 0.5 * sdf.grid.spacing_m)
    return largest_components(surface)


def _inside(sdf: SdfGrid, prior: LosPrior, margin_m: float, num_threads: int | None) -> SdfGrid:
    """Intersect the content with the box's inside, `margin_m` below the prior's surface [m].

    Computed only in cells with a corner inside: no other cell has a part of the zero level.
    """
    near = binary_dilation(sdf.values <= 0.0, np.ones((3, 3, 3), dtype=bool)).ravel()
    depth = signed_distances(prior.mesh, sdf.grid.points()[near], num_threads=num_threads)
    values = sdf.values.ravel().copy()
    values[near] = np.maximum(values[near], (depth + margin_m).astype(np.float32))
    return SdfGrid(grid=sdf.grid, values=values.reshape(sdf.grid.shape))


def extract_cropped_meshes(
    sdf: SdfGrid, prior: LosPrior, crop_m: float, *, num_threads: int | None = None
) -> ExtractedMeshes:
    """Meshes of a run without glints: content by :func:`cropped_content`, box from the prior."""
    content = cropped_content(sdf, prior, crop_m, num_threads=num_threads)
    box = box_surface(prior)
    mesh = TriangleMesh.joined([box, content])
    return ExtractedMeshes(mesh=mesh, mesh_box=box, mesh_content=content)


def box_surface(prior: LosPrior) -> TriangleMesh:
    """Outer surface of the prior, and both faces of every wall of known thickness."""
    parts = [prior.mesh]
    if prior.walls:
        parts.append(_inner_face(prior, prior.walls[0]))
        for wall in prior.walls[1:]:
            parts.append(LosPrior.from_box(wall.size_m, wall.center_m).mesh)
            parts.append(_flipped(LosPrior.from_box(wall.inner_size_m, wall.center_m).mesh))
    return TriangleMesh.joined(parts)


def prior_distance(prior: LosPrior, grid: Grid, num_threads: int | None = None) -> Floats:
    """Distance of each voxel centre to the prior's surface, negative inside, grid.shape [m]."""
    return signed_distances(prior.mesh, grid.points(), num_threads=num_threads).reshape(grid.shape)


def _flipped(mesh: TriangleMesh) -> TriangleMesh:
    return TriangleMesh(vertices=mesh.vertices, faces=np.ascontiguousarray(mesh.faces[:, ::-1]))


def _inner_face(prior: LosPrior, wall: Wall) -> TriangleMesh:
    """Inner face of the outermost wall, wound so that it faces the air inside."""
    if prior.cuboid is not None:
        axes, size, center = prior.cuboid
        sides = triple(size - 2.0 * wall.thickness_m)
        inner = LosPrior.from_box(sides, triple(center), axes=axes)
        return _flipped(inner.mesh)
    # Any other closed shape: the level set one thickness inside. Flat parts are exact, edges are
    # rounded by a voxel; 80 voxels a side take about a second.
    extent = prior.bounds[1] - prior.bounds[0]
    spacing = max(float(extent.max()) / 80.0, 0.5 * wall.thickness_m)
    shape = tuple(int(n) for n in np.ceil(extent / spacing).astype(int) + 3)
    grid = Grid(
        origin_m=triple(prior.bounds[0] - spacing),
        spacing_m=spacing,
        shape=(shape[0], shape[1], shape[2]),
    )
    distance = prior_distance(prior, grid).astype(np.float32)
    return _flipped(extract_surface(SdfGrid(grid=grid, values=distance), -wall.thickness_m))
