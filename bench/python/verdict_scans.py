"""Good and bad scans with their truth, for the verdict of a run: see `verdicts.py`.

    python bench/python/verdict_scans.py --out DIR --set estimate [--only ordinary random]

Constants are chosen on the set `estimate` and judged on the set `decide`. A set has good scans,
`ordinary` (an object in a carton with some clearance) and `random` (of the population), and bad
ones: simulated as such, or the capture of a good one, edited. DIR/NAME is a scene with truth.ply,
and DIR/NAME.json says what it is; a scene that is there is left as it is.

The echoes of all scans hold the flash of the far walls: the inner sides of all walls reflect, are
delayed by the walls, and are hidden where a ray meets the object. The world's effect `waves`
replaces this sharp shadow by that of a wave, and adds the paths by wall and object.
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

from geraf2.io.atomic import write_json_atomic
from geraf2.io.container import TRUTH_NAME
from geraf2.io.manifest import DELAY_KEY, DELAY_NOT_KNOWN
from geraf2.io.mesh import TriangleMesh, read_mesh, write_mesh
from geraf2.io.toml import from_table
from geraf2.scene import Capture, Pose, Wall, load_capture, save_capture
from geraf2.simulation import DisturbanceSpec, FigureSpec, ScanSpec, SceneSpec, WorldSpec, simulate
from geraf2.simulation.figures import FIGURES
from geraf2.simulation.population import RADARS, draw_scene, simulation_seconds
from geraf2.simulation.population_settings import POPULATION
from geraf2.simulation.solids import build_solid
from geraf2.simulation.spec import RingSpec
from geraf2.simulation.world import EFFECTS

SETS = {"estimate": 300, "decide": 30000}
"""First seed of each set's random scans."""
DATA = Path("../shared/data/meshes")
MESHES = {
    "cat": ("+y", 0),
    "fish": ("+z", 2),
    "penguin": ("+y", 1),
    "spot": ("+y", 1),
    "wingnut": ("+z", 1),
}
"""Upward axis and rounds of subdivision of each mesh file."""
N_ORDINARY, N_RANDOM, N_BAD = 12, 10, 6
BUDGET_S, WAVES_BUDGET_S = 25.0, 60.0
PLAUSIBLE = tuple(e for e in EFFECTS if e not in ("dielectric", "waves", "second_bounce"))
WORLDS = {
    "ideal": WorldSpec(),
    "plausible": WorldSpec(preset="plausible", effects=PLAUSIBLE),
    "waves": WorldSpec(wall_waves=True, multipath=True, second_bounce=True),
}
PLASTIC = WorldSpec(figure_permittivity=2.7, figure_loss_tangent=0.01)
BODIES = ("figure", "ball", "slab")
"""Solid bodies of plastic."""
PLANES_MIN, APERTURE_MIN_M = 12, 0.08


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


def figure_of(name: str, largest_m: float, turn_deg: float) -> FigureSpec:
    """Object whose largest extent is given, turned about the vertical."""
    if name in MESHES:
        up, smooth = MESHES[name]
        path = str(DATA / f"{name}.ply")
        spec = FigureSpec(mesh=path, up=up, smooth_subdivisions=smooth, turn_deg=turn_deg)
    else:
        spec = FigureSpec(name=name, turn_deg=turn_deg)
    extents = np.ptp(build_solid(spec).vertices, axis=0)
    return replace(spec, height_m=float(spec.height_m * largest_m / extents.max()))


