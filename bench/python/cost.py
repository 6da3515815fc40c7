"""What accuracy costs: F1 and error in sight against CPU seconds, by preset, planes and spacing.

    python bench/python/cost.py run ROWS SCENE=TRUTH...
    python bench/python/cost.py draw ROWS --to docs/cost.png

`run` takes parts of each scan, reconstructs them by `geraf2 reconstruct --no-report` in a process
of its own, and adds a line for each to the file ROWS; those that are there are left out. CPU
seconds are those of the process, its start included. The median error in sight is that of the part
of the true surface which the planes of the whole scan see. `draw` prints and draws the rows.
"""

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
from matplotlib import pyplot as plt  # the backend must be chosen first
from matplotlib.ticker import LogLocator

from geraf2 import Capture, load_capture
from geraf2.evaluation import evaluate_mesh
from geraf2.io.mesh import read_mesh
from geraf2.records import Pose
from geraf2.scene import save_capture
from geraf2.scene.aperture import Aperture
from reconstruct import geraf2_command, measure

BASELINES = ("back-projection", "matched-filter", "normal-field")
PLANES = (36, 18, 9, 6)
STEPS = (1, 2)
"""Every so many rows and columns of antennas."""
COLOURS = {"fast": "tab:orange", "best": "tab:blue"}


def thinned(pose: Pose, step: int) -> Pose:
    """Every so many rows and columns of a plane."""
    keep = np.ones(pose.n_antennas, dtype=bool)
    for along in (pose.phase_centers @ pose.axes[1:].T).T:
        keep &= np.unique(np.rint(1e4 * along), return_inverse=True)[1] % step == 0
    return pose.select(np.flatnonzero(keep))


def part_of(capture: Capture, n_planes: int, step: int) -> Capture:
    chosen = [k * len(capture.poses) // n_planes for k in range(n_planes)]
    return replace(capture, poses=tuple(thinned(capture.poses[k], step) for k in chosen))


def run(rows: Path, scene: Path, truth_path: Path) -> None:
    capture, truth = load_capture(scene), read_mesh(truth_path)
    planes = [Aperture.from_pose(pose) for pose in capture.poses]
    parts = [(preset, n, step) for preset in COLOURS for n in PLANES for step in STEPS]
    parts += [(preset, len(planes), 1) for preset in BASELINES]
    done = rows.read_text() if rows.is_file() else ""
    for preset, n, step in parts:
        row = {"scene": scene.name, "preset": preset, "planes": min(n, len(planes)), "step": step}
        if json.dumps(row)[:-1] in done:
            continue
        with tempfile.TemporaryDirectory() as folder:
            part, out = Path(folder, "scene"), Path(folder, "out")
            save_capture(part_of(capture, row["planes"], step), part)
            command = [*geraf2_command(), "reconstruct", str(part), str(out)]
            try:
                spent = measure([*command, "--preset", preset, "--no-report"], quiet=True)
            except SystemExit as stop:  # too little of the scan for any surface
                print(stop)
                continue
            mesh = read_mesh(out / "mesh_content.ply")
        found = evaluate_mesh(mesh, truth, planes=planes)
        row |= {"cpu_s": round(spent.cpu_s, 2), "wall_s": round(spent.wall_s, 2)}
        row |= {"f1": round(found.f1(0.005), 4)}
        row |= {"median_mm": round(1e3 * found.by_sight[0].surface_truth_to_mesh.median_m, 3)}
        print(json.dumps(row), flush=True)
        with rows.open("a") as file:
            file.write(json.dumps(row) + "\n")


def draw(rows: list[dict], to: Path) -> None:
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    figure, panels = plt.subplots(
        len(scenes), 2, figsize=(9.0, 3.6 * len(scenes)), squeeze=False, layout="constrained"
    )
    measures = (("lacking", "1 - F1 at 5 mm"), ("median_mm", "median error in sight [mm]"))
    for scene, pair in zip(scenes, panels, strict=True):
        own = [row | {"lacking": 1.0 - row["f1"]} for row in rows if row["scene"] == scene]
        for panel, (key, name) in zip(pair, measures, strict=True):
            for preset, colour in COLOURS.items():
                for step, style in zip(STEPS, ("o-", "s:"), strict=True):
                    line = [r for r in own if (r["preset"], r["step"]) == (preset, step)]
                    x, y = [r["cpu_s"] for r in line], [r[key] for r in line]
                    spacing = "all antennas" if step == 1 else f"every {step}nd row and column"
                    label = f"{preset}, {spacing}"
                    panel.plot(x, y, style, color=colour, label=label, markersize=4, linewidth=1.2)
                    for row in line:
                        at = {"xytext": (3, 3), "textcoords": "offset points", "fontsize": 7}
                        panel.annotate(f"{row['planes']}", (row["cpu_s"], row[key]), **at)
            others = [row for row in own if row["preset"] in BASELINES]
            for number, row in enumerate(others):
                panel.plot(row["cpu_s"], row[key], "x", color="0.3")
                at = {"xytext": (-4, 4 - 10 * number), "textcoords": "offset points", "fontsize": 7}
                panel.annotate(row["preset"], (row["cpu_s"], row[key]), ha="right", **at)
            panel.set(xscale="log", yscale="log", ylabel=name, xlabel="CPU seconds")
            for axis in (panel.xaxis, panel.yaxis):
                axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 3.0, 5.0)))
                axis.set_major_formatter("{x:g}")
            panel.minorticks_off()
            panel.grid(alpha=0.3)
            panel.set_title(f"{scene}; numbers: planes", fontsize=9)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, loc="outside lower center", ncols=len(labels))
    figure.savefig(to, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    what = parser.add_subparsers(dest="what", required=True)
    running = what.add_parser("run")
    running.add_argument("rows", type=Path)
    running.add_argument("scenes", nargs="+", metavar="SCENE=TRUTH")
    drawing = what.add_parser("draw")
    drawing.add_argument("rows", type=Path)
    drawing.add_argument("--to", type=Path, required=True)
    options = parser.parse_args()
    if options.what == "run":
        for scene, _, truth in (text.partition("=") for text in options.scenes):
            run(options.rows, Path(scene), Path(truth))
    else:
        rows = [json.loads(line) for line in options.rows.read_text().splitlines()]
        for row in rows:
            print(*row.values())
        draw(rows, options.to)


if __name__ == "__main__":
    main()
