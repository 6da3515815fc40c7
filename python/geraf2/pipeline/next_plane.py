"""The plane to scan next: the one that takes most of the expected error off a run per minute."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from geraf2._types import Floats
from geraf2.errors import UserError
from geraf2.evaluation.sight import plane_sees
from geraf2.geometry.triangles import vertex_normals
from geraf2.io.mesh import TriangleMesh
from geraf2.io.scan_file import ScanFile
from geraf2.ops.visibility import MeshScene
from geraf2.pipeline.reconstruction import load_run
from geraf2.pipeline.scan_time import Scanner, plane_at, swept_planes
from geraf2.scene.plan import Plane

# Error of surface that was seen, which that has after it that was not: the median that runs state
# of it on the benchmark's figures.
_SEEN_ERROR_M = 0.4e-3
# Normals of surface that was not seen are guesses: of each, itself and four this far off it count.
_DOUBT_RAD = np.deg2rad(10.0)
_N_VERTICES = 2000
_AZIMUTHS_DEG = np.arange(0.0, 360.0, 20.0)
_ELEVATIONS_DEG = (-30.0, -15.0, 0.0, 20.0, 40.0, 60.0, 90.0)
_EXTENTS = ((1.0, 1.0), (0.6, 1.0), (1.0, 0.6), (1.6, 1.0))


@dataclass(frozen=True, kw_only=True, eq=False)
class NextPlane:
    """A plane, and what it is good for."""

    plane: Plane
    azimuth_deg: float
    elevation_deg: float
    seconds: float
    """Of its lines [s]."""
    error_m: float
    """Mean expected error of the surface before [m]."""
    error_after_m: float
    """Mean expected error with it [m]."""
    scan: ScanFile

    @property
    def gain_m_per_minute(self) -> float:
        """Mean expected error that a minute takes off [m/min]."""
        return 60.0 * (self.error_m - self.error_after_m) / self.seconds


def next_planes(
    run: Path,
    scanner: Scanner,
    *,
    standoff_m: float,
    aperture_m: tuple[float, float],
    spacing_m: float,
    max_elevation_deg: float = 90.0,
    n_best: int = 3,
) -> list[NextPlane]:
    """Planes that lower the expected error of a run most per minute, the best first.

    run: folder of the run, with a surface. scanner: how long a plane takes.
    standoff_m: of the planes from the middle of the box. aperture_m: width and height; narrower,
    lower and wider ones are tried, too. spacing_m: of the antennas.

    Planes that look at the box from below are tried where the arm reaches above it, too
    (`max_elevation_deg` 90), down to 30 degrees.
    """
    result = load_run(run)
    mesh, center = result.content_mesh, np.asarray(result.prior.center_m)
    radius = 0.5 * float(np.linalg.norm(result.prior.size_m))
    if standoff_m <= 0.5 * min(result.prior.size_m):
        raise UserError(
            what="the plane would lie in the box",
            where="--standoff",
            expected=f"more than {radius:.3f} m, half the diagonal of the box",
            got=f"{standoff_m:g} m",
        )
    candidates, angles = [], []
    for elevation, azimuth in product(_ELEVATIONS_DEG, _AZIMUTHS_DEG):
        if elevation > max_elevation_deg or (elevation < 0 and max_elevation_deg < 90.0):
            continue
        if elevation == 90.0 and azimuth > 0.0:
            continue
        for wide, high in _EXTENTS:
            half = 0.5 * np.asarray(aperture_m) * (wide, high)
            plane = plane_at(np.deg2rad(azimuth), np.deg2rad(elevation), standoff_m, half)
            shifted = Plane(middle=plane.middle + center, axes=plane.axes, half_m=half)
            candidates.append(shifted)
            angles.append((azimuth, elevation))
    before, after = expected_errors(mesh, candidates)
    found = []
    for plane, (azimuth, elevation), error in zip(candidates, angles, after, strict=True):
        scan, seconds = swept_planes([plane], spacing_m, scanner)
        found.append(
            NextPlane(
                plane=plane,
                azimuth_deg=azimuth,
                elevation_deg=elevation,
                seconds=seconds,
                error_m=before,
                error_after_m=float(error),
                scan=scan,
            )
        )
    best: dict[tuple[float, float], NextPlane] = {}
    for one in sorted(found, key=lambda one: -one.gain_m_per_minute):
        best.setdefault((one.azimuth_deg, one.elevation_deg), one)  # an extent for each direction
    return list(best.values())[:n_best]


def expected_errors(mesh: TriangleMesh, candidates: Sequence[Plane]) -> tuple[float, Floats]:
    """Mean expected error of a surface, and that with each of the planes added, (n,) [m].

    What a plane will see has the error of seen surface afterwards, where it was larger.
    """
    if mesh.expected_error_m is None:
        raise UserError(what="the surface does not say its expected error: reconstruct it again")
    error = mesh.expected_error_m
    corners = mesh.corners
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    weights = np.zeros(len(mesh.vertices))
    np.add.at(weights, mesh.faces, np.linalg.norm(doubled, axis=1)[:, None])
    chosen = np.random.default_rng(0).choice(
        len(weights), min(_N_VERTICES, len(weights)), replace=False
    )
    weights, error, points = weights[chosen], error[chosen], mesh.vertices[chosen]
    weights = weights / weights.sum()
    normals = vertex_normals(mesh.vertices, mesh.faces)[chosen]
    blocker = MeshScene(mesh.vertices, mesh.faces)
    gain = weights * np.maximum(error - _SEEN_ERROR_M, 0.0)
    doubtful = _doubtful(normals)
    before = float(weights @ error)
    after = []
    for plane in candidates:
        seen = np.mean([plane_sees(plane, points, one, blocker) for one in doubtful], axis=0)
        after.append(before - float(gain @ seen))
    return before, np.array(after)


def _doubtful(normals: Floats) -> list[Floats]:
    """Give the normals, and those tilted off them four ways."""
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(normals, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normals, first)
    ways = (first, -first, second, -second)
    return [normals, *(np.cos(_DOUBT_RAD) * normals + np.sin(_DOUBT_RAD) * w for w in ways)]
