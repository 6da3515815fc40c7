"""Parcels on a belt: F1, coverage of errors, speed and CPU seconds over random objects.

    python bench/python/belt.py run ROWS [--seeds 1001 1002] [--cases ideal moved] [--presets fast]
    python bench/python/belt.py show ROWS

`run` puts the objects of the population (`geraf2.simulation.population`) into 0.3 m parcels between
two side arrays and one above, each of four cascades, with a fourth array on the line of the left
one. It appends a line for each object and case to the file ROWS, and continues after a stop. `show`
prints the mean of each case beside the value that is asked for. Cases: `ideal`; `moved`, the speed
wrong by 1 %, vibration of 0.2 mm, yaw of 2 degrees over the travel; `blind`, the speed wrong by 1 %
without an encoder. In the case `ideal` a part of the arrays is reconstructed, too: the left one,
and both sides.
"""

import argparse
import itertools
import json
import time
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

import geraf2
from geraf2.apps.belt.parcel import parcel_scan
from geraf2.simulation import simulate
from geraf2.simulation.belt import belt_record
from geraf2.simulation.simulate import recorded_planes
from geraf2.simulation.spec import parse_spec

MOVED = {"speed_error": 0.01, "vibration_rms_m": 0.0002, "yaw_drift_deg": 2.0}
CASES = {
    "ideal": {},
    "moved": MOVED | {"encoder_jitter_m": 0.00005},
    "blind": {"speed_error": 0.01, "encoder": False},
}
KEYS = ("seed", "case", "world", "preset", "arrays")
SIDES = [{"side": side, "n_boards": 4, "row_m": 0.005} for side in ("left", "right", "above")]
ALL = "left+right+above+speed"
PARTS = ("left+speed", "left+right+speed")
ARRAYS = [*SIDES, {"name": "speed", "side": "left", "station_m": 0.3, "row_m": 0.005}]


def spec_of(seed: int, case: str, world: str):
    rng = np.random.default_rng(seed)
    return parse_spec(
        {
            "figure": {"name": f"random-{seed}", "height_m": float(rng.uniform(0.10, 0.16))},
            "walls": [{"size_m": (0.30, 0.30, 0.26)}],
            "belt": {"arrays": ARRAYS, **CASES[case]},
            "numerics": {"wall_patch_m": 0.008},
            "world": {
                "preset": world,
                "effects": ["channels", "iq", "quantisation", "bulge", "white"],
            }
            if world != "none"
            else {},
        }
    )


@lru_cache(maxsize=1)
def simulated(seed: int, case: str, world: str):
    return simulate(spec_of(seed, case, world), seed=seed, num_threads=1)


def recorded(seed: int, case: str, world: str, arrays: str):
    """Capture and belt of some arrays, the object, and the spec."""
    spec = spec_of(seed, case, world)
    capture, truth = simulated(seed, case, world)
    poses = [
        replace(pose, tx_positions=plane.tx, rx_positions=plane.rx)
        for pose, plane in zip(capture.poses, recorded_planes(spec, seed)[0], strict=True)
        if pose.name.rpartition("/")[0] in arrays.split("+")
    ]
    belt = belt_record(spec.belt)
    kept = tuple(array for array in belt.arrays if array.name in arrays.split("+"))
    return replace(capture, poses=tuple(poses)), replace(belt, arrays=kept), truth, spec


def measured(seed: int, case: str, world: str, presets: list[str], arrays: str):
    """Yield a row for each preset."""
    capture, belt, truth, spec = recorded(seed, case, world, arrays)
    start = time.process_time()
    scan, motion = parcel_scan(capture, belt, num_threads=1)
    cut_s = time.process_time() - start
    for preset in presets:
        start = time.process_time()
        about = dict(zip(KEYS, (seed, case, world, preset, arrays), strict=True))
        try:
            result = geraf2.reconstruct(scan, None, preset, num_threads=1)
        except geraf2.UserError as error:
            yield about | {"error": str(error)}
            continue
        cpu_s = cut_s + time.process_time() - start
        scores = geraf2.evaluate(result, truth, report=False, num_threads=1)
        yield about | row_of(scores, motion, spec) | {"cpu_s": cpu_s, "cut_s": cut_s}


def row_of(scores, motion, spec) -> dict:
    sight = next(part for part in scores.by_sight if part.part == "in sight")
    errors = scores.expected_error
    return {
        "f1_15mm": scores.headline()["f1_15mm"],
        "f1_5mm": scores.headline()["f1_5mm"],
        "f1_5mm_in_sight": {s.threshold_m: s.f1 for s in sight.scores}[0.005],
        "in_sight": sight.area_fraction,
        "within_one": errors.within_one,
        "within_two": errors.within_two,
        "speed_error": (1.0 + motion.scale) * (1.0 + spec.belt.speed_error) - 1.0,
        "speed_sigma": motion.scale_sigma,
        "yaw_error_deg": float(np.rad2deg(motion.turn_rad_per_m)) - spec.belt.yaw_drift_deg,
    }


def run(given: argparse.Namespace) -> None:
    rows: Path = given.rows
    lines = rows.read_text().splitlines() if rows.exists() else []
    done = {tuple(json.loads(line)[key] for key in KEYS) for line in lines}
    with rows.open("a", buffering=1) as file:
        for seed, case, arrays in itertools.product(given.seeds, given.cases, (ALL, *PARTS)):
            if arrays in PARTS and case != "ideal":
                continue
            about = seed, case, given.world
            left = [own for own in given.presets if (*about, own, arrays) not in done]
            for row in measured(*about, left, arrays) if left else ():
                print(json.dumps(row), flush=True)
                file.write(json.dumps(row) + "\n")


def show(rows: Path) -> None:
    lines = [json.loads(line) for line in rows.read_text().splitlines()]
    names = {
        "f1_15mm": "0.99",
        "f1_5mm_in_sight": "0.97",
        "f1_5mm": "ideal less 0.01",
        "within_one": "0.68",
        "within_two": "0.95",
        "cpu_s": "10",
    }
    kinds = ("preset", "case", "world", "arrays")
    for kind in sorted({tuple(line[key] for key in kinds) for line in lines}):
        own = [line for line in lines if tuple(line[key] for key in kinds) == kind]
        good = [line for line in own if "error" not in line]
        print(f"{', '.join(kind)}: {len(good)} of {len(own)} parcels")
        if not good:
            continue
        for name, asked in names.items():
            values = np.array([line[name] for line in good])
            print(
                f"  {name:16s} {values.mean():.3f} ({values.min():.3f} to {values.max():.3f})",
                end="",
            )
            print(f"  asked {asked}")
        speed = 100.0 * np.abs([line["speed_error"] for line in good])
        print(f"  speed error      {speed.mean():.3f} %, at most {speed.max():.3f}  asked 0.05 %")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("action", choices=("run", "show"))
    parser.add_argument("rows", type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(10_001, 10_013)))
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--world", choices=("none", "plausible"), default="none")
    parser.add_argument("--presets", nargs="+", default=["best", "fast"])
    given = parser.parse_args()
    if given.action == "show":
        show(given.rows)
    else:
        run(given)


if __name__ == "__main__":
    main()
