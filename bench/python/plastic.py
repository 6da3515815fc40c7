"""Bodies of plastic, and what comes of them.

    python bench/python/plastic.py [--out out/plastic] [--preset fast]
        [--random 41000:41008] [--ordinary 1011:1014] [--drawn 10000:10020]
        [--of metal plastic shell]

Without seeds these are solid balls in free air, whose echo is that of Mie's series: of 16 to 50 mm
and permittivity 2.7, scanned by 24 planes. For each, F1 at 5 and 3 mm and the diameter of a ball of
the mesh's volume are printed. A ball takes some seconds.

With seeds they are objects of the population, or ordinary ones, with at least twelve planes in an
ideal world, each once of metal, once of solid plastic, and once as a shell of plastic that is empty
or holds a metal object, in the same scan. `--drawn` takes objects and scans of many kinds instead,
as the completion learns from (`train_completion.py`), with 6 to 43 planes and errors of the world.
F1 at 5, 3 and 2 mm, the stated probability of a failure and what the content is taken for are
printed, with the means of each kind; for the object in a shell also the share of its surface that
has found surface within 5 mm. A scan takes about a minute. Scans are kept in `--out` and used
again.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import KDTree
from scipy.special import spherical_jn, spherical_yn

import geraf2
from geraf2.apps.benchmark.population import parse_seeds
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.errors import UserError
from geraf2.geometry.transforms import triple
from geraf2.io.manifest import DELAY_GIVEN, DELAY_KEY
from geraf2.io.mesh import TriangleMesh, read_mesh, write_mesh
from geraf2.ops.visibility import MeshScene
from geraf2.pipeline.run_record import RunOptions
from geraf2.scene import Capture, LosPrior, Pose
from geraf2.simulation import SceneSpec, WorldSpec
from geraf2.simulation.ordinary import draw_ordinary
from geraf2.simulation.population import (
    RADARS,
    WITHOUT_WAVES,
    draw_box,
    draw_scene,
    limit_to_budget,
    simulation_seconds,
)
from geraf2.simulation.population_settings import POPULATION
from geraf2.simulation.scan import scan_planes
from geraf2.simulation.solids import build_solid
from geraf2.simulation.spec import AWR1843, DisturbanceSpec, FigureSpec, ScanSpec
from train_completion import FIRST_POPULATION, draw_object

DIAMETERS_M = (0.016, 0.024, 0.036, 0.050)
INDEX = 2.7**0.5
BOX_M = (0.14, 0.14, 0.14)
MIDDLE_M = np.array([0.003, -0.002, 0.001])
SCAN = ScanSpec(n_poses=24, spacing_m=0.004)
SNR_DB = 20.0
BUDGET_S, MIN_PLANES = 25.0, 12
KINDS = ("metal", "plastic", "shell")
TRUTH_NAME, HELD_NAME = "truth.ply", "held.ply"
# Thickness of shells, and how many hold an object, one of the population from this seed on.
SHELL_M, HOLDING, HELD_SEEDS = (0.0005, 0.003), 0.5, 500_000
METAL = replace(
    POPULATION, budget_s=BUDGET_S, plastic=0.0, world=(("none", 1.0),), waves=0.0
)  # in an ideal world
# Of drawn objects: shares of scans with echoes of far walls, with errors of the world, and of
# standing objects; SNR [dB]; longest simulation with smaller and with fewer planes [CPU seconds].
FLASHING, WORLDLY, STANDING, SNRS_DB, DRAWN_S = 0.6, 0.6, 0.7, (15.0, 30.0), (12.0, 15.6)
IN_ANY_WORLD = replace(POPULATION, budget_s=20.0, plastic=0.0, waves=0.0)
CARTONS = replace(POPULATION, box_side_m=(0.10, 0.18))


def backscatter(wave_number: float, radius_m: float) -> complex:
    """Amplitude of a ball, conjugate of Bohren and Huffman's (eqs. 4.53, 4.74) [m]."""
    x = wave_number * radius_m
    n = np.arange(1, int(x + 4.0 * x ** (1 / 3) + 12))

    def riccati(f, z):
        return z * f(n, z), f(n, z) + z * f(n, z, derivative=True)

    (psi, dpsi), (chi, dchi) = riccati(spherical_jn, x), riccati(spherical_yn, x)
    xi, dxi = psi + 1j * chi, dpsi + 1j * dchi
    p, dp = riccati(spherical_jn, INDEX * x)
    a = (INDEX * p * dpsi - psi * dp) / (INDEX * p * dxi - xi * dp)
    b = (p * dpsi - INDEX * psi * dp) / (p * dxi - INDEX * xi * dp)
    return complex(np.conj(0.5 * np.sum((2 * n + 1) * (-1.0) ** n * (a - b)) / wave_number))


