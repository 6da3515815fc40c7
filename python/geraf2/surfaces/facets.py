"""Echo of a known surface: the lensless model for an infinitely sharp surface.

Opacity is then a step at the surface and a ray has one weight, at its point on it. The squared
transmittance is 1 where antenna and point are in line of sight, else 0. Points lie closer than half
the carrier's wavelength, so the specular lobe need not be modelled: neighbouring echoes add up
where the surface mirrors the antenna, and cancel elsewhere (docs/math/heat-maps.md#surface-echo).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Floats, Ints
from geraf2._validation import require_positive, require_shape
from geraf2.geometry.triangles import face_areas, unit_normals, with_area
from geraf2.ops import signal_tracer
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Pose, Waveform
from geraf2.surfaces.clusters import antenna_clusters

ExcessPath = Callable[[Floats, Floats, Floats], Floats]
"""Excess one-way path in the walls (n,) [m] from antennas, unit directions and ranges."""

N_WALL_PARTS = 2
"""Number of parts of the walls: near walls seen from outside, far walls seen from inside."""
# Least cosine of incidence: the signal tracer's specular factor is zero beyond 45 degrees.
_MIN_COSINE = 0.7
# Rays leave a facet this far above it [m], so that neighbours of a curved surface do not hide it.
_LIFT_M = 2e-5


@dataclass(frozen=True, kw_only=True, eq=False)
class Facets:
    """Small pieces of a surface."""

    points: Floats
    """Centroids, (n_facets, 3) [m]."""
    normals: Floats
    """Unit, outward, (n_facets, 3)."""
    areas: Floats
    """(n_facets,) [m^2]."""

    def __post_init__(self) -> None:
        n_facets = self.points.shape[0]
        require_shape("points", self.points, (n_facets, 3))
        require_shape("normals", self.normals, (n_facets, 3))
        require_shape("areas", self.areas, (n_facets,))

    @classmethod
    def of_triangles(cls, triangles: Floats) -> "Facets":
        """Facets of triangles, corners (n_triangles, 3, 3) [m], counter-clockwise from outside.

        Triangles without an area are left out.
        """
        pieces = with_area(triangles)
        return cls(
            points=pieces.mean(axis=1), normals=unit_normals(pieces), areas=face_areas(pieces)
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class LitFacets:
    """Facets in line of sight of a group of antennas."""

    index: Ints
    """Ascending indices of the facets, (n_lit,)."""
    points: Floats
    """Apparent positions, farther by the walls' excess path, (n_lit, 3) [m]."""
    normals: Floats
    """(n_lit, 3)."""
    amplitudes: Floats
    """Area times spreading factor, (n_lit,) [m^2]."""


