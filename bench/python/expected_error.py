"""Fit and check of the expected error on runs whose truth is known.

    python bench/python/expected_error.py RUN=TRUTH... [--fit]

Each `RUN` is a folder of `geraf2 reconstruct`, each `TRUTH` a mesh in metres. Without `--fit` the
slope of the package is checked: per run, the share of the area within one and two standard
deviations, and the rank correlation with the true error. With `--fit` the slope is fitted first: by
maximum likelihood under Student's t distribution of four degrees of freedom, which outliers do not
rule, then scaled so that the shares of the area within one and two standard deviations differ least
(sum of squares) from those of a normal distribution. Every run has the same weight, every vertex
that of its area. Correlation length and common share of the errors are fitted to the correlation of
errors over distance, weighted by the expected errors. `--sizes` also compares volume and
extents with the truth: how many 95 % intervals hold, and their median half width over the size.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize, minimize_scalar

import geraf2
from geraf2.evaluation.forecast import rank_correlation
from geraf2.geometry.triangles import enclosed_volume_m3, vertex_areas
from geraf2.io.mesh import TriangleMesh, read_mesh
from geraf2.pipeline.surface_samples import evidence_of_run
from geraf2.surfaces.error_field import sample_surface
from geraf2.surfaces.expected_error import SLOPE, nearness
from geraf2.surfaces.isosurface import signed_distances

DEGREES_OF_FREEDOM = 4.0
# Shares of a normal distribution within one and two standard deviations.
WANTED = np.array([0.683, 0.954])
# Distances of pairs of vertices [m], and how many pairs of a run are drawn.
APART_M, N_PAIRS = 1e-3 * np.array([0, 3, 6, 10, 15, 20, 30, 40, 60, 80, 120]), 80_000


@dataclass(frozen=True, kw_only=True)
class Sample:
    name: str
    distance_m: np.ndarray
    common_m: float
    error_m: np.ndarray
    weights: np.ndarray
    """Shares of the area."""
    vertices: np.ndarray
    sizes: np.ndarray
    """Volume and extents: found, half width of the interval, true, (3, 4)."""

    def expected_m(self, slope: float) -> np.ndarray:
        return np.hypot(slope * self.distance_m, self.common_m)

    def within(self, slope: float) -> np.ndarray:
        """Shares of the area within one and two standard deviations."""
        ratio = np.abs(self.error_m) / self.expected_m(slope)
        return np.array([self.weights[ratio <= n].sum() for n in (1.0, 2.0)])


def sizes_of(mesh: TriangleMesh) -> np.ndarray:
    volume = enclosed_volume_m3(mesh.vertices, mesh.faces)
    return np.array([volume, *np.ptp(mesh.vertices, axis=0)])


def sample(run: Path, truth: Path) -> Sample:
    result, true = geraf2.load_run(run), read_mesh(truth)
    mesh = result.content_mesh
    evidence, _ = evidence_of_run(result.run, result.record.config)
    samples = sample_surface(mesh, evidence)
    low, high = samples.interval(sizes_of)
    areas = vertex_areas(mesh.vertices, mesh.faces)
    return Sample(
        name=run.name,
        distance_m=nearness(mesh, evidence.glints).distance_m,
        common_m=evidence.common_sigma_m,
        error_m=signed_distances(true, mesh.vertices),
        vertices=mesh.vertices,
        weights=areas / areas.sum(),
        sizes=np.stack([sizes_of(mesh), 0.5 * (high - low), sizes_of(true)]),
    )


def fitted(samples: list[Sample]) -> float:
    def cost(log_slope: float) -> float:
        total = 0.0
        for s in samples:
            sigma = s.expected_m(np.exp(log_slope))
            square = (s.error_m / sigma) ** 2 / DEGREES_OF_FREEDOM
            each = np.log(sigma) + 0.5 * (DEGREES_OF_FREEDOM + 1.0) * np.log1p(square)
            total += float(s.weights @ each)
        return total / len(samples)

    likeliest = float(np.exp(minimize_scalar(cost, bounds=(-5.0, 2.0)).x))

    def off(slope: float) -> float:
        within = np.mean([s.within(slope) for s in samples], axis=0)
        return float(((within - WANTED) ** 2).sum())

    return min((likeliest * np.geomspace(0.5, 3.0, 91)).tolist(), key=off)


def together(s: Sample, slope: float) -> np.ndarray:
    """Correlation of errors of pairs of vertices, by distance."""
    rng = np.random.default_rng(0)
    i, j = rng.choice(len(s.error_m), (2, N_PAIRS), p=s.weights)
    sigma = slope * s.distance_m
    ratio = np.clip(s.error_m / sigma, -3.0, 3.0)
    apart = np.digitize(np.linalg.norm(s.vertices[i] - s.vertices[j], axis=1), APART_M) - 1
    weight, product = sigma[i] * sigma[j], ratio[i] * ratio[j]
    mean = [np.average(product[apart == k], weights=weight[apart == k]) for k in np.unique(apart)]
    found = np.full(len(APART_M), np.nan)
    found[np.unique(apart)] = mean
    return found[:-1] / np.average(ratio**2, weights=s.weights * sigma**2)


def fitted_field(samples: list[Sample], slope: float) -> tuple[float, float]:
    """Correlation length [m] and common share with the least squared error."""
    found = np.nanmean([together(s, slope) for s in samples], axis=0)
    middle = 0.5 * (APART_M[1:] + APART_M[:-1])

    def off(values: np.ndarray) -> float:
        share, length = values
        return float(
            ((share + (1 - share) * np.exp(-0.5 * (middle / length) ** 2) - found) ** 2).sum()
        )

    share, length = minimize(off, [0.2, 0.008], method="Nelder-Mead").x
    return float(length), float(share)


def check(samples: list[Sample], slope: float) -> np.ndarray:
    rows = []
    for s in samples:
        expected = s.expected_m(slope)
        # Draws with the areas' weights, so that ranks are those of the area.
        drawn = np.random.default_rng(0).choice(len(expected), 10000, p=s.weights)
        rows.append(
            (
                *s.within(slope),
                rank_correlation(expected[drawn], np.abs(s.error_m[drawn])),
                1e3 * np.median(expected[drawn]),
                1e3 * np.median(np.abs(s.error_m[drawn])),
            )
        )
        print("{:40s} {:.2f} {:.2f} {:.2f}  {:5.2f} {:5.2f}".format(s.name[:40], *rows[-1]))
    return np.array(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", metavar="RUN=TRUTH")
    parser.add_argument("--fit", action="store_true")
    parser.add_argument("--sizes", action="store_true")
    arguments = parser.parse_args()
    pairs = [tuple(map(Path, pair.split("=", 1))) for pair in arguments.runs]
    samples = [sample(run, truth) for run, truth in pairs]
    slope = SLOPE
    if arguments.fit:
        slope = fitted(samples)
        length, share = fitted_field(samples, slope)
        print(f"fitted: slope {slope:.3g}, correlation {1e3 * length:.1f} mm, share {share:.2f}")
    print(f"{'run':40s} one  two  rank  expected, true median [mm]")
    table = check(samples, slope)
    print(
        "mean of {} runs: {:.3f} within one, {:.3f} within two, rank {:.3f}".format(
            len(table), *table[:, :3].mean(axis=0)
        )
    )
    if arguments.sizes:
        found, half, true = np.stack([s.sizes for s in samples], axis=1)
        for name, part in (("volume", np.s_[:, :1]), ("extents", np.s_[:, 1:])):
            hold = np.abs(true - found)[part] <= half[part]
            width = np.median(half[part] / found[part])
            print(f"95 % intervals of {name}: {hold.sum()} of {hold.size} hold, +-{width:.1%}")


if __name__ == "__main__":
    main()