def capture_of(diameter_m: float) -> Capture:
    k = 2.0 * np.pi * AWR1843.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    amplitudes = np.array([backscatter(value, 0.5 * diameter_m) for value in k])
    planes, signals = scan_planes(SCAN), []
    for plane in planes:
        legs = [np.linalg.norm(end - MIDDLE_M, axis=1) for end in (plane.tx, plane.rx)]
        path = legs[0] + legs[1] + AWR1843.path_bias_m
        signals.append(amplitudes * np.exp(-1j * np.outer(path, k)) / (legs[0] * legs[1])[:, None])
    rng = np.random.default_rng(0)
    scale = np.sqrt(np.mean(np.abs(signals) ** 2))
    sigma = np.sqrt(0.5 * 10.0 ** (-SNR_DB / 10.0))
    poses = [
        Pose(
            signal=(
                signal / scale + sigma * (rng.normal(size=(*signal.shape, 2)) @ (1, 1j))
            ).astype(np.complex64),
            tx_positions=plane.tx,
            rx_positions=plane.rx,
            axes=plane.axes,
            name=f"{number}_{plane.angle_deg:g}",
            angle_deg=plane.angle_deg,
        )
        for number, (plane, signal) in enumerate(zip(planes, signals, strict=True))
    ]
    provenance = {"importer": "Mie's series", "phase_sign": "-1", DELAY_KEY: DELAY_GIVEN}
    return Capture(waveform=AWR1843, poses=tuple(poses), provenance=provenance)


def drawn_spec(seed: int, folder: Path) -> SceneSpec:
    """Scan of an object that the completion might learn from; its mesh is written into a folder."""
    rng = np.random.default_rng([seed, 11])
    kind, mesh, scan = draw_object(seed)
    if kind == "population":
        return draw_scene(FIRST_POPULATION + seed, IN_ANY_WORLD).spec
    path = folder / f"object-{seed}.ply"
    write_mesh(mesh, path)
    extents_m = np.ptp(mesh.vertices, axis=0)
    wall, center = draw_box(rng, CARTONS, extents_m, standing=bool(rng.random() < STANDING))
    clear_m = 0.5 * float(np.linalg.norm(wall.size_m)) + CARTONS.box_distance_m
    disturbance = DisturbanceSpec(
        snr_db=float(rng.uniform(*SNRS_DB)), far_walls=bool(rng.random() < FLASHING)
    )
    errors = WorldSpec(preset="plausible", effects=WITHOUT_WAVES)
    spec = SceneSpec(
        figure=FigureSpec(mesh=str(path), height_m=float(extents_m[2]), center_m=triple(center)),
        walls=(wall,),
        waveform=RADARS["AWR1843"],
        scan=replace(scan, standoff_m=max(scan.standoff_m, clear_m)),
        disturbance=disturbance,
        world=errors if rng.random() < WORLDLY else WorldSpec(),
    )
    before_s, after_s = DRAWN_S
    share = np.sqrt(min(1.0, before_s / simulation_seconds(spec, mesh)))
    width_m, height_m = (max(0.06, float(share) * side) for side in scan.aperture_m)
    scan = replace(spec.scan, aperture_m=(width_m, height_m))
    return limit_to_budget(replace(spec, scan=scan), mesh, after_s)


def ideal_spec(kind: str, seed: int) -> SceneSpec | None:
    """Scan of a random or an ordinary object in an ideal world; None with too few planes."""
    if kind == "random":
        spec = draw_scene(seed, METAL).spec
    else:
        spec = replace(draw_ordinary(seed).spec, world=WorldSpec())
    spec = limit_to_budget(spec, build_solid(spec.figure), BUDGET_S)
    return spec if spec.scan.n_planes >= MIN_PLANES else None


def drawn_scenes(kind: str, seed: int, folder: Path) -> dict[str, SceneSpec]:
    """Scenes of metal, of plastic, and of a shell of one seed; none with too few planes."""
    spec = drawn_spec(seed, folder) if kind == "drawn" else ideal_spec(kind, seed)
    if spec is None:
        return {}
    rng = np.random.default_rng([seed, 7])
    permittivity, loss = (
        float(rng.uniform(*bounds)) for bounds in (POPULATION.permittivity, POPULATION.loss_tangent)
    )
    plastic = replace(spec.world, figure_permittivity=permittivity, figure_loss_tangent=loss)
    thickness_m = float(rng.uniform(*SHELL_M))
    shell = replace(spec, world=replace(plastic, figure_shell_m=thickness_m))
    if rng.random() < HOLDING:
        shell = replace(shell, inside=held_object(spec, seed, rng))
    return {"metal": spec, "plastic": replace(spec, world=plastic), "shell": shell}


