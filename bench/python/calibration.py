"""What `geraf2 calibrate` recovers: delay, F1 and Chamfer distance before and after.

    python bench/python/calibration.py --data ../shared/data --out out/calibration

Two cases. The independent capture `spot_carton` with its instrument delay withheld: the delay
found, and the scores of its reconstruction beside those with the delay that was written down. And
a simulated cat (18 planes at 4 mm) with everything wrong: 0.5 mm rms slow drift of the positions,
30 degrees rms phase of 4 channels, the turntable axis 3 mm off, the prior turned by 2 degrees and
moved by 5 mm; its scores as it is, as `geraf2 reconstruct` calibrates it by itself, after `geraf2
calibrate --channels 4`, and those of a perfect capture. Seed 0.

    python bench/python/calibration.py --coverage 200 --out out/calibration

How often the stated 95 % intervals hold the truth, in small simulated scans of bulged boxes (12
planes at 6 mm, bulges up to 2 mm) whose delay is up to 8 mm off and whose prior is turned by up to
1.5 degrees and moved by up to 2 mm; ten draws of these of each scan. No data needed.
"""

import argparse
import json
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from scipy.spatial.transform import Rotation

from geraf2.calibration.wall_alignment import GROUPS, AlignmentConfig, WallProblem
from geraf2.imaging.peaks import KeptPeaks
from geraf2.io.mesh import TriangleMesh, read_mesh, write_mesh
from geraf2.scene import Capture, LosPrior, Wall
from geraf2.simulation import (
    FigureSpec,
    NumericsSpec,
    ScanSpec,
    SceneSpec,
    WorldSpec,
    simulate,
)
from scores import CARTON, HEADER, INDEPENDENT, Score, geraf2, reconstruct_and_score

DISTURBED_SCAN = {"position_drift_rms_m": 5e-4, "axis_offset_m": [0.0021, 0.0021]}
DISTURBANCE = {"channel_phase_rms_deg": 30.0, "n_channels": 4}  # divides 36 x 63 antennas
PRIOR_TURN = np.deg2rad(2.0) * np.array([0.5, 0.5, np.sqrt(0.5)])
PRIOR_SHIFT_M = np.array([0.003, -0.003, 0.00265])  # 5 mm


COVERAGE_BOX_M = (0.18, 0.18, 0.18)
DRAWS_PER_SCAN = 10


def coverage(n_scans: int) -> None:
    """Share of the stated 95 % intervals that hold the truth, and errors over sigma."""
    rng = np.random.default_rng(0)
    names = ("delay", "turn about z", "shift along x", "shift along y")
    scaled: list[list[float]] = []
    millimetres: list[float] = []
    for number in range(n_scans):
        if number % DRAWS_PER_SCAN == 0:
            capture = _bulged_scan(number, rng)
        errors = rng.uniform(-1.0, 1.0, 4) * [0.008, np.deg2rad(1.5), 0.002, 0.002]
        prior = LosPrior.from_box(COVERAGE_BOX_M, walls=capture.walls)
        turn = Rotation.from_rotvec([0.0, 0.0, errors[1]])
        shift = np.array([errors[2], errors[3], 0.0])
        late = replace(
            capture.waveform, path_bias_m=capture.waveform.path_bias_m + float(errors[0])
        )
        moved = replace(prior, vertices=turn.apply(prior.vertices) + shift)
        problem = WallProblem(
            replace(capture, waveform=late), moved, AlignmentConfig(), KeptPeaks(moved)
        )
        found = problem.result(problem.fit(GROUPS))
        off = [
            found.delay_m + errors[0],
            found.rotation_rad[2] + errors[1],
            *(found.translation_m + shift)[:2],
        ]
        sigmas = [found.delay_sigma_m, found.rotation_sigma_rad[2], *found.translation_sigma_m[:2]]
        scaled.append([o / s for o, s in zip(off, sigmas, strict=True)])
        millimetres.append(1e3 * off[0])
    each = np.asarray(scaled)
    print(f"| {n_scans} scans | in the 95 % interval | rms error / sigma |\n|---|---|---|")
    for name, column in zip(names, each.T, strict=True):
        share = 100.0 * np.mean(np.abs(column) < 1.96)
        print(f"| {name} | {share:.1f} % | {np.sqrt(np.mean(column**2)):.2f} |")
    print(f"delay: rms error {np.sqrt(np.mean(np.square(millimetres))):.2f} mm of path")


