"""Scans that grow: time of an update, F1 after each plane, and the end against `reconstruct`.

    python bench/python/live.py run ROWS SCENE... [--preset fast] [--every 1] [--whole]
    python bench/python/live.py check ROWS

`run` adds the planes of each scene (a folder with truth.ply) to a session, evenly around the box,
and appends a line for every N-th to the file ROWS; scenes that are there are left out. With
`--whole`, the last line of a scene compares the end with `reconstruct`, of the planes as they were
added and in the order of the scan. `check` states these, and the time of an update in the first and
the last quarter of the planes.
"""

import argparse
import json
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np

import geraf2
from geraf2.errors import UserError
from geraf2.evaluation.mesh_metrics import evaluate_mesh
from geraf2.io.mesh import read_mesh

TAU_M = 0.005


def even_order(n: int) -> list[int]:
    """Order of the planes of a ring in which each new one lies between those before."""
    bits = max(1, (n - 1).bit_length())
    reversed_ = [int(f"{k:0{bits}b}"[::-1], 2) for k in range(2**bits)]
    return sorted(range(n), key=lambda k: reversed_[k * 2**bits // n])


def f1_of(mesh, truth) -> float:
    scores = evaluate_mesh(mesh, truth, n_samples=5000, thresholds_m=(TAU_M,)).scores
    return float(scores[0].f1)


def run(rows: Path, scene: Path, preset: str, every: int, is_whole: bool) -> None:
    capture, truth = geraf2.load_capture(scene), read_mesh(scene / "truth.ply")
    order = even_order(len(capture.poses))
    with (
        geraf2.Session(replace(capture, poses=()), None, preset) as session,
        rows.open("a", buffering=1) as file,
    ):

        def write(**values) -> None:
            line = json.dumps({"scene": scene.name, "preset": preset, **values})
            print(line, flush=True)
            file.write(line + "\n")

        for number, index in enumerate(order, start=1):
            start = time.perf_counter(), time.process_time()
            session.add(capture.poses[index])
            if number % every:
                continue
            try:
                mesh = session.result.content_mesh
            except UserError as error:
                write(plane=number, error=str(error))
                continue
            seconds, cpu = time.perf_counter() - start[0], time.process_time() - start[1]
            write(
                plane=number,
                n_planes=len(order),
                f1=f1_of(mesh, truth),
                seen=session.result.numbers["mesh"]["evidence_shares"]["seen"],
                error_mm=session.result.numbers["mesh"].get("expected_error_median_mm"),
                seconds=round(seconds, 2),
                cpu_seconds=round(cpu, 2),
            )
        if not is_whole:
            return
        try:
            end = session.finish()
        except UserError as error:
            write(end=None, error=str(error))
            return
        as_added = replace(capture, poses=tuple(capture.poses[index] for index in order))
        runs = [end, *(geraf2.reconstruct(one, None, preset) for one in (as_added, capture))]
        counts = [one.run.stages["glints"].numbers["n_glints"] for one in runs]
        f1 = [f1_of(one.content_mesh, truth) for one in runs]
        write(end=f1[0], whole=f1[1], in_scan_order=f1[2], n_glints=counts)


def read(rows: Path) -> tuple[dict[str, list[dict]], list[dict]]:
    """Lines after planes by scene, and the last lines."""
    growing, ends = defaultdict(list), []
    for line in rows.read_text().splitlines():
        row = json.loads(line)
        if "end" in row:
            ends.append(row)
        elif "f1" in row:
            growing[row["scene"]].append(row)
    return growing, ends


def check(rows: Path) -> None:
    growing, ends = read(rows)
    for row in (row for row in ends if row["end"] is not None):
        f1 = ", ".join(f"{name} {row[name]:.4f}" for name in ("end", "whole", "in_scan_order"))
        print(f"{row['scene']}: {f1}, glints {row['n_glints']}")
    for name, low, high in (("first", 0.0, 0.25), ("last", 0.75, 1.0)):
        part = [
            row
            for own in growing.values()
            for row in own
            if low <= row["plane"] / row["n_planes"] <= high
        ]
        for unit, key in (("s", "seconds"), ("CPU s", "cpu_seconds")):
            values = [row[key] for row in part]
            print(f"update, {name} quarter, {unit}: ", end="")
            print(f"median {np.median(values):.2f}, largest {max(values):.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("run", "check"))
    parser.add_argument("rows", type=Path)
    parser.add_argument("scenes", type=Path, nargs="*")
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="planes an update")
    parser.add_argument("--whole", action="store_true", help="compare the end with reconstruct")
    given = parser.parse_args()
    if given.what == "run":
        known = given.rows.read_text() if given.rows.exists() else ""
        for scene in given.scenes:
            if f'"scene": "{scene.name}", "preset": "{given.preset}"' not in known:
                run(given.rows, scene, given.preset, given.every, given.whole)
    else:
        check(given.rows)


if __name__ == "__main__":
    main()
