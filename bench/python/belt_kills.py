"""A stream of parcels whose workers are killed, against the same stream undisturbed.

    python bench/python/belt_kills.py OUT [--parcels 40] [--kills 5]

Copies of one small simulated parcel with noise of their own pass in one stream. `geraf2 belt` runs
on it twice with two workers, the second time with processes of its workers killed (SIGKILL) at
random moments. It prints how many parcels have a run and a row, and whether all meshes and reported
lengths are the same.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil

from geraf2.io.belt_file import write_belt
from geraf2.io.growing_scene import GrowingScene
from geraf2.scene.store import manifest_of
from geraf2.simulation import simulate
from geraf2.simulation.belt import belt_record
from geraf2.simulation.spec import parse_spec

PITCH_M = 0.6
ROW = {"row_m": 0.006, "standoff_m": 0.2}
SPEC = {
    "figure": {"name": "ball", "height_m": 0.06},
    "walls": [{"size_m": (0.16, 0.16, 0.16)}],
    "numerics": {"max_facet_edge_m": 0.0012, "wall_patch_m": 0.01},
    "disturbance": {"far_walls": False},
    "belt": {
        "travel_m": 0.4,
        "frame_m": 0.004,
        "segment_m": 0.2,
        "arrays": (
            {"side": "left", **ROW},
            {"side": "above", **ROW},
            {"side": "left", "name": "speed", "station_m": 0.2, **ROW},
        ),
    },
}
START = "import sys; from geraf2.cli.main import main; sys.exit(main(sys.argv[1:]))"


def make_stream(path: Path, n_parcels: int) -> None:
    """Write copies of a parcel one after the other."""
    spec = parse_spec(SPEC)
    capture, _ = simulate(spec, seed=0)
    n = len(capture.poses)
    provenance = {"n_planes": str(n * n_parcels)}
    scene = GrowingScene(path, manifest_of(replace(capture, poses=(), provenance=provenance)))
    for parcel in range(n_parcels):
        rng = np.random.default_rng(parcel)
        for number, pose in enumerate(capture.poses):
            noise = 1e-3 * rng.normal(size=(*pose.signal.shape, 2)) @ [1.0, 1j]
            moved = pose.moved(np.array([-parcel * PITCH_M, 0.0, 0.0]))
            name = f"{pose.name.rpartition('/')[0]}/{parcel * n + number}"
            signal_ = (pose.signal + noise).astype(np.complex64)
            scene.append(replace(moved, name=name, signal=signal_))
            if not (parcel or number):
                write_belt(path, belt_record(spec.belt))


def run(stream: Path, out: Path, kills: int) -> tuple[float, int]:
    """Seconds of a run, and how many processes were killed in it."""
    words = ["belt", str(stream), str(out), "--preset", "fast", "--workers", "2", "--threads", "1"]
    start, rng, killed = time.monotonic(), random.Random(0), 0
    with subprocess.Popen([sys.executable, "-c", START, *words, "--idle-s", "3"]) as process:
        pause = 0.0
        while process.poll() is None:
            time.sleep(0.2)
            pause -= 0.2
            results = len(list(out.glob("results/*"))) if out.is_dir() else 0
            if killed < kills and results and pause <= 0.0 and _kill_one(process.pid, rng):
                killed, pause = killed + 1, rng.uniform(5.0, 15.0)
    if process.returncode:
        message = f"geraf2 belt ended with {process.returncode}"
        raise SystemExit(message)
    return time.monotonic() - start, killed


def _kill_one(pid: int, rng: random.Random) -> bool:
    """Kill a process below the command: a worker, or the child that it calls."""
    found = [p for p in psutil.Process(pid).children(recursive=True) if "-c" in p.cmdline()[1:3]]
    found = [p for p in found if "resource_tracker" not in " ".join(p.cmdline())]
    if not found:
        return False
    os.kill(rng.choice(found).pid, signal.SIGKILL)
    return True


def results_of(out: Path) -> tuple[dict[str, bytes], dict[str, tuple[str, float | None]]]:
    """Mesh of each parcel, and state and length of each row."""
    meshes = {
        path.parent.name.rpartition("-")[0]: path.read_bytes()
        for path in out.glob("runs/*/mesh_content.ply")
    }
    records = [json.loads(path.read_text()) for path in out.glob("results/*.json")]
    rows = {r["scene"]: (r["state"], r["numbers"].get("length_m")) for r in records}
    return meshes, rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--parcels", type=int, default=40)
    parser.add_argument("--kills", type=int, default=5)
    given = parser.parse_args()
    given.out.mkdir(parents=True)
    make_stream(given.out / "stream", given.parcels)
    for name, kills in (("plain", 0), ("killed", given.kills)):
        seconds, killed = run(given.out / "stream", given.out / name, kills)
        print(f"{name}: {seconds:.0f} s, {killed} processes killed", flush=True)
    plain, again = results_of(given.out / "plain"), results_of(given.out / "killed")
    print(f"{len(plain[0])} and {len(again[0])} meshes of {given.parcels} parcels")
    same = sum(plain[0].get(name) == mesh for name, mesh in again[0].items())
    print(
        f"{same} meshes have the same bytes; rows are {'' if plain[1] == again[1] else 'not '}equal"
    )


if __name__ == "__main__":
    main()
