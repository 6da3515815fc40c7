"""Triangle meshes in memory."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geraf2._validation import require_shape


@dataclass(frozen=True, kw_only=True, eq=False)
class TriangleMesh:
    """Triangles in metres; outward winding where closed."""

    vertices: NDArray[np.float64]
    """(n_vertices, 3) [m]."""
    faces: NDArray[np.int64]
    """Vertex indices, counter-clockwise from outside, (n_faces, 3)."""
    confidence: NDArray[np.float64] | None = None
    """How well each vertex was seen, 0 to 1, (n_vertices,)."""

    def __post_init__(self) -> None:
        require_shape("vertices", self.vertices, (None, 3))
        require_shape("faces", self.faces, (None, 3))
        if self.confidence is not None:
            require_shape("confidence", self.confidence, (self.vertices.shape[0],))
