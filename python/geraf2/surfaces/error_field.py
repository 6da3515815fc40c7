"""Random surfaces around a reconstructed one, whose spread is the expected error of each vertex.

The error of a surface is described as a Gaussian field on its vertices: how far they may lie off is
the expected error, and how they move together is a correlation that falls with their distance, with
a part that the whole unseen surface has in common (docs/math/expected-error.md#samples).
"""

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.special import ndtri

from geraf2._memory import require_memory
from geraf2._types import Floats
from geraf2.io.mesh import TriangleMesh
from geraf2.surfaces.expected_error import evidence_of_vertices, nearness, own_errors_m
from geraf2.surfaces.fit import Evidence
from geraf2.surfaces.samples import SurfaceSamples

N_SAMPLES = 24
"""Number of samples: they give a standard deviation to 14 %."""
CORRELATION_M, COMMON_SHARE = 0.0085, 0.3
"""Length over which errors of the surface are correlated [m], and the share of their variance that
all vertices have in common: the prior closes what was not seen too wide, or too narrow. Both are
least squares over the correlation of errors in simulated scans with a truth
(`bench/python/expected_error.py --fit`)."""
_MAX_CELLS = 96
"""Cells along a side of the field's grid, at most; more resolve no shorter correlation."""
_BYTES_PER_DISPLACEMENT = 44.0
"""Memory of one vertex in one sample: temporary float64 arrays and the result [bytes]."""


def sample_surface(
    mesh: TriangleMesh, evidence: Evidence, *, n_samples: int = N_SAMPLES, seed: int = 0
) -> SurfaceSamples:
    """Draw surfaces that the scan allows; the mesh gets expected errors and evidence.

    Parameters
    ----------
    mesh
        Zero level of the fitted field, or some of its components.
    evidence
        Data of the fit.
    n_samples, seed
        Of the draws.

    Returns
    -------
    SurfaceSamples
        Displacements along the normals, (n_samples, n_vertices) [m]. Their root mean square is the
        expected error of each vertex.
    """
    near, common_m = nearness(mesh, evidence.glints), evidence.common_sigma_m
    kinds = evidence_of_vertices(mesh, near, evidence.outlines)
    own_m = own_errors_m(near, kinds)
    known = replace(mesh, expected_error_m=np.hypot(own_m, common_m), evidence=kinds)
    n_bytes = _BYTES_PER_DISPLACEMENT * n_samples * len(mesh.vertices)
    require_memory(n_bytes, f"{n_samples} samples are too many for this mesh")
    if not len(mesh.vertices):
        return SurfaceSamples(known, np.zeros((n_samples, 0)), common_m)
    rng = np.random.default_rng(seed)
    shared = _spread_draws(n_samples, rng)[:, None]
    field = unit_errors(mesh.vertices, n_samples, rng)
    if n_samples > 1:  # remove the chance correlation of few draws, which all vertices would share
        field -= shared * (shared[:, 0] @ field / n_samples)
    field /= np.sqrt(np.mean(field**2, axis=0))
    moved_m = own_m * field + common_m * shared
    return SurfaceSamples(known, moved_m.astype(np.float32), common_m)


def unit_errors(points: Floats, n_samples: int, rng: np.random.Generator) -> Floats:
    """Draw errors at points of a surface, in standard deviations, (n_samples, n).

    points: (n, 3) [m].
    """
    common = rng.standard_normal((n_samples, 1))
    single = smooth_noise(points, n_samples, rng)
    return np.asarray(np.sqrt(COMMON_SHARE) * common + np.sqrt(1.0 - COMMON_SHARE) * single)


def smooth_noise(points: Floats, n_samples: int, rng: np.random.Generator) -> Floats:
    """Draw Gaussian fields with the correlation exp(-r^2 / (2 l^2)) at points, (n_samples, n).

    points: (n, 3) [m]. l is `CORRELATION_M`. The variance is one, up to the interpolation of a grid
    of two cells to l.
    """
    low, sides = points.min(axis=0), np.ptp(points, axis=0)
    cell = max(0.5 * CORRELATION_M, float(sides.max()) / _MAX_CELLS)
    width = CORRELATION_M / (np.sqrt(2.0) * cell)
    # The filter wraps, so that the variance is the same everywhere: the sides must lie far apart.
    shape = np.ceil((sides + 4.0 * CORRELATION_M) / cell).astype(int) + 2
    index = ((points - low) / cell).T
    # White noise under a Gaussian of this width has the variance of the Gaussian's square.
    scale = (2.0 * np.sqrt(np.pi) * width) ** 1.5
    return np.stack(
        [
            scale
            * map_coordinates(
                gaussian_filter(rng.standard_normal(shape), width, mode="wrap"), index, order=1
            )
            for _ in range(n_samples)
        ]
    )


def _spread_draws(n: int, rng: np.random.Generator) -> Floats:
    """Draw n quantiles of a normal distribution in random order: mean 0, mean square 1, (n,)."""
    draws = ndtri((np.arange(n) + 0.5) / n)
    scale = float(np.sqrt(np.mean(draws**2))) if n > 1 else 1.0
    return rng.permutation(draws / scale) if n > 1 else rng.standard_normal(1)
