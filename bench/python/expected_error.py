"""Fit and check of the expected error on runs whose truth is known.

    python bench/python/expected_error.py RUN=TRUTH... [--fit]

Each `RUN` is a folder of `geraf2 reconstruct`, each `TRUTH` a mesh in metres. Without `--fit` the
factor of the package is checked: per run, the share of the area within one and two standard
deviations, and the rank correlation with the true error. With `--fit` full support and exponent of
`SupportModel` are fitted first: by maximum likelihood under Student's t distribution of four
degrees of freedom, which outliers do not rule, then scaled so that the shares of the area within
one and two standard deviations differ least (sum of squares) from those of a normal distribution.
Every run has the same weight, every vertex that of its area.
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

import geraf2
from geraf2.evaluation.forecast import rank_correlation
from geraf2.fields import SdfGrid
from geraf2.geometry.triangles import vertex_areas
from geraf2.io.mesh import read_mesh
from geraf2.pipeline.posterior import evidence_of_run
from geraf2.surfaces.expected_error import SupportModel, VertexSpread, nearness
from geraf2.surfaces.isosurface import signed_distances
from geraf2.surfaces.posterior import draw_errors

DEGREES_OF_FREEDOM = 4.0
# Shares of a normal distribution within one and two standard deviations.
WANTED = np.array([0.683, 0.954])
START = np.array([np.log(10.0), 0.4])


@dataclass(frozen=True, kw_only=True)
class Sample:
    name: str
    spread: VertexSpread
    error_m: np.ndarray
    weights: np.ndarray
    """Shares of the area."""

    def expected_m(self, model: SupportModel) -> np.ndarray:
        return self.spread.expected_error_m(model)

    def within(self, model: SupportModel) -> np.ndarray:
        """Shares of the area within one and two standard deviations."""
        ratio = self.error_m / self.expected_m(model)
        return np.array([self.weights[ratio <= n].sum() for n in (1.0, 2.0)])


def sample(run: Path, truth: Path) -> Sample:
    result, true = geraf2.load_run(run), read_mesh(truth)
    mesh = result.content_mesh
    evidence, fit, field = evidence_of_run(result.run, result.record.config)
    near, sdf = nearness(mesh, evidence.seen, weights=evidence.weights), SdfGrid.load(run / field)
    areas = vertex_areas(mesh.vertices, mesh.faces)
    return Sample(
        name=run.name,
        spread=draw_errors(mesh, near, sdf, evidence, result.prior, fit)[1],
        error_m=np.abs(signed_distances(true, mesh.vertices)),
        weights=areas / areas.sum(),
    )


def model_of(values: np.ndarray) -> SupportModel:
    return replace(SupportModel(), full=float(np.exp(values[0])), exponent=float(values[1]))


def fitted(samples: list[Sample]) -> SupportModel:
    def cost(values: np.ndarray) -> float:
        total = 0.0
        for s in samples:
            sigma = s.expected_m(model_of(values))
            square = (s.error_m / sigma) ** 2 / DEGREES_OF_FREEDOM
            each = np.log(sigma) + 0.5 * (DEGREES_OF_FREEDOM + 1.0) * np.log1p(square)
            total += float(s.weights @ each)
        return total / len(samples)

    bounds = [(-3.0, 8.0), (0.02, 2.0)]
    found = minimize(cost, START, method="L-BFGS-B", bounds=bounds, options={"eps": 1e-3}).x
    model = model_of(found)
    scaled = [
        replace(model, full=float(model.full * scale ** (1.0 / model.exponent)))
        for scale in np.geomspace(0.5, 3.0, 91)
    ]

    def off(model: SupportModel) -> float:
        within = np.mean([s.within(model) for s in samples], axis=0)
        return float(((within - WANTED) ** 2).sum())

    return min(scaled, key=off)


def check(samples: list[Sample], model: SupportModel) -> np.ndarray:
    rows = []
    for s in samples:
        expected = s.expected_m(model)
        # Draws with the areas' weights, so that ranks are those of the area.
        drawn = np.random.default_rng(0).choice(len(expected), 10000, p=s.weights)
        rows.append(
            (
                *s.within(model),
                rank_correlation(expected[drawn], s.error_m[drawn]),
                1e3 * np.median(expected[drawn]),
                1e3 * np.median(s.error_m[drawn]),
            )
        )
        print("{:40s} {:.2f} {:.2f} {:.2f}  {:5.2f} {:5.2f}".format(s.name[:40], *rows[-1]))
    return np.array(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", metavar="RUN=TRUTH")
    parser.add_argument("--fit", action="store_true")
    arguments = parser.parse_args()
    pairs = [tuple(map(Path, pair.split("=", 1))) for pair in arguments.runs]
    samples = [sample(run, truth) for run, truth in pairs]
    model = SupportModel()
    if arguments.fit:
        model = fitted(samples)
        print(f"fitted: full {model.full:.3g}, exponent {model.exponent:.3g}")
    print(f"{'run':40s} one  two  rank  expected, true median [mm]")
    table = check(samples, model)
    print(
        "mean of {} runs: {:.3f} within one, {:.3f} within two, rank {:.3f}".format(
            len(table), *table[:, :3].mean(axis=0)
        )
    )


if __name__ == "__main__":
    main()
