"""Fit and check of the expected error on runs whose truth is known.

    python bench/python/expected_error.py RUN=TRUTH... [--fit]

Each `RUN` is a folder of `geraf2 reconstruct`, each `TRUTH` a mesh in metres. Without `--fit` the
factor of the package is checked: per run, the share of the area within one and two standard
deviations, and the rank correlation with the true error. With `--fit` full support and exponent of
`SupportModel` are fitted first: by maximum likelihood under Student's t distribution of four
degrees of freedom, which outliers do not rule, then scaled so that the shares of the area within
one and two standard deviations differ least (sum of squares) from 0.683 and 0.954, those of a
normal distribution. Every run has the same weight, every vertex that of its area.
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from geraf2.echoes import Glints
from geraf2.evaluation.forecast import rank_correlation
from geraf2.geometry.triangles import vertex_areas
from geraf2.io.mesh import read_mesh
from geraf2.io.run_folder import CONTENT_NAME, GLINTS_NAME, RIM_NAME
from geraf2.surfaces.expected_error import SupportModel, conformal_factor, nearness
from geraf2.surfaces.isosurface import signed_distances

DEGREES_OF_FREEDOM = 4.0
START = np.array([np.log(10.0), 0.4])


@dataclass(frozen=True, kw_only=True)
class Sample:
    name: str
    spread_m: np.ndarray
    """Of the posterior, without its factor."""
    support: np.ndarray
    error_m: np.ndarray
    weights: np.ndarray
    """Shares of the area."""

    def expected_m(self, model: SupportModel) -> np.ndarray:
        return self.spread_m * conformal_factor(self.support, model)


def sample(run: Path, truth: Path) -> Sample:
    mesh, true = read_mesh(run / CONTENT_NAME), read_mesh(truth)
    glints = Glints.load(run / GLINTS_NAME)
    if (run / RIM_NAME).is_file():
        glints = Glints.load(run / GLINTS_NAME).join(Glints.load(run / RIM_NAME))
    areas = vertex_areas(mesh.vertices, mesh.faces)
    support = nearness(mesh, glints).support
    return Sample(
        name=run.name,
        spread_m=mesh.expected_error_m / conformal_factor(support),
        support=support,
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
    scales = np.geomspace(0.5, 3.0, 181)
    within = np.zeros((2, len(scales)))
    for s in samples:
        ratio = s.error_m / s.expected_m(model)
        order = np.argsort(ratio)
        below = np.cumsum(s.weights[order])
        for n in (1, 2):
            within[n - 1] += np.interp(n * scales, ratio[order], below) / len(samples)
    off = (within[0] - 0.683) ** 2 + (within[1] - 0.954) ** 2
    full = model.full * scales[off.argmin()] ** (1.0 / model.exponent)
    return replace(model, full=float(full))


def check(samples: list[Sample], model: SupportModel) -> np.ndarray:
    rows = []
    for s in samples:
        expected = s.expected_m(model)
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