class SurfaceRenderer:
    """Signals that a content and its box scatter back, one for each part.

    content: facets of the content.
    outside: facets of the box's outer surface.
    blocker: mesh of the content, which blocks lines of sight.
    center_m: position where one square metre has amplitude 1.
    excess_path: excess path of the walls; zero when None.
    n_clusters: groups of neighbouring antennas that share visibility, spreading and excess path.
    """

    def __init__(
        self,
        content: Facets,
        outside: Facets,
        blocker: MeshScene,
        waveform: Waveform,
        center_m: tuple[float, float, float],
        *,
        excess_path: ExcessPath | None = None,
        n_clusters: int = 6,
        num_threads: int | None = None,
    ) -> None:
        require_positive("n_clusters", n_clusters)
        self.content, self.outside, self.waveform = content, outside, waveform
        self._blocker, self._center = blocker, np.asarray(center_m, dtype=np.float64)
        self._excess_path = excess_path
        self._n_clusters, self._num_threads = n_clusters, num_threads

    def render(self, pose: Pose, shares: Floats) -> NDArray[np.complex64]:
        """Signals of the parts of the scene at a plane's antennas.

        s_i(t) = sum_p share_p area_p V_p (R_0 / R_p)^2 (w_o . w_r)_+ exp(-j 2 pi f_t d / c)

        d is the two-way path with the walls' excess path. V_p is 1 where the centre of the antenna
        group has a line of sight to the point, and R_0 its distance from `center_m`. Source:
        equation 4 of the paper in the limit s -> infinity, with the spreading of equation 2.

        pose: the plane; its measured signal is not read.
        shares: share of each content facet in each part, (n_parts, n_facets), not negative.

        Returns (n_parts + 2, n_antennas, n_samples): the parts of the content, then the near walls
        seen from outside and the far walls seen from inside.
        """
        require_shape("shares", shares, (None, self.content.points.shape[0]))
        n_parts = len(shares)
        shape = (n_parts + N_WALL_PARTS, pose.n_antennas, self.waveform.n_samples)
        out = np.zeros(shape, dtype=np.complex64)
        for group in antenna_clusters(pose.phase_centers, self._n_clusters):
            middle = pose.phase_centers[group].mean(axis=0)
            content = self.lit_content(middle)
            for number, share in enumerate(shares):
                out[number, group] = self._trace(content, share[content.index], pose, group)
            near = self._lit(self.outside, middle, side=1.0, is_inside=False)
            far = self._lit(self.outside, middle, side=-1.0, is_inside=True)
            out[n_parts, group] = self._trace(near, 1.0, pose, group)
            out[n_parts + 1, group] = self._trace(far, 1.0, pose, group)
        return out

    def lit_content(self, middle: Floats) -> LitFacets:
        """Facets of the content in line of sight of antennas around a position (3,) [m]."""
        return self._lit(self.content, middle, side=1.0, is_inside=True)

    def _trace(
        self, lit: LitFacets, share: Floats | float, pose: Pose, group: Ints
    ) -> NDArray[np.complex64] | float:
        amplitude = lit.amplitudes * share
        used = amplitude > 0.0
        if not used.any():
            return 0.0
        echo = amplitude[used].astype(np.float32)
        geometry = lit.points[used], pose.tx_positions[group], pose.rx_positions[group]
        return signal_tracer(
            echo, *geometry, self.waveform, normals=lit.normals[used], num_threads=self._num_threads
        )

    def _lit(self, facets: Facets, middle: Floats, *, side: float, is_inside: bool) -> LitFacets:
        """Facets whose outer (side 1) or inner (-1) face is in line of sight of `middle`."""
        direction = middle - facets.points
        length = np.linalg.norm(direction, axis=1)
        cosine = side * np.einsum("ij,ij->i", direction, facets.normals) / length
        index = np.flatnonzero(cosine > _MIN_COSINE)
        if is_inside and index.size:
            starts = facets.points[index] + _LIFT_M * side * facets.normals[index]
            targets = np.broadcast_to(middle, starts.shape)
            index = index[~self._blocker.occluded(starts, targets)]
        points, length = facets.points[index], length[index]
        if is_inside and index.size:
            points = self._apparent(middle, points, direction[index], length)
        return LitFacets(
            index=index,
            points=points,
            normals=facets.normals[index],
            amplitudes=facets.areas[index] * self._spreading(middle, length),
        )

    def _apparent(
        self, middle: Floats, points: Floats, direction: Floats, length: Floats
    ) -> Floats:
        """Apparent positions of points in the box, farther by the excess path, (n, 3) [m]."""
        if self._excess_path is None:
            return points
        towards = -direction / length[:, None]
        # The facets of a far wall lie on it: stop before, so that the ray does not cross it.
        before = length - 10.0 * _LIFT_M
        excess = self._excess_path(np.broadcast_to(middle, points.shape), towards, before)
        return np.asarray(points + towards * excess[:, None])

    def _spreading(self, middle: Floats, length: Floats) -> Floats:
        return np.asarray((float(np.linalg.norm(middle - self._center)) / length) ** 2)
