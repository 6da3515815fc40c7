"""Likelihood of the true labels of peaks, and the constants of `labels` and `noise` that raise it.

    python bench/python/label_constants.py RUN=SCENE... [--fit] [--steps N]

Each `RUN` is a folder of `geraf2 reconstruct` with the preset fast or best, each `SCENE` the scene
with its truth. Without `--fit` the mean log loss of each scene is printed. With it the constants
are fitted to all scenes by L-BFGS on their logarithms, with differences as gradients, and printed.

A candidate is true within 3 mm of the surface and 30 degrees of a normal within 5.5 mm: at an edge
any of its normals. One beyond 8 mm is false and counts three times, since it makes a surface
elsewhere. One within 3 mm with another normal is false and counts 0.3; others do not count.
"""

import argparse
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
from scipy.optimize import minimize
from scipy.spatial import KDTree

from geraf2.echoes import labels
from geraf2.echoes.glints import candidates_around
from geraf2.echoes.hypotheses import Candidates
from geraf2.geometry.triangles import split_triangles, unit_normals
from geraf2.imaging.peaks import PeakSet, collect_peaks
from geraf2.io.container import TRUTH_NAME
from geraf2.io.mesh import read_mesh
from geraf2.io.run_folder import CONFIG_NAME, PRIOR_NAME, RunFolder
from geraf2.pipeline.prior import read_prior
from geraf2.pipeline.run_record import RunRecord
from geraf2.pipeline.stages.calibration import correct_capture
from geraf2.pipeline.stages.job import for_planes
from geraf2.scene import load_capture

NOISE = ("bend_per_m2", "curvature_per_m")
"""Of `EchoNoise`."""
CONSTANTS = (
    "_PEAK_M",
    "_TURN_RAD",
    "_SPREAD_M",
    "_ALONE",
    "_OTHER_SCALE",
    "_OTHER_POWER",
    "_SHARED",
    "_FLOOR",
    "_LOG_ODDS",
    "_PER_STRENGTH_DB",
    "_PER_MARGIN_DB",
)
NEAR_M, EDGE_M, FAR_M = 0.003, 0.0055, 0.008
MIN_COSINE = np.cos(np.deg2rad(30.0))
FAR_WEIGHT, TURNED_WEIGHT = 3.0, 0.3
PIECE_M = 0.0015


@dataclass(frozen=True, kw_only=True)
class Scan:
    name: str
    peaks: PeakSet
    found: Candidates
    volume_m3: float
    inside: np.ndarray
    true: np.ndarray
    weights: np.ndarray

    def loss(self) -> float:
        """Mean log loss of its candidates in the box."""
        p = labels.posterior(self.peaks, self.found, self.volume_m3, self.inside)
        p = np.clip(p, 1e-6, 1.0 - 1e-6)
        each = -np.where(self.true, np.log(p), np.log1p(-p))
        return float(np.average(each, weights=self.weights))


def truth_of(found: Candidates, truth: Path) -> tuple[np.ndarray, np.ndarray]:
    """Whether each candidate is true, and its weight, (n,) each."""
    pieces = split_triangles(read_mesh(truth).corners, PIECE_M)
    middles, normals = pieces.mean(axis=1), unit_normals(pieces)
    tree = KDTree(middles)
    distance = tree.query(found.positions)[0]
    near = tree.query_ball_point(found.positions, EDGE_M)
    along = np.array(
        [
            (normals[some] @ normal).max(initial=-1.0)
            for some, normal in zip(near, found.normals, strict=True)
        ]
    )
    true = (distance < NEAR_M) & (along > MIN_COSINE)
    weights = np.where(true, 1.0, np.where(distance > FAR_M, FAR_WEIGHT, 0.0))
    weights[(distance < NEAR_M) & ~true] = TURNED_WEIGHT
    return true, weights


def scan_of(run: Path, scene: Path) -> Scan:
    folder = RunFolder.read(run)
    capture, prior = correct_capture(folder, load_capture(scene)), read_prior(run / PRIOR_NAME)
    config = for_planes(RunRecord.read(run / CONFIG_NAME).config, capture).glints
    peaks = collect_peaks(capture, prior, config.subaperture, config.noise_margin_db)
    peaks, found = candidates_around(capture, prior, peaks, config)
    inside = found.depth_m > config.wall_margin_m
    true, weights = truth_of(found, scene / TRUTH_NAME)
    return Scan(
        name=run.name,
        peaks=peaks,
        found=found,
        volume_m3=prior.expected_volume_m3,
        inside=inside,
        true=true,
        weights=weights * inside,
    )


def now() -> dict[str, float]:
    """Constants as they are."""
    noise = {name: getattr(labels.ECHO_NOISE, name) for name in NOISE}
    return noise | {name: getattr(labels, name) for name in CONSTANTS}


def instead(values: dict[str, float]) -> AbstractContextManager[object]:
    """Labels with other constants."""
    noise = replace(labels.ECHO_NOISE, **{name: values[name] for name in NOISE})
    rest = {name: values[name] for name in CONSTANTS}
    return patch.multiple(labels, ECHO_NOISE=noise, **rest)


def fitted(scans: list[Scan], n_steps: int) -> dict[str, float]:
    """Constants with the least mean loss; each scene has the same weight."""
    start = np.array(list(now().values()))

    def cost(changes: np.ndarray) -> float:
        with instead(dict(zip(NOISE + CONSTANTS, start * np.exp(changes), strict=True))):
            return float(np.mean([scan.loss() for scan in scans]))

    found = minimize(
        cost, np.zeros(len(start)), method="L-BFGS-B", options={"maxiter": n_steps, "eps": 1e-3}
    )
    return dict(zip(NOISE + CONSTANTS, (start * np.exp(found.x)).tolist(), strict=True))


def report(scans: list[Scan], title: str) -> None:
    losses = [scan.loss() for scan in scans]
    print(f"{title}: mean log loss {np.mean(losses):.4f}")
    for scan, loss in zip(scans, losses, strict=True):
        share = np.average(scan.true[scan.inside])
        print(
            f"  {scan.name:32} {loss:.4f}  {int(scan.inside.sum()):6d} in the box, {share:.2f} true"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("runs", nargs="+", metavar="RUN=SCENE")
    parser.add_argument("--fit", action="store_true")
    parser.add_argument("--steps", type=int, default=10)
    options = parser.parse_args()
    scans = [scan_of(*map(Path, pair.split("=", 1))) for pair in options.runs]
    report(scans, "as it is")
    if options.fit:
        found = fitted(scans, options.steps)
        for name, value in found.items():
            print(f"{name} = {value:.4g}  (was {now()[name]:.4g})")
        with instead(found):
            report(scans, "fitted")


if __name__ == "__main__":
    main()