def carton_scene(
    figure: FigureSpec,
    world: WorldSpec,
    rng: np.random.Generator,
    *,
    raised: bool,
    inner_height_m: float | None = None,
    below_m: float | None = None,
) -> tuple[SceneSpec, dict[str, Any]]:
    """An object in a carton of some clearance, and planes around it that start at any angle.

    inner_height_m: of a high carton on whose floor the object lies.
    below_m: by how much the top of the object lies below the lowest antenna.
    """
    extents = np.ptp(build_solid(figure).vertices, axis=0)
    thickness, clearance = rng.uniform(0.003, 0.005), rng.uniform(0.02, 0.05, 3)
    standing = bool(rng.random() < 0.5) or inner_height_m is not None
    inner = extents + 2.0 * clearance
    if standing:
        inner[2] = inner_height_m or extents[2] + clearance[2]
    room = np.minimum(clearance - 0.012, 0.02)
    center = rng.uniform(-1.0, 1.0, 3) * room
    if standing:
        center[2] = 0.5 * (extents[2] - inner[2]) + POPULATION.foot_gap_m
    size = inner + 2.0 * thickness
    aperture = rng.uniform(0.11, 0.13), rng.uniform(0.16, 0.19)
    if world.wall_waves:
        aperture = 0.10, 0.14
    height_m = center[2] + rng.uniform(-0.01, 0.01)
    if below_m is not None:
        height_m = center[2] + 0.5 * extents[2] + below_m + 0.5 * aperture[1]
    n_planes, start, second = int(rng.integers(16, 25)), *rng.uniform(0.0, 360.0, 2)
    n_raised = int(rng.integers(3, 6)) if raised else 0
    ring = RingSpec(
        n_poses=max(1, n_raised),
        elevation_deg=rng.uniform(25.0, 45.0),
        start_angle_deg=second,
        height_m=height_m,
    )
    wall = Wall(
        size_m=tuple(size.tolist()),
        thickness_m=thickness,
        permittivity=rng.uniform(1.5, 1.8),
        center_m=(0.0, 0.0, 0.0),
    )
    radar = "64 samples" if rng.random() < 0.5 and not world.wall_waves else "AWR1843"
    scan = ScanSpec(
        n_poses=n_planes - n_raised,
        start_angle_deg=start,
        aperture_m=aperture,
        spacing_m=0.005 if world.wall_waves else float(rng.choice([0.004, 0.005])),
        standoff_m=max(0.5 * float(np.linalg.norm(size)) + 0.04, rng.uniform(0.28, 0.40)),
        height_m=height_m,
        rings=(ring,) * bool(raised),
    )
    spec = SceneSpec(
        figure=replace(figure, center_m=tuple(center.tolist())),
        walls=(wall,),
        waveform=RADARS[radar],
        scan=scan,
        disturbance=DisturbanceSpec(snr_db=rng.uniform(15.0, 25.0)),
        world=world,
    )
    spec = within_budget(spec)
    return spec, {"standing": standing, "radar": radar, "extents_m": extents.tolist()}


def within_budget(spec: SceneSpec) -> SceneSpec:
    """Spec with fewer planes, coarser ones, then smaller ones, as its CPU time needs."""
    mesh = build_solid(spec.figure)
    budget_s = WAVES_BUDGET_S if spec.world.wall_waves else BUDGET_S
    while simulation_seconds(spec, mesh) > budget_s:
        scan = spec.scan
        width, height = scan.aperture_m
        if scan.n_planes > 16:
            smaller = replace(scan, n_poses=scan.n_poses - 1)
        elif scan.spacing_m < 0.005:
            smaller = replace(scan, spacing_m=0.005)
        elif spec.waveform.n_samples > 32:
            spec = replace(spec, waveform=RADARS["AWR1843"])
            continue
        elif scan.n_planes > PLANES_MIN:
            smaller = replace(scan, n_poses=scan.n_poses - 1)
        elif width > APERTURE_MIN_M:
            smaller = replace(scan, aperture_m=(width - 0.005, height - 0.0075))
        else:
            break
        spec = replace(spec, scan=smaller)
    return spec


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