def held_object(spec: SceneSpec, seed: int, rng: np.random.Generator) -> FigureSpec:
    """Object of the population in the widest place of the figure, with a fifth of it for air."""
    outer = build_solid(spec.figure)
    low, high = outer.vertices.min(axis=0), outer.vertices.max(axis=0)
    places = rng.uniform(low, high, (4000, 3))
    places = places[MeshScene(outer.vertices, outer.faces).contains(places)]
    room = KDTree(outer.vertices).query(places)[0]
    held = FigureSpec(name=f"random-{seed + HELD_SEEDS}", height_m=1.0)
    reach = float(np.linalg.norm(build_solid(held).vertices, axis=1).max())
    height_m = 0.8 * float(room.max()) / reach
    return replace(held, height_m=height_m, center_m=triple(places[room.argmax()]))


def scan_of(spec: SceneSpec, seed: int, folder: Path) -> None:
    """Simulate a scan into a folder that has none: scene, truth, and what a shell holds."""
    if (folder / TRUTH_NAME).is_file():
        return
    folder.mkdir(parents=True, exist_ok=True)
    capture, solid = geraf2.simulate(spec, seed=seed)
    geraf2.save_capture(capture, folder / "scene", overwrite=True)
    if spec.inside is not None:
        write_mesh(build_solid(spec.inside), folder / HELD_NAME, frame="capture")
    write_mesh(solid, folder / TRUTH_NAME, frame="capture")


def run_scans(kind: str, seeds: str, options: argparse.Namespace) -> None:
    scores: dict[str, list[list[float]]] = {name: [] for name in options.of}
    for seed in parse_seeds(seeds):
        for name, spec in drawn_scenes(kind, seed, options.out).items():
            if name in options.of:
                folder = options.out / f"{kind}-{seed}-{name}"
                try:
                    scan_of(spec, seed, folder)
                except UserError as error:  # a drawn mesh that is not closed
                    print(f"{folder.name}: {error}", flush=True)
                    continue
                scores[name].append(run_scan(folder, options.preset))
    for name, rows in scores.items():
        if rows:
            mean = " ".join(f"{value:.3f}" for value in np.mean(rows, axis=0))
            print(f"{kind}, {name}, {len(rows)} scans: F1 {mean}")


def run_scan(folder: Path, preset: str) -> list[float]:
    """Reconstruct a scan; print and return F1 at 5, 3 and 2 mm."""
    try:
        run = folder / preset
        result = geraf2.reconstruct(folder / "scene", None, preset, run, overwrite=True)
    except UserError as error:
        print(f"{folder.name}: {error}", flush=True)
        return [0.0] * 3
    f1 = geraf2.evaluate(result, folder / TRUTH_NAME, report=False).f1
    found, verdict = [f1(m) for m in (0.005, 0.003, 0.002)], result.verdict
    texts = [f"{verdict.probability_of_failure:.3f} likely wrong"] if verdict else []
    is_hollow = result.numbers["glints"].get("is_hollow")
    texts.append("metal" if is_hollow is None else "a shell" if is_hollow else "solid plastic")
    if (folder / HELD_NAME).is_file():
        held = read_mesh(folder / HELD_NAME).vertices
        scene = MeshScene(result.content.vertices, result.content.faces)
        texts.append(f"of what it holds {np.mean(scene.distance(held) < 0.005):.2f} is found")
    print(f"{folder.name}: F1 " + " ".join(f"{v:.3f}" for v in found), *texts, sep=", ", flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/plastic"))
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--random", metavar="SEEDS")
    parser.add_argument("--ordinary", metavar="SEEDS")
    parser.add_argument("--drawn", metavar="SEEDS")
    parser.add_argument("--of", nargs="+", choices=KINDS, default=KINDS)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    seeds = {kind: getattr(options, kind) for kind in ("random", "ordinary", "drawn")}
    for kind, own in seeds.items():
        if own:
            run_scans(kind, own, options)
    if not any(seeds.values()):
        run_balls(options)


def run_balls(options: argparse.Namespace) -> None:
    for diameter_m in DIAMETERS_M:
        name = f"ball-{1e3 * diameter_m:.0f}"
        ball = trimesh.creation.icosphere(subdivisions=5, radius=0.5 * diameter_m)
        truth = options.out / f"{name}.ply"
        write_mesh(TriangleMesh(vertices=ball.vertices + MIDDLE_M, faces=ball.faces), truth)
        result = geraf2.reconstruct(
            capture_of(diameter_m),
            LosPrior.from_box(BOX_M),
            options.preset,
            options.out / f"{name}-{options.preset}",
            options=RunOptions(calibrate="no"),  # free air: no wall to calibrate by
            overwrite=True,
        )
        f1 = geraf2.evaluate(result, truth, report=False).f1
        width_m = np.cbrt(6.0 * abs(result.content.volume) / np.pi)
        print(f"{name}: F1 {f1(0.005):.3f} {f1(0.003):.3f}, {1e3 * width_m:.1f} mm", flush=True)


if __name__ == "__main__":
    main()
