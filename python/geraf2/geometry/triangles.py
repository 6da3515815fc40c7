"""Triangles: corner arrays (n, 3, 3), and meshes as vertices (n, 3) and faces (n, 3)."""

import numpy as np

from geraf2._memory import require_memory
from geraf2._types import Bools, Floats, Ints

_BYTES_PER_PIECE = 400.0
"""Memory per facet while triangles are halved."""

Faces = Ints


def face_vectors(corners: Floats) -> Floats:
    """Cross product of two edges, (n, 3, 3) [m] -> (n, 3) [m^2].

    Its length is twice the area; seen from its tip the corners are counter-clockwise.
    """
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def unit_normals(corners: Floats) -> Floats:
    """Direction of `face_vectors`, (n, 3, 3) -> (n, 3); zero where a triangle has no area."""
    return _unit(face_vectors(corners))


def face_areas(corners: Floats) -> Floats:
    """Area of each triangle, (n, 3, 3) [m] -> (n,) [m^2]."""
    return np.asarray(0.5 * np.linalg.norm(face_vectors(corners), axis=1))


def with_area(corners: Floats) -> Floats:
    """Triangles (n, 3, 3) without those of no area."""
    return corners[face_areas(corners) > 0.0]


def vertex_normals(vertices: Floats, faces: Faces) -> Floats:
    """Area-weighted unit normals, (n_vertices, 3); zero where no face has area."""
    vectors = face_vectors(vertices[faces])
    summed = np.zeros_like(vertices, dtype=np.float64)
    for corner in range(3):
        np.add.at(summed, faces[:, corner], vectors)
    return _unit(summed)


def vertex_areas(vertices: Floats, faces: Faces) -> Floats:
    """Area of each vertex, a third of its faces' area, (n_vertices,) [m^2]."""
    thirds = np.repeat(face_areas(vertices[faces]) / 3.0, 3)
    areas = np.bincount(faces.reshape(-1), thirds, minlength=vertices.shape[0])
    return np.asarray(areas, dtype=np.float64)


def barycentric(points: Floats, corners: Floats) -> Floats:
    """Barycentric weights of points (n, 3) in their triangles (n, 3, 3), (n, 3).

    They are not negative and sum to 1; thirds where a triangle has no area.
    """
    a, b, c = (corners[:, corner] for corner in range(3))
    normal = face_vectors(corners)
    square = np.einsum("nk,nk->n", normal, normal)
    safe = np.where(square > 0.0, square, 1.0)
    of_b = np.einsum("nk,nk->n", np.cross(points - a, c - a), normal) / safe
    of_c = np.einsum("nk,nk->n", np.cross(b - a, points - a), normal) / safe
    weights = np.clip(np.stack([1.0 - of_b - of_c, of_b, of_c], axis=1), 0.0, 1.0)
    weights[square == 0.0] = 1.0 / 3.0
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def split_triangles(corners: Floats, max_edge_m: float) -> Floats:
    """Halve triangles across their longest edge until no edge is longer than the limit.

    corners: (n_triangles, 3, 3) [m].
    max_edge_m: longest edge allowed [m].

    Returns corners of the pieces with the same winding, (n_pieces, 3, 3) [m].
    """
    rest = np.asarray(corners, dtype=np.float64)
    # The smallest pieces are halves of an equilateral triangle with this side.
    n_pieces = len(rest) + float(face_areas(rest).sum()) / (0.2 * max_edge_m**2)
    hint = f"facets of {max_edge_m:g} m are too small for this surface"
    require_memory(_BYTES_PER_PIECE * n_pieces, hint)
    done = []
    while rest.shape[0]:
        lengths = np.linalg.norm(np.roll(rest, -1, axis=1) - rest, axis=2)
        longest = lengths.argmax(axis=1)
        short = lengths.max(axis=1) <= max_edge_m
        done.append(rest[short])
        rest, longest = rest[~short], longest[~short]
        order = (longest[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(rest, order[:, :, None], axis=1), 1, 0)
        middle = 0.5 * (a + b)
        rest = np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])
    return np.concatenate(done) if done else rest


def six_fold_volumes(vertices: Floats, faces: Faces) -> Floats:
    """Six times the signed volume between each face and the mesh's centre, (n_faces,) [m^3].

    Relative to the centre, since rounding errors would grow with the distance from the origin.
    """
    if faces.shape[0] == 0:
        return np.zeros(0)
    a, b, c = np.moveaxis((vertices - vertices.mean(axis=0))[faces], 1, 0)
    return np.asarray(np.einsum("ij,ij->i", a, np.cross(b, c)))


def enclosed_volume_m3(vertices: Floats, faces: Faces) -> float:
    """Signed volume of a closed mesh, positive if wound outward [m^3]."""
    return float(six_fold_volumes(vertices, faces).sum() / 6.0)


def volume_centroid_m(vertices: Floats, faces: Faces) -> Floats:
    """Centroid of the enclosed volume; the mean vertex where that is not positive, (3,) [m]."""
    six, middle = six_fold_volumes(vertices, faces), np.asarray(vertices.mean(axis=0))
    if six.sum() <= 0:
        return middle
    return np.asarray(middle + six @ (vertices - middle)[faces].sum(axis=1) / (4.0 * six.sum()))


def directed_edges(faces: Faces) -> Faces:
    """Start and end vertex of the first edges of all faces, then second, then third, (3 n, 2)."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def closed_edges(faces: Faces) -> Bools:
    """Whether each of `directed_edges` occurs once, and once reversed, (3 n,)."""
    step = np.array([int(faces.max(initial=0)) + 1, 1])
    edges = directed_edges(faces)
    there, back = edges @ step, edges @ step[::-1]
    keys, counts = np.unique(there, return_counts=True)
    index = np.minimum(np.searchsorted(keys, back), len(keys) - 1)
    n_partners = np.where(keys[index] == back, counts[index], 0)
    return np.asarray((n_partners == 1) & (counts[np.searchsorted(keys, there)] == 1))


def count_open_edges(faces: Faces) -> int:
    """Directed edges without exactly one reversed partner; 0 if closed."""
    return int((~closed_edges(faces)).sum())


def used_vertices(faces: Faces) -> tuple[Faces, Faces]:
    """Ascending indices of the vertices of faces, and the faces renumbered by them."""
    used = np.unique(faces)
    return used, np.searchsorted(used, faces)


def _unit(vectors: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0))
