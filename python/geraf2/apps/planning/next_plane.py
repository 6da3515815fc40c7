"""The plane to scan next: the one that takes most of the expected error off a run per minute."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from geraf2._types import Floats
from geraf2.apps.planning.scan_time import Scanner, plane_at, swept_planes
from geraf2.errors import UserError
from geraf2.freespace.specular import angles_off
from geraf2.geometry.triangles import vertex_areas, vertex_normals
from geraf2.io.mesh import TriangleMesh
from geraf2.io.planes import load_planes
from geraf2.io.run_folder import PLANES_NAME
from geraf2.io.scan_file import ScanFile
from geraf2.pipeline.reconstruction import load_run
from geraf2.scene.aperture import Aperture

# Error of surface that was seen, and of unseen surface once a plane sees it: the median of the
# expected error of seen surface on the benchmark's objects.
_SEEN_ERROR_M = 0.4e-3
_N_VERTICES = 2000
_AZIMUTHS_DEG = np.arange(0.0, 360.0, 20.0)
_ELEVATIONS_DEG = (0.0, 20.0, 40.0, 60.0, 90.0)
_SHAPES = ((1.0, 1.0), (0.6, 1.0), (1.0, 0.6), (1.6, 1.0))


@dataclass(frozen=True, kw_only=True, eq=False)
class NextPlane:
    """A plane, and what it is good for."""

    plane: Aperture
    azimuth_deg: float
    elevation_deg: float
    seconds: float
    """Of its lines [s]."""
    error_m: float
    """Mean expected error of the surface before [m]."""
    error_after_m: float
    """Mean expected error with it [m]."""
    scanner: Scanner
    spacing_m: float
    """Of its antennas [m]."""

    @property
    def scan(self) -> ScanFile:
        """Its lines."""
        return swept_planes([self.plane], self.spacing_m, self.scanner)[0]

    @property
    def gain_m_per_minute(self) -> float:
        """Decrease of the mean expected error per minute of scanning [m/min]."""
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
    shapes: Sequence[tuple[float, float]] = _SHAPES,
) -> list[NextPlane]:
    """Planes that lower the expected error of a run most per minute, the best first.

    run: folder of the run, with a surface. scanner: how long a plane takes.
    standoff_m: of the planes from the middle of the box. aperture_m: width and height. spacing_m:
    of the antennas. shapes: widths and heights that are tried, relative to the aperture.

    None looks at the box from below, where the table is.
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
    halves = [0.5 * np.asarray(aperture_m) * shape for shape in shapes]
    middle = [plane_at(0.0, 0.0, standoff_m, half) for half in halves]
    times = [swept_planes([plane], spacing_m, scanner)[1] for plane in middle]
    candidates, about = [], []
    for elevation, azimuth in product(_ELEVATIONS_DEG, _AZIMUTHS_DEG):
        if elevation > max_elevation_deg or (elevation == 90.0 and azimuth > 0.0):
            continue
        for half, seconds in zip(halves, times, strict=True):
            plane = plane_at(np.deg2rad(azimuth), np.deg2rad(elevation), standoff_m, half)
            shifted = Aperture.from_rectangle(plane.middle_m + center, plane.axes, half)
            candidates.append(shifted)
            about.append((azimuth, elevation, seconds))
    corners = load_planes(run / PLANES_NAME).corners_m
    if not len(corners):
        raise UserError(what="the run does not state its planes: reconstruct it again", where=run)
    planes = [Aperture.from_corners(one) for one in corners]
    before, after = expected_errors(mesh, planes, candidates, center)
    found = [
        NextPlane(
            plane=plane,
            azimuth_deg=azimuth,
            elevation_deg=elevation,
            seconds=seconds,
            error_m=before,
            error_after_m=float(error),
            scanner=scanner,
            spacing_m=spacing_m,
        )
        for plane, (azimuth, elevation, seconds), error in zip(
            candidates, about, after, strict=True
        )
    ]
    best: dict[tuple[float, float], NextPlane] = {}
    for one in sorted(found, key=lambda one: -one.gain_m_per_minute):
        best.setdefault((one.azimuth_deg, one.elevation_deg), one)  # an extent for each direction
    return list(best.values())[:n_best]


def expected_errors(
    mesh: TriangleMesh, planes: Sequence[Aperture], candidates: Sequence[Aperture], center_m: Floats
) -> tuple[float, Floats]:
    """Mean expected error of a surface, and that with each of the candidates added, (n,) [m].

    Let a be the angle between a normal and the nearest one that a plane sees. The surface there
    is continued from the seen one and errs by rho a^2 / 2 for a radius of curvature rho. The error
    is modelled as `e_0 + kappa a^2`, with kappa such that its mean is the stated one.

    mesh: with its expected error. planes: of its scan. center_m: of what was scanned, (3,).
    """
    if mesh.expected_error_m is None:
        raise UserError(what="the surface does not state its expected error: reconstruct it again")
    weights = vertex_areas(mesh.vertices, mesh.faces)
    weights /= weights.sum()
    before = float(weights @ mesh.expected_error_m)
    chosen = np.random.default_rng(0).choice(len(weights), _N_VERTICES, p=weights)
    normals = vertex_normals(mesh.vertices, mesh.faces)[chosen]
    off = angles_off(normals, planes, center_m)
    squared = float(np.mean(off**2))
    kappa = max(before - _SEEN_ERROR_M, 0.0) / max(squared, 1e-12)
    after = [
        before - kappa * (squared - float(np.mean(np.minimum(off, own) ** 2)))
        for own in (angles_off(normals, [plane], center_m) for plane in candidates)
    ]
    return before, np.array(after)
