"""Distances between a reconstructed and a true surface; the page on evaluation defines each."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from geraf2 import __version__
from geraf2._short import Short
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

DEFAULT_THRESHOLDS_M = (0.015, 0.005, 0.003, 0.002)
"""Thresholds of the F1 score [m]: the paper's 15 mm, and three stricter ones."""
Distances = tuple[Floats, Floats]
"""From the mesh to the truth, and back."""
FINE_THRESHOLD_M = 0.002
"""Largest threshold that needs dense samples [m]."""
FINE_SAMPLES = 50_000
"""Least number of samples for such a threshold: of 800 cm2 one lies on 1.6 mm2."""


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
class SizeErrors:
    """Volume and extents of the mesh against those of the truth."""

    volume_ratio: float | None
    """Volume of the mesh over that of the truth; None where one of them is open."""
    extent_errors_m: tuple[float, float, float]
    """Extents of the mesh along x, y and z less those of the truth [m]."""


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


@dataclass(frozen=True, kw_only=True, repr=False)
class MeshMetrics(Short):
    """Distances between a mesh and the truth, each defined by docs/evaluation.md."""

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
    size: SizeErrors
    """Volume and extents against the truth's."""
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

    @cached_property
    def _distances_m(self) -> list[Distances]:
        """Of the samples, and of denser ones up to FINE_THRESHOLD_M, put in by `evaluate_mesh`."""
        return []

    def __repr__(self) -> str:
        scores = ", ".join(f"F1 {1e3 * s.threshold_m:g} mm {s.f1:.3f}" for s in self.scores)
        median = 1e3 * self.both_ways.median_m
        chamfer = f"Chamfer {self.chamfer_1e3_m2:.4f} 1e-3 m^2"
        return f"MeshMetrics({scores}, {chamfer}, median {median:.2f} mm)"

    def f1(self, threshold_m: float) -> float:
        """F1 score at any threshold [m]."""
        require_positive("threshold_m", threshold_m)
        coarse, dense = self._distances_m
        distances = dense if threshold_m <= FINE_THRESHOLD_M else coarse
        return threshold_score(*distances, threshold_m).f1

    def headline(self) -> dict[str, float]:
        """Scores that tables show side by side, by name; lengths in mm, unknown ones left out."""
        scores = {f"f1_{1e3 * score.threshold_m:g}mm": score.f1 for score in self.scores}
        scores["chamfer_1e3_m2"] = self.chamfer_1e3_m2
        if self.size.volume_ratio is not None:
            scores["volume_ratio"] = self.size.volume_ratio
        errors = zip("xyz", self.size.extent_errors_m, strict=True)
        scores |= {f"extent_{axis}_mm": 1e3 * error for axis, error in errors}
        if self.surface_bias_m is not None:
            scores["offset_mm"] = 1e3 * self.surface_bias_m
        return scores

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers for JSON."""
        return asdict(self)


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
    n_samples: points drawn uniformly by area from each surface.
    seed: seed of the two independent draws.
    thresholds_m: thresholds of the F1 score [m].
    planes: of the scan; the parts of the truth in and out of their sight are scored separately.

    Returns all distances.
    """
    _require_comparable(mesh, truth, n_samples, thresholds_m)
    # Independent streams: with one stream for both, a surface against itself would give 0.
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(5)]
    pair = fine = _draw_pair(mesh, truth, n_samples, streams[:2])
    if n_samples < FINE_SAMPLES and any(tau <= FINE_THRESHOLD_M for tau in thresholds_m):
        fine = _draw_pair(mesh, truth, FINE_SAMPLES, streams[3:], within_m=FINE_THRESHOLD_M)
    again_on_truth = _sample(truth, n_samples, streams[2])[0]
    floor = [_nearest(again_on_truth, pair.on_truth), _nearest(pair.on_truth, again_on_truth)]

    exact_to_truth = signed_distances(truth, pair.on_mesh, num_threads=num_threads)
    exact_to_mesh = np.abs(signed_distances(mesh, pair.on_truth, num_threads=num_threads))
    reports = surface_report(mesh), surface_report(truth)
    metrics = MeshMetrics(
        chamfer_1e3_m2=chamfer_1e3_m2(pair.to_truth, pair.to_mesh),
        scores=_scores(pair, fine, thresholds_m),
        mesh_to_truth=_summary(pair.to_truth),
        truth_to_mesh=_summary(pair.to_mesh),
        both_ways=_summary(np.concatenate([pair.to_truth, pair.to_mesh])),
        surface_mesh_to_truth=_summary(np.abs(exact_to_truth)),
        surface_truth_to_mesh=_summary(exact_to_mesh),
        surface_bias_m=float(np.median(exact_to_truth)) if reports[1].is_watertight else None,
        size=_size_errors(mesh, truth, reports),
        floor_chamfer_1e3_m2=chamfer_1e3_m2(floor[0], floor[1]),
        floor_median_m=float(np.median(np.stack(floor))),
        expected_error=error_forecast(mesh, pair.mesh_faces, pair.weights, np.abs(exact_to_truth)),
        expected_error_aligned=_aligned_forecast(mesh, pair, truth, num_threads),
        by_sight=_score_by_sight(
            truth, pair, fine, exact_to_mesh, thresholds_m, planes, num_threads
        ),
        mesh=reports[0],
        truth=reports[1],
        n_samples=n_samples,
        seed=seed,
    )
    metrics._distances_m.extend([(pair.to_truth, pair.to_mesh), (fine.to_truth, fine.to_mesh)])
    return metrics


