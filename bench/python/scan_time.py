"""What planes buy for the minutes that they take: parts of one simulated scan, reconstructed.

    geraf2 simulate SPEC.toml SCENE --scan SUPER.json      # of each object; see `superset`
    python bench/python/scan_time.py superset SUPER.json
    python bench/python/scan_time.py scenes OUT [--objects NAME|SEED ...]
    python bench/python/scan_time.py scores SCENE... --out OUT [--preset fast best] [--only NAME...]
    python bench/python/scan_time.py check OUT [--objects NAME|SEED ...]
    python bench/python/scan_time.py draw OUT --to docs/scan-time.svg

`scenes` simulates 6 planes around and 1 above of figures and of random metal objects, by seed.
`superset` writes a scan of 12 planes around the box of 22 cm, 8 at 40 degrees and 1 above at 4 mm,
with 8 channels at 0.1 m/s. `scores` takes planes of it out of each scene, as DESIGNS
has them, reconstructs with the walls' outer sides as prior, and scores against truth.ply, what the
planes see apart. Rows that OUT/scores.json holds are not made again. Minutes are those of 8
channels and of one. `check` compares scores with what `geraf2 plan` states. `draw` draws the means
over the objects against the minutes.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from scipy.spatial import KDTree

from geraf2 import LosPrior, reconstruct
from geraf2.apps.planning.expected import ExpectedAccuracy, expect_accuracy
from geraf2.apps.planning.scan_time import Design, Scanner, swept_planes
from geraf2.evaluation import evaluate_mesh
from geraf2.freespace.specular import seen_share
from geraf2.geometry.triangles import face_areas, unit_normals
from geraf2.io.atomic import write_json_atomic
from geraf2.io.mesh import TriangleMesh, read_mesh, write_mesh
from geraf2.io.scan_file import ScanFile, write_scan_file
from geraf2.scene import Capture, Pose, Wall, load_capture, save_capture
from geraf2.scene.aperture import Aperture
from geraf2.simulation import FigureSpec, ScanSpec, SceneSpec, simulate
from geraf2.simulation.population_settings import Population
from geraf2.simulation.random_objects import random_object
from geraf2.simulation.solids import build_solid
from geraf2.surfaces.isosurface import signed_distances
from inspection import print_share

mpl.use("Agg")
from matplotlib import pyplot as plt  # the backend must be chosen first

STANDOFF_M, APERTURE_M, SPACING_M, SPEED_M_PER_S = 0.39, (0.14, 0.25), 0.004, 0.1
METAL = Population(plastic=0.0, size_m=((0.05, 0.16), (0.08, 0.16), (0.11, 0.16)))
PUBLISHED_MINUTES = 24.0 * 60.0
PUBLISHED = "published: 36 planes, raster of 1 mm"


ESTIMATE = ("dog", "800", "elephant", "801", "chair", "802", "llama", "803", "shoe", "804")
"""Figures, and seeds of random objects, that the constants of `geraf2 plan` rest on."""
CLAIM = ("bunny", "10800", "deer", "10801", "hammer", "10802", "jug", "10803", "chicken", "10804")
"""Those on which its statement is checked."""


@dataclass(frozen=True, kw_only=True)
class Part:
    around: int = 0
    """Planes around the box that are taken, evenly."""
    raised: int = 0
    """Raised ones; all of them where the scan has fewer than 8."""
    above: int = 0
    arc_deg: float = 360.0
    """Planes around lie within this angle."""
    rows: int = 64
    """Rows of antennas kept, about the middle."""
    step: int = 1
    """Steps in rows and in positions."""

    def planes(self, capture: Capture) -> list[int]:
        """Which planes of the capture."""
        middles = np.array([pose.phase_centers.mean(axis=0) for pose in capture.poses])
        up = np.rad2deg(np.arcsin(middles[:, 2] / np.linalg.norm(middles, axis=1)))
        kinds = [np.flatnonzero(np.abs(up) < 10), np.flatnonzero((up > 10) & (up < 80))]
        around, raised = kinds
        if self.arc_deg < 360.0:
            angle = np.rad2deg(np.arctan2(middles[around, 1], middles[around, 0]))
            around = around[np.abs(angle) <= 0.5 * self.arc_deg + 1e-6]
        n_raised = len(raised) if self.raised and len(raised) < 8 else self.raised
        return [*evenly(around, self.around), *evenly(raised, n_raised), *np.flatnonzero(up > 80)][
            : self.around + n_raised + self.above
        ]


def evenly(planes: np.ndarray, n: int) -> list[int]:
    return [int(planes[k * len(planes) // n]) for k in range(n)]


DESIGNS = {
    "3 around": Part(around=3),
    "3 around, 1 above, 7 lines": Part(around=3, above=1, rows=56),
    "4 around, 7 lines": Part(around=4, rows=56),
    "4 around": Part(around=4),
    "6 around": Part(around=6),
    "6 around, 1 above": Part(around=6, above=1),
    "12 around": Part(around=12),
    "3 around, 1 above": Part(around=3, above=1),
    "4 around, 1 above": Part(around=4, above=1),
    "6 around, 4 raised": Part(around=6, raised=4),
    "6 around, 4 raised, 1 above": Part(around=6, raised=4, above=1),
    "12 around, 4 raised, 1 above": Part(around=12, raised=4, above=1),
    "12 around, 8 raised, 1 above": Part(around=12, raised=8, above=1),
    "4 around, 8 mm": Part(around=4, step=2),
    "12 around, 8 mm": Part(around=12, step=2),
    "three sides": Part(around=9, arc_deg=270.0),
    "two sides": Part(around=5, arc_deg=150.0),
    "one side": Part(around=3, arc_deg=90.0),
    "two sides, 1 above": Part(around=5, arc_deg=150.0, above=1),
}


def scan_of(n_around: int, n_raised: int, raised_deg: float) -> ScanFile:
    """Planes around, raised and above, as a scanner with one arm sweeps them."""
    design = Design(
        n_around=n_around,
        n_raised=n_raised,
        raised_deg=raised_deg,
        above=True,
        spacing_m=SPACING_M,
        aperture_m=APERTURE_M,
    )
    scanner = Scanner(channels=8, speed_m_per_s=SPEED_M_PER_S)
    return swept_planes(design.planes(STANDOFF_M), SPACING_M, scanner)[0]


def write_superset(path: Path) -> None:
    write_scan_file(path, scan_of(12, 8, 40.0))


def write_scenes(out: Path, objects: Iterable[str]) -> None:
    """Scan of 6 planes around and 1 above, of each object in the box."""
    scan = scan_of(6, 0, 0.0)
    for name in objects:
        folder = out / name
        if (folder / "truth.ply").is_file():
            continue
        out.mkdir(parents=True, exist_ok=True)
        if name.isdecimal():
            mesh = random_object(int(name), METAL).mesh
            write_mesh(mesh, out / f"{name}.ply")
            height = float(np.ptp(mesh.vertices[:, 2]))
            figure = FigureSpec(mesh=str(out / f"{name}.ply"), height_m=height)
        else:  # of any length from 8 to 16 cm
            length = 0.08 + 0.08 * np.random.default_rng([*name.encode()]).random()
            sides = np.ptp(build_solid(FigureSpec(name=name)).vertices, axis=0)
            figure = FigureSpec(name=name, height_m=float(length * sides[2] / sides.max()))
        spec = SceneSpec(
            figure=figure,
            walls=(Wall(size_m=(0.22, 0.22, 0.22), thickness_m=0.004, permittivity=1.6),),
            scan=replace(ScanSpec(), sweeps=scan),
        )
        capture, truth = simulate(spec, seed=1, num_threads=1)
        save_capture(capture, folder)
        write_mesh(truth, folder / "truth.ply")
        print(f"simulated {name}", flush=True)


def taken(capture: Capture, part: Part) -> Capture:
    """Planes of a capture, rows about their middle, every so many rows and positions."""
    return replace(capture, poses=tuple(cut(capture.poses[i], part) for i in part.planes(capture)))


def cut(pose: Pose, part: Part) -> Pose:
    local = (pose.phase_centers - pose.phase_centers.mean(axis=0)) @ pose.axes[1:].T
    column, row = np.round((local - local.min(axis=0)) / SPACING_M).astype(int).T
    n_rows = row.max() + 1
    below = (n_rows - min(part.rows, n_rows)) // 2
    keep = (row >= below) & (row < n_rows - below)
    keep &= (row % part.step == 0) & (column % part.step == 0)
    return pose.select(np.flatnonzero(keep))


def minutes(capture: Capture, part: Part, channels: int) -> float:
    """Of the planes as they lie, without the travel to the first."""
    scanner = Scanner(channels=channels, speed_m_per_s=SPEED_M_PER_S)
    planes = [Aperture.from_pose(pose).turn_right_handed() for pose in capture.poses]
    return (swept_planes(planes, part.step * SPACING_M, scanner)[1] - scanner.turn_s) / 60.0


def score(scene: Path, name: str, preset: str, seed: int) -> dict[str, Any]:
    part = DESIGNS[name]
    capture = taken(load_capture(scene), part)
    prior = LosPrior.from_box(capture.walls[0].size_m)
    start, cpu = time.perf_counter(), time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        result = reconstruct(capture, prior, preset, folder, num_threads=1)
        seconds, cpu_seconds = time.perf_counter() - start, time.process_time() - cpu
        mesh = result.content_mesh
    planes = [Aperture.from_pose(pose) for pose in capture.poses]
    truth = read_mesh(scene / "truth.ply")
    metrics = evaluate_mesh(mesh, truth, planes=planes, seed=seed, num_threads=1)
    return {
        "scene": scene.name,
        "design": name,
        "preset": preset,
        "minutes_8": minutes(capture, part, 8),
        "minutes_1": minutes(capture, part, 1),
        "f1": [metrics.f1(tau) for tau in (0.015, 0.005, 0.003, 0.002)],
        "volume_ratio": metrics.size.volume_ratio,
        "extents_m": metrics.size.extent_errors_m,
        "f1_5mm_by_sight": [one.scores[1].f1 for one in metrics.by_sight],
        "seen": metrics.by_sight[0].area_fraction,
        "median_m": metrics.both_ways.median_m,
        "chamfer_1e3_m2": metrics.chamfer_1e3_m2,
        **but_bottom(mesh, truth, seed),
        "expected_m": float(np.mean(mesh.expected_error_m)),
        "seconds": seconds,
        "cpu_seconds": cpu_seconds,
    }


def but_bottom(mesh: TriangleMesh, truth: TriangleMesh, seed: int) -> dict[str, float]:
    """F1 at 5 mm over all but the bottom, and the median error of the top.

    The bottom looks down within 60 degrees and lies within 15 mm of the lowest point, the top looks
    up within 30 degrees. Samples of the mesh count to the part of their nearest one of the truth.
    """
    rng = np.random.default_rng(seed)
    (on_mesh, _), (on_truth, normals) = (sampled(one, rng) for one in (mesh, truth))
    bottom = (normals[:, 2] < -0.5) & (on_truth[:, 2] < truth.vertices[:, 2].min() + 0.015)
    to_truth, nearest = KDTree(on_truth).query(on_mesh)
    to_mesh = KDTree(on_mesh).query(on_truth)[0]
    precision = np.mean(to_truth[~bottom[nearest]] < 0.005)
    recall = np.mean(to_mesh[~bottom] < 0.005)
    top = on_truth[normals[:, 2] > np.cos(np.deg2rad(30.0))]
    return {
        "f1_5mm_but_bottom": float(2 * precision * recall / (precision + recall)),
        "top_median_m": float(np.median(np.abs(signed_distances(mesh, top, num_threads=1)))),
    }


def sampled(mesh: TriangleMesh, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """10,000 points by area, and the normals of their triangles."""
    areas = face_areas(mesh.corners)
    faces = rng.choice(len(areas), 10_000, p=areas / areas.sum())
    root, v = np.sqrt(rng.random(10_000)), rng.random(10_000)
    weights = np.stack([1.0 - root, root * (1.0 - v), root * v], axis=1)
    points = np.einsum("ij,ijk->ik", weights, mesh.corners[faces])
    return points, unit_normals(mesh.corners)[faces]


def print_means(rows: Iterable[dict[str, Any]]) -> None:
    rows = list(rows)
    for preset in sorted({row["preset"] for row in rows}):
        print(
            f"\n| {preset} | objects | minutes | F1 15 / 5 / 3 / 2 mm | seen | unseen | CD, median "
            "| volume, extents mm | s | all but the bottom, top |"
        )
        for name in DESIGNS:
            here = [r for r in rows if (r["design"], r["preset"]) == (name, preset)]
            if not here:
                continue
            f1, sight = (np.mean([r[k] for r in here], axis=0) for k in ("f1", "f1_5mm_by_sight"))
            extents = " ".join(
                f"{1e3 * e:+.1f}" for e in np.mean([r["extents_m"] for r in here], 0)
            )
            median, chamfer, volume, seconds, rest, top = (
                np.mean([r[k] for r in here])
                for k in (
                    *("median_m", "chamfer_1e3_m2", "volume_ratio", "seconds"),
                    *("f1_5mm_but_bottom", "top_median_m"),
                )
            )
            each = " ".join(f"{r['scene']} {r['f1'][1]:.3f}" for r in here)
            print(
                f"| {name} | {len(here)} | {here[0]['minutes_8']:.1f}; {here[0]['minutes_1']:.1f} "
                f"| {' / '.join(f'{value:.3f}' for value in f1)} | {sight[0]:.3f} | {sight[1]:.3f} "
                f"| {chamfer:.4f}, {1e3 * median:.2f} mm | {volume:.3f}, {extents} | {seconds:.1f} "
                f"| {rest:.3f}, {1e3 * top:.2f} mm | {each}"
            )


def stated(part: Part) -> ExpectedAccuracy:
    """What `geraf2 plan` states of planes in the box."""
    design = Design(
        n_around=part.around,
        n_raised=part.raised,
        raised_deg=40.0,
        above=part.above > 0,
        spacing_m=SPACING_M,
        aperture_m=(APERTURE_M[0], min(APERTURE_M[1], (part.rows - 1) * SPACING_M)),
    )
    planes = design.planes(STANDOFF_M)
    share = seen_share(planes, np.zeros(3), np.full(3, 0.22))
    return expect_accuracy(planes, np.zeros(3), share)


def check(rows: list[dict[str, Any]], scenes: Iterable[str]) -> None:
    """Print F1 at 5 mm of scenes against the one that nine of ten are stated to reach."""
    scenes, held = list(scenes), list[bool]()
    for name, part in DESIGNS.items():
        own = [r for r in rows if r["design"] == name and r["scene"] in scenes]
        if not own:
            continue
        expected = stated(part)
        above = [r["f1"][1] >= expected.min_5mm for r in own]
        lacking = [(1.0 - r["f1"][1]) / (1.0 - expected.f1_5mm) for r in own]
        held += above
        each = " ".join(f"{r['scene']} {r['f1'][1]:.3f}" for r in own)
        print(
            f"{name:<22} stated {expected.f1_5mm:.3f}, nine of ten {expected.min_5mm:.3f}; mean "
            f"{np.mean([r['f1'][1] for r in own]):.3f}, {sum(above)} of {len(above)} above; what "
            f"lacks over what is stated: {np.quantile(lacking, 0.9):.1f} at 90 %; {each}"
        )
    print_share(held, "scans above what nine of ten are stated to reach")


def draw(rows: list[dict[str, Any]], to: Path) -> None:
    """Means over the objects against minutes; the curve goes through what nothing quicker beats."""
    plt.rcParams["svg.hashsalt"] = "scan-time"
    figure, axes = plt.subplots(figsize=(7.5, 5.2), layout="constrained")
    n_figures = len({row["scene"] for row in rows})
    around = [row for row in rows if "side" not in row["design"]]
    for preset, colour in (("fast", "tab:orange"), ("best", "tab:blue")):
        for channels, marker in ((8, "o"), (1, "s")):
            points = []
            for name in DESIGNS:
                here = [r for r in around if (r["design"], r["preset"]) == (name, preset)]
                if len(here) == n_figures:  # means of fewer cannot be compared
                    x = here[0][f"minutes_{channels}"]
                    points.append((x, float(np.mean([r["f1"][1] for r in here])), name))
            if not points:
                continue
            x, y, names = zip(*sorted(points), strict=True)
            label = f"{preset}, {channels} channel{'s' * (channels > 1)}"
            axes.plot(x, y, marker, color=colour, mfc=colour if channels > 1 else "none")
            front = [i for i in range(len(x)) if y[i] > max((0.0, *y[:i]))]
            axes.step([x[i] for i in front], [y[i] for i in front], "-", where="post", lw=1.0)
            axes.lines[-1].set(color=colour, label=label, linestyle="-" if channels > 1 else ":")
            if (preset, channels) == ("fast", 8):
                for i, name in enumerate(names):
                    if y[i] < 0.86:
                        continue
                    below = {"xytext": (4, -9), "textcoords": "offset points", "fontsize": 6}
                    axes.annotate(name, (x[i], y[i]), **below)
    axes.axvline(PUBLISHED_MINUTES, color="0.4", linestyle="--", lw=1.0)
    axes.annotate(PUBLISHED, (0.95 * PUBLISHED_MINUTES, 0.9), rotation=90, fontsize=7, ha="right")
    axes.set(xscale="log", xlabel="minutes at the scanner", ylabel="F1 at 5 mm, mean")
    axes.set(ylim=(0.86, 1.0))  # at 8 mm ghosts fill the box: far below
    axes.set_xticks([1, 2, 5, 10, 20, 60, 1440], ["1", "2", "5", "10", "20", "1 h", "24 h"])
    axes.legend(loc="lower right", fontsize=7)
    axes.grid(alpha=0.3)
    figure.savefig(to, metadata={"Date": None} if to.suffix == ".svg" else None)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    what = parser.add_subparsers(dest="what", required=True)
    what.add_parser("superset").add_argument("out", type=Path)
    scenes = what.add_parser("scenes")
    scenes.add_argument("out", type=Path)
    scenes.add_argument("--objects", nargs="+", default=[*ESTIMATE, *CLAIM])
    scores = what.add_parser("scores")
    scores.add_argument("scenes", nargs="+", type=Path)
    scores.add_argument("--out", type=Path, required=True)
    scores.add_argument("--preset", nargs="+", default=["fast"])
    scores.add_argument("--only", nargs="+", default=list(DESIGNS), choices=list(DESIGNS))
    scores.add_argument("--seed", type=int, default=0)
    checked = what.add_parser("check")
    checked.add_argument("out", type=Path)
    checked.add_argument("--objects", nargs="+", default=CLAIM)
    drawn = what.add_parser("draw")
    drawn.add_argument("out", type=Path)
    drawn.add_argument("--to", type=Path, required=True)
    options = parser.parse_args()
    if options.what == "superset":
        write_superset(options.out)
        return
    if options.what == "scenes":
        write_scenes(options.out, options.objects)
        return
    if options.what == "check":
        check(json.loads((options.out / "scores.json").read_text()), options.objects)
        return
    if options.what == "draw":
        rows = json.loads((options.out / "scores.json").read_text())
        draw(rows, options.to)
        print_means(rows)
        return
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "scores.json"
    rows = json.loads(path.read_text()) if path.is_file() else []
    done = {(row["scene"], row["design"], row["preset"]) for row in rows}
    for scene in options.scenes:
        for preset in options.preset:
            for name in options.only:
                if (scene.name, name, preset) not in done:
                    rows.append(score(scene, name, preset, options.seed))
                    print(json.dumps(rows[-1]), flush=True)
                    write_json_atomic(path, rows)
    print_means(rows)


if __name__ == "__main__":
    main()
