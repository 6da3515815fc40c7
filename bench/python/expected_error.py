"""Fit and check of the expected error on runs whose truth is known.

    python bench/python/expected_error.py RUN=TRUTH... [--fit]

Each `RUN` is a folder of `geraf2 reconstruct`, each `TRUTH` a mesh in metres. Without `--fit` the
coefficients of the package are checked: per run, the share of the area within one and two standard
deviations, and the rank correlation with the true error. With `--fit` the three coefficients of
`ErrorModel` are fitted first, each figure (the truth's folder) checked by those of the others: by
maximum likelihood under Student's t distribution of four degrees of freedom, which outliers do not
rule, then scaled so that the shares of the area within one and two standard deviations differ least
(sum of squares) from 0.683 and 0.954, those of a normal distribution. Every run has the
same weight, every vertex that of its area.
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from geraf2.echoes import Glints
from geraf2.evaluation.forecast import rank_correlation
from geraf2.fields import SdfGrid
from geraf2.geometry.triangles import vertex_areas
from geraf2.io.mesh import read_mesh
from geraf2.io.run_folder import CONTENT_NAME, GLINTS_NAME, KEPT_NAME, RIM_NAME, SDF_NAME
from geraf2.surfaces.expected_error import ErrorModel, Nearness, expected_error_m, nearness
from geraf2.surfaces.isosurface import signed_distances

DEGREES_OF_FREEDOM = 4.0
COEFFICIENTS = ("overall", "spread_m", "reach_m")


@dataclass(frozen=True, kw_only=True)
class Sample:
    name: str
    figure: str
    near: Nearness
    spacing_m: float
    error_m: np.ndarray
    weights: np.ndarray
    """Shares of the area."""

    def terms(self) -> np.ndarray:
        """Squares whose sum is the variance, times a coefficient each, (n_vertices, 3) [m^2]."""
        near = self.near
        overall = np.full(len(near.reach_m), near.misfit_overall_m)
        parts = (overall, near.misfit_m * near.spread_m, near.misfit_m * near.reach_m)
        return (self.spacing_m / ErrorModel().spacing_m * np.stack(parts, axis=1)) ** 2


def sample(run: Path, truth: Path) -> Sample:
    mesh, true = read_mesh(run / CONTENT_NAME), read_mesh(truth)
    glints = Glints.load(run / GLINTS_NAME)
    if (run / KEPT_NAME).is_file():
        glints = Glints.load(run / KEPT_NAME).join(Glints.load(run / RIM_NAME))
    areas = vertex_areas(mesh.vertices, mesh.faces)
    return Sample(
        name=run.name,
        figure=truth.parent.name,
        near=nearness(mesh, glints),
        spacing_m=SdfGrid.load(run / SDF_NAME).grid.spacing_m,
        error_m=np.abs(signed_distances(true, mesh.vertices)),
        weights=areas / areas.sum(),
    )


def fitted(samples: list[Sample]) -> ErrorModel:
    terms = np.concatenate([s.terms() for s in samples])
    scale = terms.mean(axis=0)
    error = np.concatenate([s.error_m for s in samples])
    weights = np.concatenate([s.weights for s in samples]) / len(samples)
    freedom = DEGREES_OF_FREEDOM

    def cost(logarithms: np.ndarray) -> tuple[float, np.ndarray]:
        factors = np.exp(2.0 * logarithms)
        variance = (terms / scale) @ factors * 1e-6
        square = error**2 / variance
        value = 0.5 * np.log(variance) + 0.5 * (freedom + 1.0) * np.log1p(square / freedom)
        slope = 0.5 - 0.5 * (freedom + 1.0) * square / (freedom + square)
        return float(weights @ value), 2e-6 * factors * (
            (weights * slope / variance) @ (terms / scale)
        )

    found = minimize(cost, np.full(3, -0.5), jac=True, method="L-BFGS-B", bounds=[(-8, 3)] * 3)
    factors = 1e-3 * np.exp(found.x) / np.sqrt(scale)
    model = model_of(factors)
    ratio = np.concatenate(
        [s.error_m / expected_error_m(s.near, s.spacing_m, model) for s in samples]
    )
    order = np.argsort(ratio)
    below = np.cumsum(weights[order])
    scales = np.geomspace(0.5, 3.0, 181)
    ratios = ratio[order]
    within = np.stack([np.interp(n * scales, ratios, below / below[-1]) for n in (1.0, 2.0)])
    off = (within[0] - 0.683) ** 2 + (within[1] - 0.954) ** 2
    return model_of(factors * scales[off.argmin()])


def model_of(factors: np.ndarray) -> ErrorModel:
    return replace(
        ErrorModel(), overall=factors[0], spread_m=1.0 / factors[1], reach_m=1.0 / factors[2]
    )


def check(samples: list[Sample], model: ErrorModel) -> np.ndarray:
    rows = []
    for s in samples:
        expected = expected_error_m(s.near, s.spacing_m, model)
        # Draws with the areas' weights, so that ranks are those of the area.
        drawn = np.random.default_rng(0).choice(len(expected), 10000, p=s.weights)
        rows.append(
            (
                s.weights[s.error_m <= expected].sum(),
                s.weights[s.error_m <= 2.0 * expected].sum(),
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
    print(f"{'run':40s} one  two  rank  expected, true median [mm]")
    if arguments.fit:
        rows = []
        for figure in sorted({s.figure for s in samples}):
            others = fitted([s for s in samples if s.figure != figure])
            rows.append(check([s for s in samples if s.figure == figure], others))
        table = np.concatenate(rows)
        model = fitted(samples)
        print("fitted:", {name: float(f"{getattr(model, name):.3g}") for name in COEFFICIENTS})
    else:
        table = check(samples, ErrorModel())
    in_band = (
        ((table[:, 0] >= 0.60) & (table[:, 0] <= 0.76)).sum(),
        ((table[:, 1] >= 0.90) & (table[:, 1] <= 0.97)).sum(),
    )
    print(
        "mean of {} runs: {:.3f} within one, {:.3f} within two, rank {:.3f}; runs with 0.60 to "
        "0.76 within one: {}, with 0.90 to 0.97 within two: {}".format(
            len(table), *table[:, :3].mean(axis=0), *in_band
        )
    )


if __name__ == "__main__":
    main()
