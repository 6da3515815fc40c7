"""What `geraf2 calibrate` recovers: delay, F1 and Chamfer distance before and after.

    python bench/python/calibration.py --data ../shared/data --out out/calibration

Two cases. The independent capture `spot_carton` with its instrument delay withheld: the delay
found, and the scores of its reconstruction beside those with the delay that was written down. And
a simulated cat (18 planes at 4 mm) with everything wrong: 0.5 mm rms slow drift of the positions,
30 degrees rms phase of 8 channels, the turntable axis 3 mm off, the prior turned by 2 degrees and
moved by 5 mm; its scores as it is, after calibration, and those of a perfect capture. Seed 0.
"""

import argparse
import json
import shutil
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from scipy.spatial.transform import Rotation

from geraf2.io.mesh import TriangleMesh, read_mesh, write_mesh
from scores import CARTON, HEADER, INDEPENDENT, Score, geraf2, reconstruct_and_score

DISTURBED_SCAN = {"position_drift_rms_m": 5e-4, "axis_offset_m": [0.0021, 0.0021]}
DISTURBANCE = {"channel_phase_rms_deg": 30.0, "n_channels": 8}
PRIOR_TURN = np.deg2rad(2.0) * np.array([0.5, 0.5, np.sqrt(0.5)])
PRIOR_SHIFT_M = np.array([0.003, -0.003, 0.00265])  # 5 mm


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
    for threshold in ("f1_15_mm", "f1_5_mm", "f1_3_mm", "chamfer_1e3_m2"):
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
        "8",
        "--overwrite",
    )
    best = show(
        "cat, perfect", reconstruct_and_score(perfect, perfect / "los.ply", truth, out / "r")
    )
    show("cat, everything wrong", reconstruct_and_score(wrong, los, truth, out / "r"))
    found = show(
        "cat, calibrated",
        reconstruct_and_score(calibrated, calibrated / "los.ply", truth, out / "r"),
    )
    print(f"  F1 5 mm: calibrated / perfect = {found.f1_5_mm / best.f1_5_mm:.4f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, default=Path("out/calibration"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    print(HEADER)
    withheld_delay(options.data, options.out)
    everything_wrong(options.data, options.out)


if __name__ == "__main__":
    main()
