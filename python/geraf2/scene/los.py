"""The line-of-sight prior: the outside of the box as a closed mesh, and its dielectric walls."""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from geraf2._types import Floats, Ints
from geraf2._validation import require_positive, require_shape
from geraf2.errors import UserError
from geraf2.geometry.boxes import FACES, SIGNS, box_corners
from geraf2.geometry.shells import outer_shells
from geraf2.geometry.transforms import apply_rigid, triple
from geraf2.geometry.triangles import count_open_edges, enclosed_volume_m3, face_areas, unit_normals
from geraf2.io.mesh import TriangleMesh
from geraf2.records import Wall

# Cosine of angles, and corners over the size, off those of a cuboid.
_SQUARE = 1e-3
# A box turned by 2.5 degrees stands along the frame: calibration and silhouettes allow for it.
_ALONG_COSINE = float(np.cos(np.deg2rad(2.5)))
# Volume over diagonal^3 below which a box is flat: a sheet of 1 m with 0.1 mm has 4e-5.
_FLAT = 1e-6
# Least probability that a point lies in the box: an assumed face may lie farther. Least distance of
# an assumed face from the certain part [m].
_MIN_PRESENCE, _THIN_M = 0.05, 1e-6
# Volume over that of the convex hull below which a mesh encloses walls, and not what is between
# them: a carton of 0.22 m with walls of 4 mm and an open top has 0.09, an L of equal legs 0.86.
_HOLLOW = 0.3


