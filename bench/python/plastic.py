"""Bodies of plastic, and what comes of them.

    python bench/python/plastic.py [--out out/plastic] [--preset fast]
        [--random 41000:41008] [--ordinary 1011:1014]

Without seeds these are solid balls in free air, whose echo is that of Mie's series: of 16 to 50 mm
and permittivity 2.7, scanned by 24 planes. For each, F1 at 5 and 3 mm and the diameter of a ball of
the mesh's volume are printed. A ball takes some seconds.

With seeds they are objects of the population, or ordinary ones, with at least twelve planes in an
ideal world, each once of metal and once of plastic in the same scan. F1 at 5, 3 and 2 mm and the
stated probability of a failure are printed, with the means of both materials. A pair takes about a
minute.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from scipy.special import spherical_jn, spherical_yn

import geraf2
from geraf2.apps.benchmark.population import parse_seeds
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.errors import UserError
from geraf2.io.manifest import DELAY_GIVEN, DELAY_KEY
from geraf2.io.mesh import TriangleMesh, write_mesh
from geraf2.pipeline.run_record import RunOptions
from geraf2.scene import Capture, LosPrior, Pose
from geraf2.simulation import SceneSpec, WorldSpec
from geraf2.simulation.ordinary import draw_ordinary
from geraf2.simulation.population import draw_scene, limit_to_budget
from geraf2.simulation.population_settings import POPULATION
from geraf2.simulation.scan import scan_planes
from geraf2.simulation.solids import build_solid
from geraf2.simulation.spec import AWR1843, ScanSpec

DIAMETERS_M = (0.016, 0.024, 0.036, 0.050)
INDEX = 2.7**0.5
BOX_M = (0.14, 0.14, 0.14)
MIDDLE_M = np.array([0.003, -0.002, 0.001])
SCAN = ScanSpec(n_poses=24, spacing_m=0.004)
SNR_DB = 20.0
BUDGET_S, MIN_PLANES = 25.0, 12
METAL = replace(
    POPULATION, budget_s=BUDGET_S, plastic=0.0, world=(("none", 1.0),), waves=0.0
)  # in an ideal world


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


def drawn_pair(kind: str, seed: int) -> dict[str, SceneSpec] | None:
    """Scenes of metal and of plastic of one seed; None with fewer than twelve planes."""
    if kind == "random":
        spec = draw_scene(seed, METAL).spec
    else:
        spec = replace(draw_ordinary(seed).spec, world=WorldSpec())
    spec = limit_to_budget(spec, build_solid(spec.figure), BUDGET_S)
    rng = np.random.default_rng([seed, 7])
    permittivity, loss = (
        float(rng.uniform(*bounds)) for bounds in (POPULATION.permittivity, POPULATION.loss_tangent)
    )
    plastic = replace(spec.world, figure_permittivity=permittivity, figure_loss_tangent=loss)
    pair = {"metal": spec, "plastic": replace(spec, world=plastic)}
    return pair if spec.scan.n_planes >= MIN_PLANES else None


def run_pairs(kind: str, seeds: str, options: argparse.Namespace) -> None:
    scores: dict[str, list[list[float]]] = {"metal": [], "plastic": []}
    for seed in parse_seeds(seeds):
        for material, spec in (drawn_pair(kind, seed) or {}).items():
            name = f"{kind}-{seed}-{material}"
            capture, solid = geraf2.simulate(spec, seed=seed)
            truth = options.out / f"{name}.ply"
            write_mesh(solid, truth, frame="capture")
            folder = options.out / f"{name}-{options.preset}"
            try:
                result = geraf2.reconstruct(capture, None, options.preset, folder, overwrite=True)
                f1 = geraf2.evaluate(result, truth, report=False).f1
                found = [f1(m) for m in (0.005, 0.003, 0.002)]
                verdict = result.verdict
                wrong = f"{verdict.probability_of_failure:.3f} likely wrong" if verdict else "-"
            except UserError as error:
                found, wrong = [0.0] * 3, str(error)
            scores[material].append(found)
            row = " ".join(f"{value:.3f}" for value in found)
            print(f"{name}: F1 {row}, {wrong}", flush=True)
    for material, rows in scores.items():
        if rows:
            mean = " ".join(f"{value:.3f}" for value in np.mean(rows, axis=0))
            print(f"{kind}, {material}, {len(rows)} scans: F1 {mean}")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/plastic"))
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--random", metavar="SEEDS")
    parser.add_argument("--ordinary", metavar="SEEDS")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for kind, seeds in (("random", options.random), ("ordinary", options.ordinary)):
        if seeds:
            run_pairs(kind, seeds, options)
    if not options.random and not options.ordinary:
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
