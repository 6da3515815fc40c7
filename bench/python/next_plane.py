"""Six planes of which each is proposed after the ones before, against nine even ones around.

    python bench/python/next_plane.py run ROWS [--seeds 40 41 42] [--preset fast]
    python bench/python/next_plane.py recorded ROWS SCENE... [--preset fast]
    python bench/python/next_plane.py show ROWS

`run` puts objects of the population (`geraf2.simulation.population`) into a box in a plausible
world, without walls that send waves as nine of ten scans of it: those take 10 s a plane. A session
begins with two opposite planes, and four times the plane that it proposes is simulated and added.
All six are then simulated again as one scan. It appends a line for each object to the file ROWS,
with angles of the planes. `recorded` chooses from the planes of scenes with a truth.ply and the box
in los.ply, which takes a tenth of the time: they were recorded all around. `show` prints means,
and their difference with a bootstrap interval.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import geraf2
from geraf2.apps.live.follow import proposed_plane
from geraf2.apps.planning.next_plane import expected_errors
from geraf2.apps.planning.scan_time import Scanner, plane_at, swept_planes
from geraf2.evaluation.mesh_metrics import evaluate_mesh
from geraf2.io.mesh import read_mesh
from geraf2.scene.aperture import Aperture
from geraf2.simulation import SceneSpec, simulate
from geraf2.simulation.population import draw_scene
from geraf2.simulation.spec import parse_spec
from geraf2.simulation.world import EFFECTS
from live import even_order, f1_of

APERTURE_M, SPACING_M, STANDOFF_M = (0.16, 0.20), 0.005, 0.35
BOX_M, LARGEST_M = (0.20, 0.20, 0.20), 0.17
N_CHOSEN, N_EVEN = 6, 9
WORLD = [effect for effect in EFFECTS if effect not in ("dielectric", "waves", "second_bounce")]


def spec_of(seed: int) -> SceneSpec:
    height_m = float(np.random.default_rng(seed).uniform(0.09, 0.15))
    extents_m = np.array(draw_scene(seed).record["extents_m"])
    height_m = min(height_m, LARGEST_M * float(extents_m[2] / extents_m.max()))
    return parse_spec(
        {
            "figure": {"name": f"random-{seed}", "height_m": height_m},
            "walls": [{"size_m": BOX_M}],
            "numerics": {"wall_patch_m": 0.008},
            "world": {"preset": "plausible", "effects": list(WORLD)},
        }
    )


def even(n: int) -> list[Aperture]:
    half = 0.5 * np.asarray(APERTURE_M)
    return [plane_at(2.0 * np.pi * k / n, 0.0, STANDOFF_M, half) for k in range(n)]


def scanned(spec: SceneSpec, planes: Sequence[Aperture], seed: int):
    """Capture of these planes, and the true object."""
    sweeps, _ = swept_planes(planes, SPACING_M, Scanner())
    return simulate(replace(spec, scan=replace(spec.scan, sweeps=sweeps)), seed=seed)


def chosen(spec: SceneSpec, seed: int, preset: str) -> tuple[list[Aperture], list]:
    """Two opposite planes and those that a session proposes after them; angles of these [deg]."""
    planes, angles = even(2), []
    capture, _ = scanned(spec, planes, seed)
    with geraf2.Session(capture, BOX_M, preset) as session:
        while len(planes) < N_CHOSEN:
            _ = session.result
            best = proposed_plane(session)
            assert best is not None
            planes.append(best.plane)
            angles.append((best.azimuth_deg, best.elevation_deg))
            one, _ = scanned(spec, planes[-1:], seed)  # the same box, turned and bulged
            session.add(replace(one.poses[0], name=f"{len(planes)}"))
    return planes, angles


def run(rows: Path, seeds: Sequence[int], preset: str) -> None:
    for seed in seeds:
        spec, row = spec_of(seed), {"seed": seed, "preset": preset}
        six, row["angles"] = chosen(spec, seed, preset)
        for name, planes in (("chosen", six), ("even", even(N_EVEN))):
            capture, truth = scanned(spec, planes, seed)
            mesh = geraf2.reconstruct(capture, BOX_M, preset).content_mesh
            scores = evaluate_mesh(mesh, truth, n_samples=20_000, thresholds_m=(0.005,)).scores
            row[name] = round(float(scores[0].f1), 4)
        print(json.dumps(row), flush=True)
        with rows.open("a") as file:
            file.write(json.dumps(row) + "\n")


def recorded(rows: Path, scene: Path, preset: str) -> None:
    capture, truth = geraf2.load_capture(scene), read_mesh(scene / "truth.ply")
    planes = [Aperture.from_pose(pose) for pose in capture.poses]
    order = even_order(len(planes))

    def result(chosen: Sequence[int]) -> geraf2.Reconstruction:
        poses = tuple(capture.poses[k] for k in sorted(chosen))
        return geraf2.reconstruct(replace(capture, poses=poses), scene / "los.ply", preset)

    six = order[:2]
    while len(six) < N_CHOSEN:
        now, left = result(six), [k for k in order if k not in six]
        those, others = ([planes[k] for k in numbers] for numbers in (six, left))
        center = np.asarray(now.prior.center_m)
        _, after = expected_errors(now.content_mesh, those, others, center)
        six.append(left[int(after.argmin())])
    row = {"scene": scene.name, "preset": preset, "planes": six}
    for name, chosen in (("chosen", six), ("even", order[:N_EVEN])):
        row[name] = round(f1_of(result(chosen).content_mesh, truth), 4)
    print(json.dumps(row), flush=True)
    with rows.open("a") as file:
        file.write(json.dumps(row) + "\n")


def show(rows: Path) -> None:
    read = [json.loads(line) for line in rows.read_text().splitlines()]
    six, nine = (np.array([row[name] for row in read]) for name in ("chosen", "even"))
    drawn = np.random.default_rng(0).integers(0, len(read), (4000, len(read)))
    low, high = np.quantile((six - nine)[drawn].mean(axis=1), (0.025, 0.975))
    print(f"F1 5 mm of {len(read)} objects: {N_CHOSEN} chosen {six.mean():.3f}, ", end="")
    print(f"{N_EVEN} even {nine.mean():.3f}")
    print(f"difference {(six - nine).mean():+.3f} ({low:+.3f} to {high:+.3f})")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("run", "recorded", "show"))
    parser.add_argument("rows", type=Path)
    parser.add_argument("scenes", type=Path, nargs="*")
    parser.add_argument("--seeds", type=int, nargs="*", default=list(range(40, 60)))
    parser.add_argument("--preset", default="fast")
    given = parser.parse_args()
    if given.what == "run":
        run(given.rows, given.seeds, given.preset)
    elif given.what == "recorded":
        for scene in given.scenes:
            recorded(given.rows, scene, given.preset)
    else:
        show(given.rows)


if __name__ == "__main__":
    main()
