"""Simulation of scenes and evaluation of rows, each in a process of its own."""

import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from skimage.filters import threshold_otsu

from geraf2.apps.benchmark.rows import Row, RowResult
from geraf2.baselines.heat import counted_voxels, grid_inside
from geraf2.baselines.matched_filter_surface import sum_heat, surface_above
from geraf2.evaluation import MeshMetrics, evaluate_mesh, oracle_matched_filter
from geraf2.evaluation.mesh_metrics import FINE_SAMPLES
from geraf2.geometry.triangles import enclosed_volume_m3
from geraf2.io.container import LOS_NAME, TRUTH_NAME
from geraf2.io.mesh import TriangleMesh, read_mesh
from geraf2.io.run_folder import CHECKPOINT_NAME
from geraf2.pipeline.commands.evaluate import evaluate
from geraf2.pipeline.commands.reconstruct import reconstruct
from geraf2.pipeline.commands.simulate import simulate_scene
from geraf2.pipeline.presets import MatchedFilterPreset
from geraf2.pipeline.prior import PriorSource
from geraf2.scene import LosPrior, Wall, load_capture
from geraf2.scene.store import save_capture
from geraf2.simulation import SceneSpec
from geraf2.surfaces.extraction import cropped_content

_THRESHOLDS_M = (0.005, 0.003, 0.002)
"""Of the F1 of a scene of the population [m]."""
# Thresholds of the oracle, in units of Otsu's; the method's own is among them.
_ORACLE_SCALES = (0.8, 1.0, 1.15, 1.3, 1.45, 1.6, 1.8, 2.0, 2.3, 2.6)


def make_scene(spec: SceneSpec, scene: Path, seed: int, num_threads: int | None) -> None:
    """Simulate a scene."""
    simulate_scene(spec, scene, seed=seed, num_threads=num_threads)


def copy_with_walls(true_scene: Path, scene: Path, permittivity: float | str) -> None:
    """Copy a scene with another recorded permittivity of its walls, or without walls."""
    capture = load_capture(true_scene)
    walls: tuple[Wall, ...] = ()
    if isinstance(permittivity, float):
        walls = tuple(replace(wall, permittivity=permittivity) for wall in capture.walls)

    def write_extras(folder: Path) -> None:
        for name in (TRUTH_NAME, LOS_NAME):
            shutil.copy(true_scene / name, folder / name)

    save_capture(replace(capture, walls=walls), scene, extras=write_extras)


def make_row(row: Row, scene: Path, run: Path, seed: int, num_threads: int | None) -> RowResult:
    """Make a row in its run folder and return its result; a stopped training continues."""
    is_stopped = (run / CHECKPOINT_NAME).is_file()
    if not is_stopped:
        shutil.rmtree(run, ignore_errors=True)  # remains of a failure
    if row.how.kind == "oracle":
        return _oracle(row, scene, seed, num_threads)
    result = reconstruct(
        scene,
        _prior(row, scene),
        row.config,
        run,
        options=row.how.run_options(seed),
        resume=is_stopped,
        num_threads=num_threads,
    )
    cpu_seconds = sum(numbers["cpu_seconds"] for numbers in result.numbers.values())
    if row.how.kind == "population":
        truth = read_mesh(scene / TRUTH_NAME)
        scores = population_scores(
            result.content_mesh,
            truth,
            seed,
            stated=result.numbers.get("mesh"),
            num_threads=num_threads,
        )
        return RowResult(f1_5mm=scores["f1_5mm"], cpu_seconds=cpu_seconds, scores=scores)
    metrics = evaluate(result, scene / TRUTH_NAME, report=False, num_threads=num_threads)
    expected_mm = result.numbers.get("mesh", {}).get("expected_error_median_mm")
    return replace(
        _result_of(metrics),
        expected_m=None if expected_mm is None else 1e-3 * expected_mm,
        cpu_seconds=cpu_seconds,
    )


def _prior(row: Row, scene: Path) -> PriorSource:
    if not any(row.case.prior_shift_m):
        return PriorSource(los=scene / LOS_NAME)
    wall, (dx, dy, dz) = row.spec.walls[0], row.case.prior_shift_m
    x, y, z = wall.center_m
    return PriorSource(box=wall.size_m, box_center=(x + dx, y + dy, z + dz))


