"""Distances between a reconstructed and a true surface, each with its definition."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from geraf2 import __version__
from geraf2._types import AnyPath, Bools, Floats, Ints
from geraf2._validation import require_positive
from geraf2.errors import UserError
from geraf2.evaluation.alignment import rigid_alignment
from geraf2.evaluation.forecast import ErrorForecast, error_forecast
from geraf2.freespace.specular import specular_visibility
from geraf2.geometry.triangles import face_areas, unit_normals
from geraf2.io.atomic import write_text_atomic
from geraf2.io.mesh import TriangleMesh
from geraf2.ops.visibility import MeshScene
from geraf2.scene.aperture import Aperture
from geraf2.surfaces.isosurface import SurfaceReport, signed_distances, surface_report

DEFAULT_THRESHOLDS_M = (0.015, 0.005, 0.003)
"""Thresholds of the F1 score [m]: the paper's 15 mm, and two stricter ones."""


@dataclass(frozen=True, kw_only=True)
class ThresholdScore:
    """Share of samples that match within one distance."""

    threshold_m: float
    """Distance tau [m]."""
    precision: float
    """Share of the mesh's samples nearer than tau to a sample of the truth."""
    recall: float
    """Share of the truth's samples nearer than tau to a sample of the mesh."""
    f1: float
    """Harmonic mean 2 P R / (P + R); 0 if both are 0."""


@dataclass(frozen=True, kw_only=True)
class DistanceSummary:
    """Order statistics of unsigned distances."""

    median_m: float
    """Half of the distances are smaller [m]."""
    p95_m: float
    """95 % of the distances are smaller [m]."""
    mean_m: float
    """Mean [m]."""
    max_m: float
    """Largest [m]."""


@dataclass(frozen=True, kw_only=True)
class SightScore:
    """Scores of the part of the truth that the scan could see, or of the rest."""

    part: str
    """`in sight` or `out of sight`."""
    area_fraction: float
    """Share of the truth's area."""
    scores: tuple[ThresholdScore, ...]
    """F1, precision and recall of the part per threshold; all 0 where it has no samples."""
    surface_truth_to_mesh: DistanceSummary | None
    """Exact distances of the part's samples to the mesh; None where it has none."""


