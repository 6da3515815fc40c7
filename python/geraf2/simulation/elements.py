"""Surfaces cut into elements small enough for physical optics."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from geraf2._types import Bools, Floats, Ints
from geraf2.geometry.triangles import face_areas, split_triangles, unit_normals, with_area
from geraf2.ops.physical_optics import SurfaceElements
from geraf2.scene import Wall
from geraf2.simulation.walls import WallShape

# Cosines of a random surface; with 64 it does not repeat within an object.
_N_ROUGH_WAVES = 64
_PLACES_PER_STEP = 1000  # their cosines, 1.5 MB in float64, stay in a core's cache
NUDGE_M = 1e-6
"""Wall patches are moved by this to the side they are lit from, so that they do not cross it."""


def mesh_elements(
    vertices: Floats,
    faces: Ints,
    max_edge_m: float,
    roughness: Callable[[Floats], Floats] | None = None,
) -> tuple[SurfaceElements, Floats]:
    """Conducting triangles of a mesh and their areas [m^2].

    vertices: (n_vertices, 3) [m].
    faces: counter-clockwise from outside, (n_faces, 3).
    max_edge_m: longest edge of an element, before it is displaced [m].
    roughness: displacement of positions (..., 3) [m], see :func:`rough_displacement`, or None.
    """
    pieces = split_triangles(vertices[faces], max_edge_m)
    if roughness is not None:
        pieces = pieces + roughness(pieces)
    pieces = with_area(pieces)
    centroids = pieces.mean(axis=1)
    elements = SurfaceElements(
        points=centroids,
        normals=unit_normals(pieces),
        edges=pieces[:, :2] - centroids[:, None],
        shape="triangle",
    )
    return elements, face_areas(pieces)


def rough_displacement(
    rms_m: float, length_m: float, rng: np.random.Generator
) -> Callable[[Floats], Floats]:
    """Smooth random displacement as a function of position, so that neighbours stay joined.

    Each coordinate is a sum of cosines with normal wave vectors: nearly Gaussian, of covariance
    rms^2 exp(-distance^2 / (2 length^2)).

    rms_m: of each coordinate [m].
    length_m: correlation length [m].
    rng: source of random numbers.
    """
    waves = rng.normal(size=(3 * _N_ROUGH_WAVES, 3)) / (2.0 * np.pi * length_m)
    phases = rng.uniform(0.0, 1.0, 3 * _N_ROUGH_WAVES)  # turns, as of the waves a metre
    scale = np.float32(rms_m * np.sqrt(2.0 / _N_ROUGH_WAVES))

    def displace(positions: Floats) -> Floats:
        flat = positions.reshape(-1, 3)
        # Each corner of a mesh is one of about six triangles: equal ones are next to each other in
        # the order of some projection.
        order = np.argsort((flat * [1.0, np.sqrt(2.0), np.sqrt(3.0)]).sum(axis=1))
        near = flat[order]
        is_new = np.ones(len(near), dtype=np.bool_)
        is_new[1:] = (near[1:] != near[:-1]).any(axis=1)
        places = near[is_new]
        moved = np.empty((len(places), 3), dtype=np.float32)
        for start in range(0, len(places), _PLACES_PER_STEP):
            part = slice(start, start + _PLACES_PER_STEP)
            turns = places[part] @ waves.T + phases
            turns -= np.rint(turns)
            cosines = np.cos(np.float32(2.0 * np.pi) * turns.astype(np.float32))
            moved[part] = scale * cosines.reshape(-1, 3, _N_ROUGH_WAVES).sum(axis=2)
        found = np.empty_like(flat)
        found[order] = moved[np.cumsum(is_new) - 1]
        return found.reshape(positions.shape)

    return displace


def wall_elements(
    wall: Wall, patch_m: float, *, inside: bool, shape: WallShape | None = None
) -> tuple[SurfaceElements, Floats]:
    """Rectangular patches of a box's six walls, and their areas [m^2].

    patch_m: largest side of a patch [m].
    inside: True: the walls as seen from inside the box; False: from outside.
    shape: how the walls depart from their planes; plane when None.
    """
    half = 0.5 * np.asarray(wall.size_m) - (wall.thickness_m if inside else 0.0)
    points, normals, edges = [], [], []
    for axis in range(3):
        across = [(axis + 1) % 3, (axis + 2) % 3]
        lines = [_lines(half[k], patch_m) for k in across]
        centers = [0.5 * (line[1:] + line[:-1]) for line in lines]
        halves = [0.5 * np.diff(line) for line in lines]
        u, v = (grid.ravel() for grid in np.meshgrid(*centers, indexing="ij"))
        half_u, half_v = (grid.ravel() for grid in np.meshgrid(*halves, indexing="ij"))
        for side in (-1.0, 1.0):
            outward = np.zeros(3)
            outward[axis] = side
            normal = -outward if inside else outward
            point = np.zeros((u.size, 3))
            point[:, axis] = side * half[axis]
            point[:, across[0]], point[:, across[1]] = u, v
            edge = np.zeros((u.size, 2, 3))
            edge[:, 0, across[0]] = half_u
            edge[:, 1, across[1]] = half_v
            normal = np.broadcast_to(normal, point.shape)
            if shape is not None:
                shift, slope = shape.displacement(axis, side, u, v)
                point[:, axis] += side * shift
                edge[:, 0, axis], edge[:, 1, axis] = side * slope.T * [half_u, half_v]
                normal = normal.copy()
                normal[:, across] -= (-1.0 if inside else 1.0) * slope
                normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            points.append(point + NUDGE_M * normal + np.asarray(wall.center_m))
            normals.append(normal)
            edges.append(edge)
    all_edges = np.concatenate(edges)
    areas = 4.0 * np.linalg.norm(all_edges, axis=2).prod(axis=1)

    patches = SurfaceElements(
        points=np.concatenate(points),
        normals=np.concatenate(normals),
        edges=all_edges,
        shape="rectangle",
        reflector="slab",
        slab=wall,
    )
    return patches, areas


def _lines(half_m: float, step_m: float) -> Floats:
    """Cut -half to half into equal steps of at most step_m."""
    n = max(1, int(np.ceil(2.0 * half_m / step_m)))
    return np.linspace(-half_m, half_m, n + 1)


def select(elements: SurfaceElements, used: Bools) -> SurfaceElements:
    """Elements of a mask, (n_points,)."""
    return replace(
        elements,
        points=elements.points[used],
        normals=None if elements.normals is None else elements.normals[used],
        edges=None if elements.edges is None else elements.edges[used],
    )