def _oracle(row: Row, scene: Path, seed: int, num_threads: int | None) -> RowResult:
    """Best value of each score of the matched filter over all thresholds."""
    assert isinstance(row.config, MatchedFilterPreset)  # the suite was checked
    capture, wall, config = load_capture(scene), row.spec.walls[0], row.config.matched_filter
    prior = LosPrior.from_box(wall.size_m, wall.center_m, capture.walls)
    grid, truth = grid_inside(prior, config.spacing_m), read_mesh(scene / TRUTH_NAME)
    total = sum_heat(capture, grid, num_threads=num_threads)
    counted = counted_voxels(prior, grid, config.crop_m, num_threads=num_threads)
    otsu = float(threshold_otsu(total.heat[counted]))
    hottest = float(total.heat[counted].max())
    fields = (
        surface_above(capture, total, counted, scale * otsu, config.normal_reach_m)
        for scale in _ORACLE_SCALES
        if scale * otsu < hottest
    )
    own = (cropped_content(f, prior, config.crop_m, num_threads=num_threads) for f in fields)
    best = oracle_matched_filter(
        *(total.heat, grid, prior, truth),
        crop_m=config.crop_m,
        seed=seed,
        others=own,
        num_threads=num_threads,
    )
    return RowResult(
        f1_15mm=best.f1_15mm,
        f1_5mm=best.f1_5mm,
        f1_2mm=best.f1_2mm,
        chamfer_1e3_m2=best.chamfer_1e3_m2,
    )


def _result_of(metrics: MeshMetrics) -> RowResult:
    mesh, truth = (
        f"{of.n_components}, {'open' if of.n_holes is None else of.n_holes}"
        for of in (metrics.mesh, metrics.truth)
    )
    x, y, z = metrics.size.extent_errors_m
    return RowResult(
        f1_15mm=metrics.f1(0.015),
        f1_5mm=metrics.f1(0.005),
        f1_3mm=metrics.f1(0.003),
        f1_2mm=metrics.f1(0.002),
        chamfer_1e3_m2=metrics.chamfer_1e3_m2,
        volume_ratio=metrics.size.volume_ratio,
        extent_x_m=x,
        extent_y_m=y,
        extent_z_m=z,
        offset_m=metrics.surface_bias_m,
        median_m=metrics.both_ways.median_m,
        same_topology=float(mesh == truth),
        topology=f"{mesh} ({truth})",
    )


def population_scores(
    mesh: TriangleMesh,
    truth: TriangleMesh,
    seed: int,
    *,
    stated: Mapping[str, Any] | None = None,
    num_threads: int | None = None,
) -> dict[str, float]:
    """Scores of a reconstructed surface by name; lengths in millimetres.

    mesh: the content, with expected errors where the preset has them.
    truth: the true surface, closed.
    seed: of the points that are drawn.
    stated: numbers of the stage `mesh`, with the intervals of volume and extents.
    """
    metrics = evaluate_mesh(
        mesh,
        truth,
        n_samples=FINE_SAMPLES,
        seed=seed,
        thresholds_m=_THRESHOLDS_M,
        num_threads=num_threads,
    )
    scores = metrics.headline()
    if metrics.expected_error is not None:
        scores["within_one"] = metrics.expected_error.within_one
        scores["within_two"] = metrics.expected_error.within_two
        scores["rank"] = metrics.expected_error.rank_correlation
    return scores | _covered_sizes(truth, stated or {})


def _covered_sizes(truth: TriangleMesh, stated: Mapping[str, Any]) -> dict[str, float]:
    """Whether stated 95 % intervals hold the true volume, and the share of extents that they hold.

    {} without intervals.
    """
    if "volume_95_percent_cm3" not in stated:
        return {}
    low, high = stated["volume_95_percent_cm3"]
    volume = 1e6 * enclosed_volume_m3(truth.vertices, truth.faces)
    sides = 1e3 * np.ptp(truth.vertices, axis=0)
    ends = np.asarray(stated["extents_95_percent_mm"])
    return {
        "volume_covered": float(low <= volume <= high),
        "extents_covered": float(np.mean((ends[:, 0] <= sides) & (sides <= ends[:, 1]))),
    }