@dataclass(frozen=True, kw_only=True)
class MeshMetrics:
    """Distances between a mesh and the truth; definitions in :meth:`describe`."""

    chamfer_1e3_m2: float
    """Chamfer distance [1e-3 m^2]."""
    scores: tuple[ThresholdScore, ...]
    """F1, precision and recall per threshold."""
    mesh_to_truth: DistanceSummary
    """Sample to nearest sample, from the mesh."""
    truth_to_mesh: DistanceSummary
    """Sample to nearest sample, from the truth."""
    both_ways: DistanceSummary
    """The two sets of distances together."""
    surface_mesh_to_truth: DistanceSummary
    """Exact point-to-surface distances of the mesh's samples."""
    surface_truth_to_mesh: DistanceSummary
    """Exact point-to-surface distances of the truth's samples."""
    surface_bias_m: float | None
    """Median signed distance of the mesh's samples, positive outside; None: open truth [m]."""
    floor_chamfer_1e3_m2: float
    """Chamfer distance of the truth against another sample of itself [1e-3 m^2]."""
    floor_median_m: float
    """Median of both nearest distances of the truth against another sample of itself [m]."""
    expected_error: ErrorForecast | None
    """Expected against true errors of the mesh; None where it has none."""
    expected_error_aligned: ErrorForecast | None
    """The same after a rigid motion onto the truth: without errors of the frame."""
    by_sight: tuple[SightScore, ...]
    """Scores of the parts in sight and out of sight; empty where no scan was given."""
    mesh: SurfaceReport
    """The mesh as a surface."""
    truth: SurfaceReport
    """The truth as a surface."""
    n_samples: int
    """Samples of each surface."""
    seed: int
    """Seed of the samples."""

    def f1(self, threshold_m: float) -> float:
        """F1 score at one of the thresholds [m]."""
        for score in self.scores:
            if abs(score.threshold_m - threshold_m) <= 1e-9:
                return score.f1
        have = ", ".join(f"{score.threshold_m:g}" for score in self.scores)
        msg = f"threshold_m must be one of {have}, got {threshold_m!r}"
        raise ValueError(msg)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers for JSON, with their definitions."""
        return {**asdict(self), "definitions": describe(self.n_samples, self.seed)}

    def describe(self) -> dict[str, str]:
        """Definition of each number, as text."""
        return describe(self.n_samples, self.seed)


def describe(n_samples: int = 10000, seed: int = 0) -> dict[str, str]:
    """Definition of each metric as text, printed wherever the numbers are."""
    return {
        "samples": (
            f"{n_samples} points drawn uniformly by area from each surface (seed {seed}); "
            "S from the mesh, T from the truth; no alignment, scaling or cropping is applied"
        ),
        "nearest distance": "d(s) = min over t in T of |s - t|, d(t) = min over s in S of |t - s|",
        "chamfer_1e3_m2": "mean over S of d(s)^2 + mean over T of d(t)^2, in 1e-3 m^2",
        "precision": "share of s with d(s) < tau",
        "recall": "share of t with d(t) < tau",
        "f1": "2 precision recall / (precision + recall)",
        "mesh_to_truth, truth_to_mesh, both_ways": (
            "median, 95th percentile, mean and largest of d(s), of d(t), of both together"
        ),
        "surface_mesh_to_truth, surface_truth_to_mesh": (
            "the same of the exact distance from each sample to the nearest point of the other "
            "surface's triangles, free of the spacing of samples"
        ),
        "surface_bias_m": (
            "median signed exact distance of the mesh's samples, positive outside the truth"
        ),
        "floor_chamfer_1e3_m2, floor_median_m": (
            "the truth against a second sample of itself: the best that sampled points can show"
        ),
        "expected_error": (
            "of samples of the mesh with an expected error: share whose exact distance to the "
            "truth is not larger (within_one), not larger than twice it (within_two), Spearman's "
            "rank correlation of both; over all and by what the vertices rest on"
        ),
        "expected_error_aligned": (
            "the same after the rigid motion that brings the mesh's samples nearest to the truth "
            "(point to plane, samples beyond 3 times the median distance left out)"
        ),
        "by_sight": (
            "scores of two parts: in sight are samples of the truth whose normal, prolonged, meets "
            "a plane of antennas and nothing of the truth before; a sample of the mesh counts to "
            "the part of its nearest sample of the truth"
        ),
    }


def evaluate_mesh(
    mesh: TriangleMesh,
    truth: TriangleMesh,
    *,
    n_samples: int = 10000,
    seed: int = 0,
    thresholds_m: Sequence[float] = DEFAULT_THRESHOLDS_M,
    planes: Sequence[Aperture] = (),
    num_threads: int | None = None,
) -> MeshMetrics:
    """Distances between a mesh and the truth, without alignment, scaling or cropping.

    mesh: reconstructed surface, in the truth's frame.
    truth: true surface.
    n_samples: points drawn uniformly by area from each surface.
    seed: seed of the two independent draws.
    thresholds_m: thresholds of the F1 score [m].
    planes: of the scan; the parts of the truth in and out of their sight are scored separately.
    num_threads: threads of the exact distances; all cores when None.

    Returns all distances; definitions by `describe()`.
    """
    _require_comparable(mesh, truth, n_samples, thresholds_m)
    # Independent streams: with one stream for both, a surface against itself would give 0.
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3)]
    on_mesh, mesh_faces, weights = _sample(mesh, n_samples, streams[0])
    on_truth, truth_faces, _ = _sample(truth, n_samples, streams[1])
    again_on_truth = _sample(truth, n_samples, streams[2])[0]

    to_truth, nearest_on_truth = KDTree(on_truth).query(on_mesh)
    to_mesh = _nearest(on_truth, on_mesh)
    floor = np.stack([_nearest(again_on_truth, on_truth), _nearest(on_truth, again_on_truth)])
    exact_to_truth = signed_distances(truth, on_mesh, num_threads=num_threads)
    exact_to_mesh = np.abs(signed_distances(mesh, on_truth, num_threads=num_threads))
    truth_report = surface_report(truth)
    aligned = _aligned_forecast(
        mesh, (on_mesh, mesh_faces, weights), truth, (on_truth, truth_faces), num_threads
    )
    seen = np.zeros(0, dtype=bool)
    if planes:
        normals = unit_normals(truth.corners)[truth_faces]
        blocker = MeshScene(truth.vertices, truth.faces, num_threads=num_threads)
        margins = specular_visibility(on_truth, normals, planes, blocker)
        seen = np.asarray((margins >= 0.0).any(axis=1))
    return MeshMetrics(
        chamfer_1e3_m2=chamfer_1e3_m2(to_truth, to_mesh),
        scores=tuple(threshold_score(to_truth, to_mesh, tau) for tau in thresholds_m),
        mesh_to_truth=_summary(to_truth),
        truth_to_mesh=_summary(to_mesh),
        both_ways=_summary(np.concatenate([to_truth, to_mesh])),
        surface_mesh_to_truth=_summary(np.abs(exact_to_truth)),
        surface_truth_to_mesh=_summary(exact_to_mesh),
        surface_bias_m=float(np.median(exact_to_truth)) if truth_report.is_watertight else None,
        floor_chamfer_1e3_m2=chamfer_1e3_m2(floor[0], floor[1]),
        floor_median_m=float(np.median(floor)),
        expected_error=error_forecast(mesh, mesh_faces, weights, np.abs(exact_to_truth)),
        expected_error_aligned=aligned,
        by_sight=tuple(
            _sight_score(
                name,
                part,
                to_truth[part[nearest_on_truth]],
                to_mesh[part],
                exact_to_mesh[part],
                thresholds_m,
            )
            for name, part in (("in sight", seen), ("out of sight", ~seen))
            if planes
        ),
        mesh=surface_report(mesh),
        truth=truth_report,
        n_samples=n_samples,
        seed=seed,
    )


def _aligned_forecast(
    mesh: TriangleMesh,
    on_mesh: tuple[Floats, Ints, Floats],
    truth: TriangleMesh,
    on_truth: tuple[Floats, Ints],
    num_threads: int | None,
) -> ErrorForecast | None:
    if mesh.expected_error_m is None:
        return None
    (points, faces, weights), (true_points, true_faces) = on_mesh, on_truth
    normals = unit_normals(truth.corners)[true_faces]
    moved = rigid_alignment(points, true_points, normals).apply(points)
    exact = np.abs(signed_distances(truth, moved, num_threads=num_threads))
    return error_forecast(mesh, faces, weights, exact)


def _require_comparable(
    mesh: TriangleMesh, truth: TriangleMesh, n_samples: int, thresholds_m: Sequence[float]
) -> None:
    if n_samples < 1:
        msg = f"n_samples must be at least 1, got {n_samples}"
        raise ValueError(msg)
    for threshold in thresholds_m:
        require_positive("thresholds_m", threshold)
    for name, surface in (("mesh", mesh), ("truth", truth)):
        if surface.faces.shape[0] == 0 or not face_areas(surface.corners).sum() > 0:
            raise UserError(
                what=f"the {name} has no surface to compare",
                expected="at least one triangle with area",
            )


def sample_surface(mesh: TriangleMesh, n_samples: int, rng: np.random.Generator) -> Floats:
    """Points drawn independently and uniformly by area, (n_samples, 3) [m].

    Triangle by area, then barycentric weights (1 - sqrt(u), sqrt(u) (1 - v), sqrt(u) v).
    """
    return _sample(mesh, n_samples, rng)[0]


def chamfer_1e3_m2(to_truth: Floats, to_mesh: Floats) -> float:
    """Chamfer distance: sum of the mean squared nearest distances of both directions [1e-3 m^2]."""
    return 1e3 * float(np.mean(to_truth**2) + np.mean(to_mesh**2))


def threshold_score(to_truth: Floats, to_mesh: Floats, threshold_m: float) -> ThresholdScore:
    """Precision, recall and F1 of nearest distances [m] at one threshold [m]."""
    precision = float(np.mean(to_truth < threshold_m))
    recall = float(np.mean(to_mesh < threshold_m))
    total = precision + recall
    f1 = 2.0 * precision * recall / total if total > 0 else 0.0
    return ThresholdScore(threshold_m=threshold_m, precision=precision, recall=recall, f1=f1)


def write_metrics(
    metrics: MeshMetrics, path: AnyPath, *, extra: dict[str, Any] | None = None
) -> None:
    """Write metrics.json: numbers in SI units (Chamfer as named), definitions, version, extras."""
    document = {
        "format": "geraf2-metrics",
        "format_version": 1,
        "generator": f"geraf2 {__version__}",
        **metrics.to_dict(),
        **(extra or {}),
    }
    write_text_atomic(path, json.dumps(document, indent=2, allow_nan=False) + "\n")


def _sample(
    mesh: TriangleMesh, n_samples: int, rng: np.random.Generator
) -> tuple[Floats, Ints, Floats]:
    """Points, the faces that they lie on, and the weights of these faces' corners."""
    cumulative = np.cumsum(face_areas(mesh.corners))
    face = np.searchsorted(cumulative, rng.random(n_samples) * cumulative[-1], side="right")
    face = np.minimum(face, len(cumulative) - 1)
    root = np.sqrt(rng.random(n_samples))
    v = rng.random(n_samples)
    weights = np.stack([1.0 - root, root * (1.0 - v), root * v], axis=1)
    points = np.einsum("nk,nkd->nd", weights, mesh.vertices[mesh.faces[face]])
    return points, face, weights


def _nearest(points: Floats, others: Floats) -> Floats:
    return np.asarray(KDTree(others).query(points)[0], dtype=np.float64)


def _summary(distances: Floats) -> DistanceSummary:
    return DistanceSummary(
        median_m=float(np.median(distances)),
        p95_m=float(np.quantile(distances, 0.95)),
        mean_m=float(distances.mean()),
        max_m=float(distances.max()),
    )


def _sight_score(
    part: str,
    of_truth: Bools,
    to_truth: Floats,
    to_mesh: Floats,
    exact_to_mesh: Floats,
    thresholds_m: Sequence[float],
) -> SightScore:
    """Scores of one part; `of_truth` marks its samples of the truth."""
    # Without a sample nothing matches.
    to_truth, to_mesh = (d if d.size else np.array([np.inf]) for d in (to_truth, to_mesh))
    return SightScore(
        part=part,
        area_fraction=float(of_truth.mean()),
        scores=tuple(threshold_score(to_truth, to_mesh, tau) for tau in thresholds_m),
        surface_truth_to_mesh=_summary(exact_to_mesh) if exact_to_mesh.size else None,
    )