def ordinary(figure: str, seed: int, number: int, out: Path) -> Any:
    rng = np.random.default_rng(seed)
    own = figure_of(figure, rng.uniform(0.09, 0.13), rng.uniform(0.0, 360.0))
    world = tuple(WORLDS)[number % 3]
    spec, about = carton_scene(own, WORLDS[world], rng, raised=number % 2 == 1)
    about |= {"figure": figure, "case": world}
    return simulated(spec, seed, about, walls=number // 2 % 2 == 0)


def random(seed: int, number: int, out: Path, **changes: Any) -> Any:
    population = replace(POPULATION, budget_s=BUDGET_S, waves_budget_s=WAVES_BUDGET_S, **changes)
    drawn = draw_scene(seed, population)
    record = {"case": drawn.record["world"], "radar": drawn.record["radar"]}
    return simulated(drawn.spec, seed, record, walls=number % 2 == 0)


def random_seeds(first: int) -> Iterator[int]:
    """Seeds of metal objects in a world that is not hard."""
    for seed in range(first, first + 1000):
        record = draw_scene(seed).record
        if record["material"] == "metal" and record["world"] != "hard":
            yield seed


def hard(seed: int, number: int, out: Path) -> Any:
    return random(seed, number, out, world=(("hard", 1.0),), plastic=0.0)


def out_of_height(figure: str, seed: int, number: int, out: Path) -> Any:
    """An object on the floor of a high carton, below all antennas; the scene states the carton."""
    rng = np.random.default_rng(seed)
    own = figure_of(figure, rng.uniform(0.07, 0.09), rng.uniform(0.0, 360.0))
    inner_m, below_m = rng.uniform(0.40, 0.45), rng.uniform(0.06, 0.12)
    world = ("ideal", "plausible")[number % 2]
    spec, about = carton_scene(
        own, WORLDS[world], rng, raised=False, inner_height_m=inner_m, below_m=below_m
    )
    about |= {"figure": figure, "case": world, "below_m": below_m}
    return simulated(spec, seed, about, walls=True)


def plastic(figure: str, seed: int, number: int, out: Path) -> Any:
    """A solid object of plastic: one of the figures, a ball of 16 to 50 mm, or a slab of 2 cm."""
    rng = np.random.default_rng(seed)
    body = BODIES[number % 3]
    turn_deg, path = rng.uniform(0.0, 360.0), out / "bodies" / f"{body}-{number}.ply"
    if body == "figure":
        own = figure_of(figure, rng.uniform(0.09, 0.13), turn_deg)
    else:
        height_m = rng.uniform(0.016, 0.05) if body == "ball" else rng.uniform(0.08, 0.11)
        mesh = icosphere(subdivisions=5) if body == "ball" else cuboid((0.02, 0.08, height_m))
        path.parent.mkdir(exist_ok=True)
        own = TriangleMesh(vertices=np.asarray(mesh.vertices), faces=np.asarray(mesh.faces))
        write_mesh(own, path, frame="object", made_from={})
        own = FigureSpec(mesh=str(path), height_m=height_m, turn_deg=turn_deg)
    spec, about = carton_scene(own, PLASTIC, rng, raised=number % 2 == 1)
    about |= {"figure": figure if body == "figure" else body, "case": "ideal"}
    return simulated(spec, seed, about, walls=number % 2 == 0)


# Captures that are edited: each edit gives the capture and what it did.

Edited = tuple[Capture, dict[str, Any]]


def take_few(capture: Capture, rng: np.random.Generator, number: int, about: Any) -> Edited:
    """Two to four neighbouring planes of the lower ring."""
    level = [i for i, pose in enumerate(capture.poses) if abs(pose.axes[0, 2]) < 1e-6]
    n, first = (2, 3, 2, 4, 2, 3)[number], int(rng.integers(len(level)))
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
    kept = ("case", "figure", "radar", "walls", "scene_has_walls", "n_planes", "center_m")
    about = {name: about[name] for name in kept if name in about} | {"base": base, "edit": done}
    about["scene_has_walls"] = bool(capture.walls)
    return capture, read_mesh(out / base / TRUTH_NAME), about


def scans_of(of_set: str) -> list[Scan]:
    """All scans of a set: good ones first, on which edited ones rest."""
    first = SETS[of_set]
    names = list(FIGURES)[0 if of_set == "estimate" else 1 :: 2]
    if of_set == "decide":
        names += [name for name in MESHES if (DATA / f"{name}.ply").is_file()]
    scans = []
    for number in range(max(N_ORDINARY, len(names))):
        name, again = names[number % len(names)], number // len(names)
        scans.append(
            Scan(
                name=f"ordinary-{name}" + f"-{again + 1}" * (again > 0),
                kind="ordinary",
                make=partial(ordinary, name, first + number, number),
            )
        )
    for number, seed in zip(range(N_RANDOM), random_seeds(first), strict=False):
        make = partial(random, seed, number)
        scans.append(Scan(name=f"random-{seed}", kind="random", make=make))
    good = [[s.name for s in scans if s.kind == kind] for kind in ("ordinary", "random")]
    simulations = {"height": out_of_height, "plastic": plastic}
    for at, kind in enumerate(["height", "plastic", "hard", *EDITS]):
        label = kind.replace(", ", "-").replace(" ", "-")
        for number in range(N_BAD):
            seed, cause, base = first + 1000 * (at + 1) + number, kind, ""
            figure = names[(at + number) % len(names)]
            if kind == "hard":
                make, name = partial(hard, seed, number), f"{label}-{seed}"
            elif kind in simulations:
                body = BODIES[number % 3]
                is_figure = kind == "height" or body == "figure"
                name = f"{label}-{figure}" if is_figure else f"{label}-{body}-{number}"
                make = partial(simulations[kind], figure, seed, number)
            else:
                pool = good[number >= N_BAD - 2]
                base = pool[(3 * at + 2 * number) % len(pool)]
                if kind == "saturated":  # by leakage, which only the plausible world has
                    base = good[0][(1 + 3 * number) % N_ORDINARY]
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
