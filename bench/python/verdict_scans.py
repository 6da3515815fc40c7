"""Good and bad scans with their truth, for the verdict of a run: see `verdicts.py`.

    python bench/python/verdict_scans.py --out DIR --set estimate [--only ordinary random]

Constants are chosen on the set `estimate` and judged on the set `decide`. A set has good scans,
`ordinary` (`geraf2.simulation.ordinary`) and `random` (of the population), and bad ones: simulated
as such, or the capture of a good one, edited. DIR/NAME is a scene with truth.ply, and DIR/NAME.json
says what it is; a scene that is there is left as it is.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from trimesh.creation import box as cuboid
from trimesh.creation import icosphere

from geraf2.geometry.transforms import triple
from geraf2.io.atomic import write_json_atomic
from geraf2.io.container import TRUTH_NAME
from geraf2.io.manifest import DELAY_KEY, DELAY_NOT_KNOWN
from geraf2.io.mesh import TriangleMesh, read_mesh, write_mesh
from geraf2.io.toml import from_table
from geraf2.scene import Capture, Pose, Wall, load_capture, save_capture
from geraf2.simulation import FigureSpec, SceneSpec, WorldSpec, simulate
from geraf2.simulation.ordinary import DECIDING_SEED, N_EACH, N_WAYS, OBJECTS, draw_ordinary
from geraf2.simulation.population import draw_scene, limit_to_budget
from geraf2.simulation.population_settings import POPULATION
from geraf2.simulation.solids import build_solid

SETS = {"estimate": 300, "decide": 30000}
"""First seed of each set's random scans."""
N_ORDINARY, N_RANDOM, N_BAD, N_EDITED = 16, 10, 6, 12
FEW = ("height", "plastic", "hard", "saturated")
"""Kinds with N_BAD scans: they cost more, or all end alike; the others have N_EDITED."""
BUDGET_S, WAVES_BUDGET_S = 25.0, 60.0
WITH_FLASH, WITH_ERRORS_AND_FLASH, RAISED_WITH_FLASH = 2, 3, 6
"""Ways to scan an ordinary object."""
PLASTIC = WorldSpec(figure_permittivity=2.7, figure_loss_tangent=0.01)
BODIES = ("object", "ball", "slab")
"""Solid bodies of plastic."""


@dataclass(frozen=True, kw_only=True)
class Scan:
    """A scan of a set, and how it is made."""

    name: str
    kind: str
    base: str = ""
    """Scan whose capture is edited."""
    cause: str = ""
    """Word that the right cause has; empty for a good scan."""
    make: Callable[[Path], tuple[Capture, TriangleMesh, dict[str, Any]]]
    """Gives capture, truth and parameters, from the folder of the set."""


# Scans that are simulated.


def simulated(spec: SceneSpec, seed: int, about: dict[str, Any], *, walls: bool) -> Any:
    """Capture with the true walls in its scene or without, truth, and parameters."""
    capture, truth = simulate(spec, seed=seed, num_threads=1)
    about |= {
        "seed": seed,
        "world": str(spec.world),
        "n_planes": spec.scan.n_planes,
        "raised_deg": [ring.elevation_deg for ring in spec.scan.rings],
        "aperture_m": list(spec.scan.aperture_m),
        "spacing_m": spec.scan.spacing_m,
        "standoff_m": spec.scan.standoff_m,
        "center_m": list(spec.figure.center_m),
        "walls": [asdict(wall) for wall in spec.walls],
        "scene_has_walls": walls,
    }
    return (capture if walls else replace(capture, walls=())), truth, about