@dataclass(frozen=True, kw_only=True, eq=False)
class LosPrior:
    """Outer surface of the closed box in the capture frame.

    Raises
    ------
    ValueError
        For sides that are not positive.
    UserError
        For a mesh that is not closed.

    Examples
    --------
    >>> box = geraf2.LosPrior.from_box((0.22, 0.22, 0.3), center_m=(0.0, 0.0, 0.05))
    >>> box.vertices.shape, [round(side, 3) for side in box.size_m]
    ((8, 3), [0.22, 0.22, 0.3])
    """

    vertices: Floats
    """(n_vertices, 3) [m]."""
    faces: Ints
    """Vertex indices of each triangle, counter-clockwise from outside, (n_faces, 3)."""
    walls: tuple[Wall, ...] = ()
    """Known dielectric walls, outermost first; empty when nothing is known."""
    certain: Floats | None = None
    """Corners of the part of a cuboid that surely lies in the box, (8, 3) [m]; None: all of it."""

    def __post_init__(self) -> None:
        require_shape("vertices", self.vertices, (None, 3))
        require_shape("faces", self.faces, (None, 3))

    @classmethod
    def from_box(
        cls,
        size_m: float | tuple[float, float, float],
        center_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
        walls: tuple[Wall, ...] = (),
        *,
        axes: Floats | None = None,
    ) -> "LosPrior":
        """Prior from three outer side lengths, or that of a cube [m], axes along the frame's.

        axes: or along these unit vectors, a right-handed set of rows, (3, 3).
        """
        if isinstance(size_m, int | float):
            size_m = (size_m, size_m, size_m)
        for side in size_m:
            require_positive("size_m", side)
        corners = box_corners(center_m, size_m)
        if axes is not None:
            corners = box_corners((0.0, 0.0, 0.0), size_m) @ axes + np.asarray(center_m)
        return cls(vertices=corners, faces=FACES.copy(), walls=walls)

    @classmethod
    def from_mesh(cls, mesh: TriangleMesh, *, where: object = None) -> "LosPrior":
        """Prior from a closed mesh in the capture frame [m]; turned outward if wound inward.

        mesh: outer surface of the box; every edge shared by two triangles. Shells inside another
            one, as the inner skin of its walls, are left out.
        where: named in the error, e.g. the file.
        """
        n_open = count_open_edges(mesh.faces)
        if n_open:
            raise UserError(
                what=f"the mesh is not closed: {n_open} open edges",
                where=where,
                expected="a closed surface, every edge shared by two triangles of one winding",
                hint="close it (a scan's holes, duplicate or flipped faces), or use --box X Y Z",
            )
        mesh = mesh.with_faces(mesh.faces[outer_shells(mesh.vertices, mesh.faces)])
        size = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
        if not abs(enclosed_volume_m3(mesh.vertices, mesh.faces)) > _FLAT * size**3:
            raise UserError(what="the mesh is flat and encloses nothing", where=where)
        _require_solid(mesh, where)
        faces = mesh.faces
        if enclosed_volume_m3(mesh.vertices, mesh.faces) < 0:
            faces = np.ascontiguousarray(faces[:, ::-1])
        return cls(vertices=mesh.vertices, faces=faces)

    @property
    def mesh(self) -> TriangleMesh:
        """The surface as a mesh of its own, wound outward [m]."""
        return TriangleMesh(vertices=self.vertices, faces=self.faces)

    @cached_property
    def corners(self) -> Floats:
        """Vertices of the convex hull, (n, 3) [m].

        The farthest point in any direction, and from any point, is one of them; a scan has a
        thousand times as many vertices.
        """
        try:
            return np.asarray(self.vertices[ConvexHull(self.vertices).vertices])
        except QhullError:  # flat
            return self.vertices

    @cached_property
    def cuboid(self) -> tuple[Floats, Floats, Floats] | None:
        """Axes (rows, right-handed), side lengths and middle of a cuboid; None of other shapes."""
        if len(self.vertices) != len(SIGNS):
            return None
        middle = self.vertices.mean(axis=0)
        normals, areas = (
            unit_normals(self.vertices[self.faces]),
            face_areas(self.vertices[self.faces]),
        )
        first = normals[areas.argmax()]
        across = np.abs(normals @ first) < _SQUARE
        if not across.any():
            return None
        second = normals[np.flatnonzero(across)[areas[across].argmax()]]
        second = second - (second @ first) * first
        second /= np.linalg.norm(second)
        axes = _nearest_order(np.stack([first, second, np.cross(first, second)]))
        along = (self.vertices - middle) @ axes.T
        half = np.abs(along).mean(axis=0)
        if not np.allclose(np.abs(along), half, atol=_SQUARE * float(half.max())):
            return None
        return axes, 2.0 * half, middle

    @property
    def is_turned(self) -> bool:
        """Whether this is a cuboid that does not stand along the axes of the frame."""
        return self.cuboid is not None and float(np.diag(self.cuboid[0]).min()) < _ALONG_COSINE

    def move(self, transform: Floats) -> "LosPrior":
        """Prior after a rigid transform of homogeneous coordinates, (4, 4)."""
        vertices = np.ascontiguousarray(apply_rigid(transform, self.vertices))
        certain = None if self.certain is None else apply_rigid(transform, self.certain)
        return replace(self, vertices=vertices, certain=certain)

    def presence(self, points: Floats) -> Floats:
        """Probability that each point of the cuboid lies in the box, (n,).

        1 in the certain part. A face that was assumed lies with equal probability anywhere between
        the certain part and itself.
        """
        if self.certain is None or self.cuboid is None:
            return np.ones(len(points))
        axes, size, middle = self.cuboid
        along, certain = (points - middle) @ axes.T, (self.certain - middle) @ axes.T
        share = np.ones(len(points))
        for sign in (-1.0, 1.0):
            beyond = 0.5 * size - sign * along
            width = 0.5 * size - (sign * certain).max(axis=0)
            assumed = width > _THIN_M
            ratio = beyond[:, assumed] / width[assumed]
            share *= np.clip(ratio, _MIN_PRESENCE, 1.0).prod(axis=1)
        return share

    @property
    def expected_volume_m3(self) -> float:
        """Mean volume of a cuboid with assumed faces; else that of the bounding box [m^3]."""
        if self.cuboid is None or (self.certain is None and not self.is_turned):
            return float(np.prod(np.ptp(self.bounds, axis=0)))
        axes, size, _ = self.cuboid
        least = size if self.certain is None else np.ptp(self.certain @ axes.T, axis=0)
        return float(np.prod(0.5 * (size + least)))

    def crop(self, margin_m: float) -> "LosPrior":
        """Bounding box, smaller by a margin [m] on every side; it has no walls.

        UserError where that leaves nothing.

        >>> geraf2.LosPrior.from_box((0.22, 0.22, 0.3)).crop(0.01)
        LosPrior(200 x 200 x 280 mm, 12 triangles, 0 walls)
        """
        x, y, z = (side - 2.0 * margin_m for side in self.size_m)
        if not min(x, y, z) > 0.0:
            raise UserError(
                what="nothing is left of the box when it is cropped",
                expected=f"a crop below half of its shortest side, {500 * min(self.size_m):.0f} mm",
                got=f"{1e3 * margin_m:.0f} mm of a box of {_size_text(self.size_m)}",
                hint="lower crop-m",
            )
        return LosPrior.from_box((x, y, z), self.center_m)

    def __repr__(self) -> str:
        """Summary in a line, without its arrays."""
        size = _size_text(self.size_m)
        return f"LosPrior({size}, {len(self.faces)} triangles, {len(self.walls)} walls)"

    @property
    def size_m(self) -> tuple[float, float, float]:
        """Side lengths of the bounding box [m]."""
        return triple(self.bounds[1] - self.bounds[0])

    @property
    def center_m(self) -> tuple[float, float, float]:
        """Centre of the bounding box [m]."""
        return triple(self.bounds.mean(axis=0))

    @property
    def bounds(self) -> Floats:
        """Smallest and largest coordinates, (2, 3) [m]."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])


def _require_solid(mesh: TriangleMesh, where: object) -> None:
    """Raise UserError for walls with an opening, whose inside is outside of the mesh."""
    share = abs(enclosed_volume_m3(mesh.vertices, mesh.faces)) / ConvexHull(mesh.vertices).volume
    if share < _HOLLOW:
        raise UserError(
            what=f"the mesh is hollow: it encloses its walls, {100 * share:.0f} % of its hull, and "
            "not what is between them",
            where=where,
            expected="the closed outer surface of the box",
            hint="close the opening and leave out the inner skin, or use --box X Y Z",
        )


def _nearest_order(axes: Floats) -> Floats:
    """Axes, rows, in the order and with the signs in which they are nearest to the frame's."""
    order = max(permutations(range(3)), key=lambda o: np.abs(axes[list(o)]).trace())
    turned = axes[list(order)]
    turned = turned * np.where(np.diag(turned) < 0.0, -1.0, 1.0)[:, None]
    return np.asarray(turned if np.linalg.det(turned) > 0.0 else turned * [[1.0], [-1.0], [1.0]])


def _size_text(size_m: tuple[float, ...]) -> str:
    """Text of side lengths in millimetres."""
    return " x ".join(f"{1e3 * side:.0f}" for side in size_m) + " mm"