@dataclass(frozen=True, kw_only=True)
class _Pair:
    """Samples of both surfaces and the distances to the nearest sample of the other one [m].

    Distances are infinite beyond the reach with which the pair was drawn.
    """

    on_mesh: Floats
    on_truth: Floats
    mesh_faces: Ints
    truth_faces: Ints
    weights: Floats
    """Of the corners of each face of the mesh, (n, 3)."""
    to_truth: Floats
    to_mesh: Floats
    nearest_on_truth: Ints
    """Sample of the truth next to each of the mesh; beyond the reach one at most twice as far."""

    def part(self, of_truth: Bools) -> tuple[Floats, Floats]:
        """Distances of the part with these samples of the truth; infinite where it has none."""
        parts = self.to_truth[of_truth[self.nearest_on_truth]], self.to_mesh[of_truth]
        to_truth, to_mesh = (d if d.size else np.array([np.inf]) for d in parts)
        return to_truth, to_mesh


def _draw_pair(
    mesh: TriangleMesh,
    truth: TriangleMesh,
    n: int,
    streams: Sequence[np.random.Generator],
    within_m: float = np.inf,
) -> _Pair:
    on_mesh, mesh_faces, weights = _sample(mesh, n, streams[0])
    on_truth, truth_faces, _ = _sample(truth, n, streams[1])
    tree = KDTree(on_truth)
    # The search for a far sample among dense ones visits most of them: the reach bounds it.
    to_truth, nearest_on_truth = tree.query(on_mesh, distance_upper_bound=within_m)
    far = ~np.isfinite(to_truth)
    nearest_on_truth[far] = tree.query(on_mesh[far], eps=1.0)[1]
    return _Pair(
        on_mesh=on_mesh,
        on_truth=on_truth,
        mesh_faces=mesh_faces,
        truth_faces=truth_faces,
        weights=weights,
        to_truth=to_truth,
        to_mesh=_nearest(on_truth, on_mesh, within_m),
        nearest_on_truth=nearest_on_truth,
    )


def _scores(
    pair: _Pair, fine: _Pair, thresholds_m: Sequence[float], parts: Sequence[Bools] | None = None
) -> tuple[ThresholdScore, ...]:
    """Scores by threshold; of `parts` of the samples of the truth, of both pairs, if given."""
    everything = [np.ones(len(of.on_truth), dtype=bool) for of in (pair, fine)]
    coarse, dense = (
        of.part(which) for of, which in zip((pair, fine), parts or everything, strict=True)
    )
    return tuple(
        threshold_score(*(dense if tau <= FINE_THRESHOLD_M else coarse), tau)
        for tau in thresholds_m
    )


def _size_errors(
    mesh: TriangleMesh, truth: TriangleMesh, reports: tuple[SurfaceReport, SurfaceReport]
) -> SizeErrors:
    volume, true_volume = (report.volume_m3 for report in reports)
    x, y, z = (
        float(np.ptp(a) - np.ptp(b))
        for a, b in zip(*(s.corners.reshape(-1, 3).T for s in (mesh, truth)), strict=True)
    )
    return SizeErrors(
        volume_ratio=volume / true_volume if volume is not None and true_volume else None,
        extent_errors_m=(x, y, z),
    )


def _aligned_forecast(
    mesh: TriangleMesh, pair: _Pair, truth: TriangleMesh, num_threads: int | None
) -> ErrorForecast | None:
    if mesh.expected_error_m is None:
        return None
    normals = unit_normals(truth.corners)[pair.truth_faces]
    moved = rigid_alignment(pair.on_mesh, pair.on_truth, normals).apply(pair.on_mesh)
    exact = np.abs(signed_distances(truth, moved, num_threads=num_threads))
    return error_forecast(mesh, pair.mesh_faces, pair.weights, exact)


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
    """Write metrics.json: numbers in SI units (Chamfer as named), version, extras."""
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


def _nearest(points: Floats, others: Floats, within_m: float = np.inf) -> Floats:
    distances, _ = KDTree(others).query(points, distance_upper_bound=within_m)
    return np.asarray(distances, dtype=np.float64)


def _summary(distances: Floats) -> DistanceSummary:
    return DistanceSummary(
        median_m=float(np.median(distances)),
        p95_m=float(np.quantile(distances, 0.95)),
        mean_m=float(distances.mean()),
        max_m=float(distances.max()),
    )


def _score_by_sight(
    truth: TriangleMesh,
    pair: _Pair,
    fine: _Pair,
    exact_to_mesh: Floats,
    thresholds_m: Sequence[float],
    planes: Sequence[Aperture],
    num_threads: int | None,
) -> tuple[SightScore, ...]:
    """Scores of the parts of the truth in sight of the planes and out of it."""
    if not planes:
        return ()
    blocker = MeshScene(truth.vertices, truth.faces, num_threads=num_threads)
    normals = unit_normals(truth.corners)

    def seen(of: _Pair) -> Bools:
        margins = specular_visibility(of.on_truth, normals[of.truth_faces], planes, blocker)
        return np.asarray((margins >= 0.0).any(axis=1))

    in_sight = seen(pair)
    of_both = in_sight, in_sight if fine is pair else seen(fine)
    scores = []
    for name, parts in (("in sight", of_both), ("out of sight", [~part for part in of_both])):
        exact = exact_to_mesh[parts[0]]
        scores.append(
            SightScore(
                part=name,
                area_fraction=float(parts[0].mean()),
                scores=_scores(pair, fine, thresholds_m, parts),
                surface_truth_to_mesh=_summary(exact) if exact.size else None,
            )
        )
    return tuple(scores)