def ordinary(seed: int, number: int, out: Path) -> Any:
    drawn = draw_ordinary(seed)
    return simulated(drawn.spec, seed, dict(drawn.record), walls=number // 2 % 2 == 0)


def random(seed: int, number: int, out: Path, **changes: Any) -> Any:
    population = replace(POPULATION, budget_s=BUDGET_S, waves_budget_s=WAVES_BUDGET_S, **changes)
    drawn = draw_scene(seed, population)
    return simulated(drawn.spec, seed, dict(drawn.record), walls=number % 2 == 0)


def random_seeds(first: int) -> Iterator[int]:
    """Seeds of metal objects in a world that is not hard."""
    for seed in range(first, first + 1000):
        record = draw_scene(seed).record
        if record["material"] == "metal" and record["world"] != "hard":
            yield seed


def hard(seed: int, number: int, out: Path) -> Any:
    return random(seed, number, out, world=(("hard", 1.0),), plastic=0.0)


def out_of_height(seed: int, number: int, out: Path) -> Any:
    """An object on the floor of a high carton, below all antennas; the scene states the carton."""
    drawn, rng = draw_ordinary(seed), np.random.default_rng(seed)
    spec, below_m = drawn.spec, rng.uniform(0.06, 0.12)
    wall, (x, y, _) = spec.walls[0], spec.figure.center_m
    wall = replace(wall, size_m=(*wall.size_m[:2], rng.uniform(0.40, 0.45)))
    height_m = drawn.record["extents_m"][2]
    floor_m = wall.thickness_m - 0.5 * wall.size_m[2] + POPULATION.foot_gap_m
    clear_m = 0.5 * float(np.linalg.norm(wall.size_m)) + POPULATION.box_distance_m
    spec = replace(
        spec,
        figure=replace(spec.figure, center_m=(x, y, floor_m + 0.5 * height_m)),
        walls=(wall,),
        scan=replace(
            spec.scan,
            height_m=floor_m + height_m + below_m + 0.5 * spec.scan.aperture_m[1],
            standoff_m=max(spec.scan.standoff_m, clear_m),
        ),
    )
    about = {"object": drawn.record["object"], "below_m": below_m}
    return simulated(within_budget(spec), seed, about, walls=True)


def plastic(seed: int, number: int, out: Path) -> Any:
    """A solid object of plastic: an ordinary one, a ball of 16 to 50 mm, or a slab of 2 cm."""
    drawn, rng = draw_ordinary(seed), np.random.default_rng(seed)
    body, own, wall = BODIES[number % 3], drawn.spec.figure, drawn.spec.walls[0]
    if body != "object":
        height_m = rng.uniform(0.016, 0.05) if body == "ball" else rng.uniform(0.08, 0.11)
        mesh = icosphere(subdivisions=5) if body == "ball" else cuboid((0.02, 0.08, height_m))
        path = out / "bodies" / f"{body}-{number}.ply"
        path.parent.mkdir(exist_ok=True)
        solid = TriangleMesh(vertices=np.asarray(mesh.vertices), faces=np.asarray(mesh.faces))
        write_mesh(solid, path, frame="object", made_from={})
        middle = (0.0, 0.0, 0.0)
        own = FigureSpec(mesh=str(path), height_m=height_m, turn_deg=own.turn_deg, center_m=middle)
        least = np.ptp(build_solid(own).vertices, axis=0) + 2.0 * POPULATION.clearance_m[1]
        wall = replace(wall, size_m=triple(np.maximum(wall.size_m, least)))
    spec = within_budget(replace(drawn.spec, figure=own, walls=(wall,), world=PLASTIC))
    about = {"object": drawn.record["object"] if body == "object" else body}
    return simulated(spec, seed, about, walls=number % 2 == 0)


def within_budget(spec: SceneSpec) -> SceneSpec:
    """Spec with fewer and smaller planes where its simulation would take longer than others."""
    return limit_to_budget(spec, build_solid(spec.figure), BUDGET_S)


# Captures that are edited: each edit gives the capture and what it did.

Edited = tuple[Capture, dict[str, Any]]


def take_few(capture: Capture, rng: np.random.Generator, number: int, about: Any) -> Edited:
    """Two to four neighbouring planes of the lower ring."""
    level = [i for i, pose in enumerate(capture.poses) if abs(pose.axes[0, 2]) < 1e-6]
    n, first = (2, 3, 2, 4, 2, 3)[number % 6], int(rng.integers(len(level)))
    used = [level[(first + i) % len(level)] for i in range(n)]
    return replace(capture, poses=tuple(capture.poses[i] for i in used)), {"planes": used}


def shift_delay(
    walls: bool, capture: Capture, rng: np.random.Generator, number: int, about: Any
) -> Edited:
    """A recorded delay that is wrong, with the walls in the scene or without."""
    error_m = float(rng.uniform(0.05, 0.20)) * (-1.0) ** number
    known = tuple(from_table(wall, Wall, None) for wall in about["walls"]) if walls else ()
    wave = replace(capture.waveform, path_bias_m=capture.waveform.path_bias_m + error_m)
    about = {"delay_error_m": error_m, "scene_has_walls": walls}
    return replace(capture, waveform=wave, walls=known), about


def omit_delay(capture: Capture, rng: np.random.Generator, number: int, about: Any) -> Edited:
    """No recorded delay, as an import without `path_bias_m` leaves it."""
    wave = replace(capture.waveform, path_bias_m=0.0)
    origin = capture.provenance | {DELAY_KEY: DELAY_NOT_KNOWN}
    about = {"delay_error_m": -capture.waveform.path_bias_m}
    return replace(capture, waveform=wave, provenance=origin), about


def turn_back(capture: Capture, rng: np.random.Generator, number: int, about: Any) -> Edited:
    """The angle of each plane negated: the plane is turned about z with its axes."""

    def back(pose: Pose) -> Pose:
        x, y, _ = pose.phase_centers.mean(axis=0)
        angle = np.arctan2(y, x) if pose.angle_deg is None else np.deg2rad(pose.angle_deg)
        cos, sin = np.cos(-2.0 * angle), np.sin(-2.0 * angle)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return replace(
            pose,
            tx_positions=pose.tx_positions @ turn.T,
            rx_positions=pose.rx_positions @ turn.T,
            axes=pose.axes @ turn.T,
            angle_deg=float(-np.rad2deg(angle)),
        )

    return replace(capture, poses=tuple(back(pose) for pose in capture.poses)), {}


def mirror_axes(capture: Capture, rng: np.random.Generator, number: int, about: Any) -> Edited:
    """Columns of each plane reversed: antennas mirrored across its vertical middle line."""

    def mirrored(pose: Pose) -> Pose:
        middle, across = pose.phase_centers.mean(axis=0), pose.axes[1]
        tx, rx = (
            points - 2.0 * ((points - middle) @ across)[:, None] * across
            for points in (pose.tx_positions, pose.rx_positions)
        )
        return replace(pose, tx_positions=tx, rx_positions=rx)

    return replace(capture, poses=tuple(mirrored(pose) for pose in capture.poses)), {}


def swap_planes(capture: Capture, rng: np.random.Generator, number: int, about: Any) -> Edited:
    """Recordings of half of the planes to all of them, exchanged in a circle."""
    n = round((0.5, 0.75, 1.0)[number % 3] * len(capture.poses))
    n_antennas = capture.pose_sizes
    same = np.flatnonzero(np.equal(n_antennas, np.bincount(n_antennas).argmax()))
    used = rng.permutation(same)[:n].tolist()
    poses = list(capture.poses)
    for to, by in zip(used, used[1:] + used[:1], strict=True):
        poses[to] = replace(capture.poses[to], signal=capture.poses[by].signal)
    return replace(capture, poses=tuple(poses)), {"swapped": used}


def saturate(capture: Capture, rng: np.random.Generator, number: int, about: Any) -> Edited:
    """I and Q clipped at a share of their peak.

    Without leakage no share hurts: even of one bit, a scan with an F1 of 0.84 keeps 0.80 to 0.84.
    """
    share = (0.1, 0.05, 0.02)[number % 3]
    parts = [pose.signal.view(np.float32) for pose in capture.poses]
    level = np.float32(share * max(float(np.abs(part).max()) for part in parts))
    poses = tuple(
        replace(pose, signal=np.clip(part, -level, level).view(np.complex64))
        for pose, part in zip(capture.poses, parts, strict=True)
    )
    clipped = float(np.mean([np.mean(np.abs(part) >= level) for part in parts]))
    return replace(capture, poses=poses), {"clip_share": share, "clipped": clipped}


EDITS: dict[str, tuple[str, Callable[..., Edited]]] = {
    "few planes": ("few planes", take_few),
    "delay": ("delay", partial(shift_delay, False)),
    "delay, walls known": ("delay", partial(shift_delay, True)),
    "delay not recorded": ("delay", omit_delay),
    "sense": ("sense", turn_back),
    "axes": ("axes", mirror_axes),
    "swapped": ("swapped", swap_planes),
    "saturated": ("saturated", saturate),
}
"""Kinds of bad scans that are edited, each with the word of its cause."""


def edited(kind: str, base: str, seed: int, number: int, out: Path) -> Any:
    about = json.loads((out / f"{base}.json").read_text())
    capture = load_capture(out / base).load()
    capture, done = EDITS[kind][1](capture, np.random.default_rng(seed), number, about)
    kept = ("object", "radar", "walls", "scene_has_walls", "n_planes", "center_m")
    about = {name: about[name] for name in kept if name in about} | {"base": base, "edit": done}
    about["scene_has_walls"] = bool(capture.walls)
    return capture, read_mesh(out / base / TRUTH_NAME), about


def ordinary_seed(of_set: str, number: int, way: int) -> tuple[int, str]:
    """Seed of an ordinary scan of a set, and the name of its object."""
    decides, own = of_set == "decide", number % N_EACH
    return DECIDING_SEED * decides + own + N_EACH * way, OBJECTS[N_EACH * decides + own]


def scans_of(of_set: str) -> list[Scan]:
    """All scans of a set: good ones first, on which edited ones rest."""
    first, scans, with_leakage = SETS[of_set], [], []
    for number in range(N_ORDINARY):  # each object in two ways, and each way with two objects
        way = (3 * number + number // N_EACH) % N_WAYS
        seed, of = ordinary_seed(of_set, number, way)
        make, name = partial(ordinary, seed, number), f"ordinary-{of}-{way}"
        scans.append(Scan(name=name, kind="ordinary", make=make))
        with_leakage += [name] * (way % 2)  # an error of the world
    for number, seed in zip(range(N_RANDOM), random_seeds(first), strict=False):
        make = partial(random, seed, number)
        scans.append(Scan(name=f"random-{seed}", kind="random", make=make))
    good = [[s.name for s in scans if s.kind == kind] for kind in ("ordinary", "random")]
    for at, kind in enumerate(["height", "plastic", "hard", *EDITS]):
        label = kind.replace(", ", "-").replace(" ", "-")
        for number in range(N_BAD if kind in FEW else N_EDITED):
            seed, cause, base = first + 1000 * (at + 1) + number, kind, ""
            if kind == "height":
                seed, of = ordinary_seed(
                    of_set, number, (WITH_FLASH, WITH_ERRORS_AND_FLASH)[number % 2]
                )
                make, name = partial(out_of_height, seed, number), f"{label}-{of}"
            elif kind == "plastic":
                seed, of = ordinary_seed(
                    of_set, 2 + number, (WITH_FLASH, RAISED_WITH_FLASH)[number % 2]
                )
                body = BODIES[number % 3]
                name = f"{label}-{of if body == 'object' else body}-{number}"
                make = partial(plastic, seed, number)
            elif kind == "hard":
                make, name = partial(hard, seed, number), f"{label}-{seed}"
            else:
                pool = good[number % 6 > 3]
                base = pool[(3 * at + 2 * number + number // 6) % len(pool)]
                if kind == "saturated":
                    base = with_leakage[number]
                name, cause = f"{label}-{base}-{number}", EDITS[kind][0]
                make = partial(edited, kind, base, seed, number)
            scans.append(Scan(name=name, kind=kind, base=base, cause=cause, make=make))
    return scans


def make(out: Path, of_set: str, kinds: list[str]) -> None:
    out.mkdir(parents=True, exist_ok=True)
    for scan in scans_of(of_set):
        folder, record = out / scan.name, out / f"{scan.name}.json"
        if record.is_file() or (kinds and scan.kind not in kinds):
            continue
        if scan.base and not (out / f"{scan.base}.json").is_file():
            print(f"{scan.name}: left out, {scan.base} is not there yet", flush=True)
            continue
        start = time.process_time()
        capture, truth, about = scan.make(out)

        def write_truth(scene: Path, truth: TriangleMesh = truth) -> None:
            write_mesh(truth, scene / TRUTH_NAME, frame="capture", made_from={})

        save_capture(capture, folder, overwrite=True, extras=write_truth)
        cpu_s = round(time.process_time() - start, 1)
        row = {"name": scan.name, "kind": scan.kind, "set": of_set, "cause": scan.cause}
        row |= {"truth": f"{scan.name}/{TRUTH_NAME}", "cpu_s": cpu_s, **about}
        write_json_atomic(record, row)
        print(f"{scan.name}: {cpu_s} CPU seconds", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the set")
    parser.add_argument("--set", choices=SETS, required=True)
    parser.add_argument("--only", nargs="+", default=[], metavar="KIND")
    given = parser.parse_args()
    make(given.out, given.set, given.only)


if __name__ == "__main__":
    main()
