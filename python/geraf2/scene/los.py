"""The line-of-sight prior: the outside of the box as a closed mesh, and what its walls do."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geraf2._validation import require_shape
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
        half = 0.5 * np.asarray(size_m, dtype=np.float64)
        vertices = np.asarray(center_m) + _BOX_CORNERS * half
        return cls(vertices=vertices, faces=_BOX_FACES.astype(np.int64), walls=walls)

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Smallest and largest coordinates, (2, 3) [m]."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])