def _bulged_scan(number: int, rng: np.random.Generator) -> Capture:
    names = ("llama", "knot", "hammer", "chair")
    spec = SceneSpec(
        figure=FigureSpec(
            name=names[number // DRAWS_PER_SCAN % len(names)],
            height_m=0.07,
            turn_deg=float(rng.uniform(0.0, 360.0)),
        ),
        walls=(Wall(size_m=COVERAGE_BOX_M, thickness_m=0.004, permittivity=1.6),),
        scan=ScanSpec(n_poses=12, spacing_m=0.006, aperture_m=(0.12, 0.14)),
        numerics=NumericsSpec(wall_patch_m=0.01, antenna_block_m=0.07),
        world=WorldSpec(wall_bulge_m=float(rng.uniform(0.0, 0.002))),
    )
    return simulate(spec, seed=number)[0]


def show(name: str, score: Score) -> Score:
    print(score.row(name), flush=True)
    return score


def withheld_delay(data: Path, out: Path) -> None:
    capture = data / INDEPENDENT
    blind = out / "capture_without_delay"
    shutil.rmtree(blind, ignore_errors=True)
    shutil.copytree(capture, blind)
    parameters = json.loads((capture / "capture.json").read_text(encoding="utf-8"))
    true_delay = parameters["path_bias_m"]
    changed = json.dumps(parameters | {"path_bias_m": 0.0})
    (blind / "capture.json").write_text(changed, encoding="utf-8")
    los, truth = capture / "los_box.ply", capture / "truth_object.ply"
    scenes = {name: out / f"spot_{name}" for name in ("known", "withheld", "calibrated")}
    geraf2("import", "geraf-sens", str(capture), str(scenes["known"]), "--overwrite")
    geraf2("import", "geraf-sens", str(blind), str(scenes["withheld"]), "--overwrite")
    geraf2(
        "calibrate",
        str(scenes["withheld"]),
        str(scenes["calibrated"]),
        "--los",
        str(los),
        "--delay-search",
        "-0.3",
        "1.0",
        "--overwrite",
    )
    table = read_calibration(scenes["calibrated"])
    error_mm = 1e3 * (table["path_bias_m"] - true_delay)
    print(
        f"delay {table['path_bias_m']:.5f} +- {table['path_bias_sigma_m']:.5f} m, "
        f"true {true_delay:g} m, error {error_mm:.2f} mm of path"
    )
    known = show("spot, delay known", reconstruct_and_score(scenes["known"], los, truth, out / "r"))
    found_los = scenes["calibrated"] / "los.ply"
    found = show(
        "spot, delay found",
        reconstruct_and_score(scenes["calibrated"], found_los, truth, out / "r"),
    )
    for threshold in (
        "f1_15_mm",
        "f1_5_mm",
        "f1_3_mm",
        "f1_2_mm",
        "chamfer_1e3_m2",
        "volume_ratio",
    ):
        ratio = getattr(found, threshold) / getattr(known, threshold)
        print(f"  {threshold}: found / known = {ratio:.4f}")


def read_calibration(scene: Path) -> dict[str, Any]:
    table = tomllib.loads((scene / "scene.toml").read_text(encoding="utf-8"))
    return dict(table["calibration"][-1])


def simulated(data: Path, out: Path, name: str, changes: dict[str, Any]) -> Path:
    spec = {
        "figure": {
            "mesh": str((data / "meshes" / "cat.ply").resolve()),
            "height_m": 0.12,
            "up": "+y",
        },
        "walls": [CARTON],
        "scan": {"n_poses": 18, "spacing_m": 0.004} | changes.get("scan", {}),
        "disturbance": changes.get("disturbance", {}),
    }
    text, path, scene = tomli_w.dumps(spec), out / f"{name}.toml", out / name
    known = path.read_text(encoding="utf-8") if path.is_file() else None
    if known != text or not scene.is_dir():
        path.write_text(text, encoding="utf-8")
        geraf2("simulate", str(path), str(scene), "--overwrite")
    return scene


def displaced_prior(scene: Path) -> Path:
    mesh = read_mesh(scene / "los.ply")
    vertices = Rotation.from_rotvec(PRIOR_TURN).apply(mesh.vertices) + PRIOR_SHIFT_M
    path = scene.parent / "los_displaced.ply"
    write_mesh(TriangleMesh(vertices=vertices, faces=mesh.faces), path, frame="camera")
    return path


def everything_wrong(data: Path, out: Path) -> None:
    perfect = simulated(data, out, "cat_perfect", {})
    changes = {"scan": DISTURBED_SCAN, "disturbance": DISTURBANCE}
    wrong = simulated(data, out, "cat_wrong", changes)
    truth, los = perfect / "truth.ply", displaced_prior(perfect)
    calibrated = out / "cat_calibrated"
    geraf2(
        "calibrate",
        str(wrong),
        str(calibrated),
        "--los",
        str(los),
        "--channels",
        "4",
        "--overwrite",
    )
    best = show(
        "cat, perfect", reconstruct_and_score(perfect, perfect / "los.ply", truth, out / "r")
    )
    show(
        "cat, everything wrong",
        reconstruct_and_score(wrong, los, truth, out / "r", "--calibrate", "no"),
    )
    show("cat, by itself", reconstruct_and_score(wrong, los, truth, out / "r"))
    found = show(
        "cat, calibrated",
        reconstruct_and_score(calibrated, calibrated / "los.ply", truth, out / "r"),
    )
    print(f"  F1 5 mm: calibrated / perfect = {found.f1_5_mm / best.f1_5_mm:.4f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path)
    parser.add_argument("--coverage", type=int, help="count intervals of so many scans instead")
    parser.add_argument("--out", type=Path, default=Path("out/calibration"))
    options = parser.parse_args()
    if options.coverage:
        coverage(options.coverage)
        return
    if options.data is None:
        parser.error("give --data or --coverage")
    options.out.mkdir(parents=True, exist_ok=True)
    print(HEADER)
    withheld_delay(options.data, options.out)
    everything_wrong(options.data, options.out)


if __name__ == "__main__":
    main()
