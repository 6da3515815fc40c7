"""The line-of-sight prior: the outside of the box as a closed mesh, and what its walls do."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from geraf2._validation import require_positive, require_shape
from geraf2.errors import UserError
from geraf2.io.mesh import TriangleMesh
from geraf2.scene.capture import Wall

# Corners by binary index (x, y, z); triangles wind counter-clockwise seen from outside.
_BOX_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
_BOX_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class LosPrior:
    """Outer surface of the closed box in the capture frame."""

    vertices: NDArray[np.float64]
    """(n_vertices, 3) [m]."""
    faces: NDArray[np.int64]
    """Vertex indices of each triangle, counter-clockwise from outside, (n_faces, 3)."""
    walls: tuple[Wall, ...] = ()
    """Known dielectric walls, outermost first; empty when nothing is known."""

    def __post_init__(self) -> None:
        require_shape("vertices", self.vertices, (None, 3))
        require_shape("faces", self.faces, (None, 3))

    @classmethod
    def from_box(
        cls,
        size_m: tuple[float, float, float],
        center_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
        walls: tuple[Wall, ...] = (),
    ) -> "LosPrior":
        """Prior from three outer side lengths [m], axes along the frame's."""
        for side in size_m:
            require_positive("size_m", side)
        half = 0.5 * np.asarray(size_m, dtype=np.float64)
        vertices = np.asarray(center_m) + _BOX_CORNERS * half
        return cls(vertices=vertices, faces=_BOX_FACES.astype(np.int64), walls=walls)

    @classmethod
    def from_mesh(
        cls, mesh: TriangleMesh, walls: tuple[Wall, ...] = (), *, where: object = None
    ) -> "LosPrior":
        """Prior from a closed mesh in the capture frame [m]; turned outward if wound inward.

        Parameters
        ----------
        mesh
            Outer surface of the box; every edge shared by two triangles.
        walls
            Known dielectric walls, outermost first.
        where
            Named in the error, e.g. the file.
        """
        n_open = count_open_edges(mesh.faces)
        if n_open:
            raise UserError(
                what=f"the mesh is not closed: {n_open} open edges",
                where=where,
                expected="a closed surface, every edge shared by two triangles of one winding",
                hint="close it (a scan's holes, duplicate or flipped faces), or use --box X Y Z",
            )
        faces = mesh.faces
        if enclosed_volume_m3(mesh) < 0:
            faces = np.ascontiguousarray(faces[:, ::-1])
        return cls(vertices=mesh.vertices, faces=faces, walls=walls)

    @cached_property
    def corners(self) -> NDArray[np.float64]:
        """Vertices of the convex hull, (n, 3) [m].

        The farthest point in any direction, and from any place, is one of them; a scan has a
        thousand times as many vertices.
        """
        try:
            return np.asarray(self.vertices[ConvexHull(self.vertices).vertices])
        except QhullError:  # flat
            return self.vertices

    @property
    def size_m(self) -> tuple[float, float, float]:
        """Side lengths of the bounding box [m]."""
        x, y, z = (float(side) for side in self.bounds[1] - self.bounds[0])
        return x, y, z

    @property
    def center_m(self) -> tuple[float, float, float]:
        """Centre of the bounding box [m]."""
        x, y, z = (float(value) for value in self.bounds.mean(axis=0))
        return x, y, z

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Smallest and largest coordinates, (2, 3) [m]."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])


def count_open_edges(faces: NDArray[np.int64]) -> int:
    """Directed edges without exactly one partner in the other direction; 0 if closed."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    n_vertices = int(faces.max()) + 1 if faces.size else 1
    there = edges[:, 0] * n_vertices + edges[:, 1]
    back = edges[:, 1] * n_vertices + edges[:, 0]
    keys, counts = np.unique(there, return_counts=True)
    position = np.minimum(np.searchsorted(keys, back), len(keys) - 1) if len(keys) else back
    n_partners = np.where(keys[position] == back, counts[position], 0) if len(keys) else back
    return int((n_partners != 1).sum())


def enclosed_volume_m3(mesh: TriangleMesh) -> float:
    """Signed volume of a closed mesh, positive if wound outward [m^3]."""
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)
