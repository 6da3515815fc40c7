"""Whether balls of the size that geraf2 states to be detectable are found.

    python bench/python/detectability.py --out out/detectability [--first 10100] [--scans 20]
    python bench/python/detectability.py --out out/detectability --fit --scans 16

A scan of a random metal object in a carton (8 planes and 4 raised ones or 12 planes, at 5 mm, 64
samples, 0 to 25 dB) is simulated once. The echoes of eight balls at random places, behind the
object too, are simulated apart and added. A ball is found if at least three glints that geraf2
takes for content lie within 10 mm of it, and more than twice as many as without it. Its radius is
the one that is stated for its place from the scan without balls, and half of that. Shares come with
Wilson intervals (95 %). With `--fit` radii are drawn, and the margin over the radius at which half
of them are found is printed. `--plastic` adds balls of plastic instead of metal. Seeds below 1000
and those to 10010 are for choices, those from 10100 on for claims. Scans are kept in `--out` and
used again.
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from scipy.optimize import minimize
from scipy.spatial import KDTree

import geraf2
from geraf2.echoes.detectability import LEAST_RADIUS_M, Detector
from geraf2.echoes.glints import GlintConfig, find_echoes
from geraf2.echoes.reflectivity import face_reflection
from geraf2.echoes.ruled_out import PLASTIC
from geraf2.geometry.transforms import triple
from geraf2.imaging.peaks import collect_peaks
from geraf2.io.mesh import TriangleMesh, read_mesh, write_mesh
from geraf2.ops.physical_optics import AntennaBlocks
from geraf2.ops.visibility import MeshScene
from geraf2.simulation.echo import EchoScene, Layer, plane_echo, wall_layers
from geraf2.simulation.elements import mesh_elements
from geraf2.simulation.population_settings import Population
from geraf2.simulation.random_objects import random_object
from geraf2.simulation.ray_tubes import SmoothMesh, TubeScene
from geraf2.simulation.scan import ScanPlane, antenna_blocks, scan_planes
from geraf2.simulation.spec import (
    AWR1843,
    DisturbanceSpec,
    FigureSpec,
    RingSpec,
    ScanSpec,
    SceneSpec,
)
from inspection import print_share

METAL = Population(plastic=0.0, size_m=((0.05, 0.09), (0.07, 0.1), (0.08, 0.11)))
WAVEFORM = replace(AWR1843, n_samples=64, sample_rate_hz=1.25e6)
WALL_M, N_BALLS, NEAR_M, APART_M = 0.004, 8, 0.01, 0.045
_LOSS_TANGENT = 0.01
_LARGEST_M = 0.02
"""Largest radius of a ball [m]."""
_MARGIN_M, _CLEAR_M = 0.025, 0.02
"""Least distance of a ball's centre from the outside of the box, and from the object."""


def spec_of(seed: int, folder: Path) -> SceneSpec:
    rng = np.random.default_rng([seed, 21])
    mesh = random_object(seed, METAL).mesh
    sides = np.maximum(np.ptp(mesh.vertices, axis=0) + 0.06, rng.uniform(0.15, 0.22, 3))
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    write_mesh(mesh, folder / "truth.ply")
    rings = (RingSpec(n_poses=4, elevation_deg=35.0, start_angle_deg=15.0),) * (seed % 2)
    room = 0.5 * (sides - np.ptp(mesh.vertices, axis=0)) - 0.02
    return SceneSpec(
        figure=FigureSpec(
            mesh=str(folder / "truth.ply"),
            height_m=float(high[2] - low[2]),
            center_m=triple(room * rng.uniform(-1.0, 1.0, 3)),
        ),
        walls=(geraf2.Wall(size_m=triple(sides), thickness_m=WALL_M, permittivity=1.6),),
        waveform=WAVEFORM,
        scan=ScanSpec(
            n_poses=12 if seed % 2 == 0 else 8,
            spacing_m=0.005,
            aperture_m=(0.13, 0.21),
            standoff_m=0.36,
            rings=rings,
        ),
        disturbance=DisturbanceSpec(snr_db=float(rng.uniform(0.0, 25.0))),
    )


def base_scan(seed: int, folder: Path) -> tuple[geraf2.Capture, TriangleMesh, SceneSpec]:
    spec = spec_of(seed, folder)
    if not (folder / "scene").is_dir():
        capture, truth = geraf2.simulate(spec, seed=seed, num_threads=1)
        geraf2.save_capture(capture, folder / "scene")
        write_mesh(truth, folder / "placed.ply")
    return geraf2.load_capture(folder / "scene").load(), read_mesh(folder / "placed.ply"), spec


class Adder:
    """Echoes of further metal bodies in a simulated scan."""

    def __init__(self, capture: geraf2.Capture, truth: TriangleMesh, spec: SceneSpec) -> None:
        self.capture, self.truth, self.spec = capture, truth, spec
        self.planes = scan_planes(spec.scan)
        # The simulator scales all samples by one number: that of the first plane.
        made = self._echo(truth, self.planes[0], walls=True)
        own = capture.poses[0].signal
        self.unit = float(np.vdot(made, own).real / np.vdot(made, made).real)

    def _echo(
        self,
        body: TriangleMesh,
        plane: ScanPlane,
        *,
        walls: bool = False,
        permittivity: float = 0.0,
    ) -> np.ndarray:
        whole = TriangleMesh.joined([self.truth, body]) if body is not self.truth else body
        facets, areas = mesh_elements(body.vertices, body.faces, 0.0012)
        layers = wall_layers(self.spec.walls, self.spec.numerics.wall_patch_m) if walls else ()
        tubes = None
        if permittivity:
            areas = abs(face_reflection(permittivity)) * areas
            tubes = TubeScene(
                mesh=SmoothMesh(MeshScene(body.vertices, body.faces, num_threads=1)),
                walls=self.spec.walls,
                waveform=self.capture.waveform,
                wall_amplitude=1.0,
            )
        scene = EchoScene(
            tubes=tubes,
            permittivity=permittivity,
            loss_tangent=_LOSS_TANGENT,
            waveform=self.capture.waveform,
            walls=self.spec.walls,
            blocker=MeshScene(whole.vertices, whole.faces, num_threads=1),
            figure=Layer(elements=facets, areas=areas),
            wall_layers=layers,
            num_threads=1,
        )
        order, offsets = antenna_blocks(plane, self.spec.numerics.antenna_block_m)
        antennas = AntennaBlocks(
            tx=plane.tx[order], rx=plane.rx[order], offsets=offsets, boresight=plane.axes[0]
        )
        echo = plane_echo(scene, antennas).reorder(np.argsort(order))
        return np.asarray(echo.figure + echo.walls)

    def with_balls(
        self, centers: np.ndarray, radii: np.ndarray, permittivity: float
    ) -> geraf2.Capture:
        balls = TriangleMesh.joined([ball(c, r) for c, r in zip(centers, radii, strict=True)])
        poses = tuple(
            replace(
                pose,
                signal=(
                    pose.signal + self.unit * self._echo(balls, plane, permittivity=permittivity)
                ).astype(np.complex64),
            )
            for pose, plane in zip(self.capture.poses, self.planes, strict=True)
        )
        return replace(self.capture, poses=poses)


def ball(center: np.ndarray, radius: float) -> TriangleMesh:
    # Edges of at most 1.1 mm.
    made = trimesh.creation.icosphere(subdivisions=3 if radius < 0.008 else 4, radius=radius)
    return TriangleMesh(vertices=made.vertices + center, faces=made.faces)


def places(rng: np.random.Generator, spec: SceneSpec, scene: MeshScene) -> np.ndarray:
    """Centres of balls, clear of each other, the object and the walls."""
    half, found = 0.5 * np.array(spec.walls[0].size_m) - _MARGIN_M, list[np.ndarray]()
    for _ in range(4000):
        at = rng.uniform(-1.0, 1.0, 3) * half
        clear = all(np.linalg.norm(at - other) > APART_M for other in found)
        clear = clear and not scene.contains(at[None])[0] and scene.distance(at[None])[0] > _CLEAR_M
        if clear and len(found) < N_BALLS:
            found.append(at)
    return np.array(found).reshape(-1, 3)


class Seen:
    """Glints of a scan."""

    def __init__(self, capture: geraf2.Capture, prior: geraf2.LosPrior) -> None:
        config = GlintConfig()
        self.peaks = collect_peaks(
            capture, prior, config.subaperture, config.noise_margin_db, num_threads=1
        )
        found = find_echoes(capture, prior, config, peaks=self.peaks, num_threads=1)
        self.glints, self.metal, self.clutter = found.glints, found.metal, found.clutter

    def counts(self, centers: np.ndarray, radii: np.ndarray) -> np.ndarray:
        """Glints within 10 mm of each ball's surface or centre."""
        near = KDTree(self.glints.positions).query_ball_point(centers, NEAR_M + radii)
        return np.array([len(one) for one in near])


def scan_rows(seed: int, options: argparse.Namespace) -> list[dict]:
    """What became of each ball of a scan."""
    folder = options.out / str(seed)
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng([seed, 22])
    capture, truth, spec = base_scan(seed, folder)
    prior = geraf2.LosPrior.from_box(spec.walls[0].size_m, walls=spec.walls)
    base = Seen(capture, prior)
    if base.metal is None:
        print(f"  {seed}: the walls show no level of metal")
        return []
    scene = MeshScene(truth.vertices, truth.faces, num_threads=1)
    centers = places(rng, spec, scene)
    detector = Detector.of(
        capture, prior, base.peaks, GlintConfig(), base.metal.strength_m, base.clutter
    )
    start = time.process_time()
    stated, seconds = detector.smallest_radii(centers, scene), time.process_time() - start
    adder, rows = Adder(capture, truth, spec), list[dict]()
    for kind in ("drawn", "drawn again") if options.fit else ("stated", "half"):
        radii = stated * (1.0 if kind == "stated" else 0.5)
        if options.plastic:
            radii = radii / abs(face_reflection(PLASTIC))
        if options.fit:
            radii = np.exp(rng.uniform(np.log(0.0004), np.log(0.01), len(centers)))
        usable = np.flatnonzero(radii < _LARGEST_M)
        there, radii = centers[usable], radii[usable]
        before = base.counts(there, radii)
        after = Seen(adder.with_balls(there, radii, PLASTIC * options.plastic), prior).counts(
            there, radii
        )
        rows += [
            {
                "seed": seed,
                "kind": kind,
                "radius_m": float(radii[n]),
                "at_floor": bool(stated[k] <= LEAST_RADIUS_M),
                "found": bool(after[n] >= 3 and after[n] > 2 * before[n]),
                "stated_m": float(stated[k]),
            }
            for n, k in enumerate(usable)
        ]
    each = " ".join(f"{1e3 * r['radius_m']:.1f}{'-+'[r['found']]}" for r in rows)
    level = f"metal +- {base.metal.sigma_db:.1f} dB, stated in {seconds:.2f} s"
    print(f"  {seed}: {level}, radii in mm {each}", flush=True)
    return rows


def choose_margin(rows: list[dict]) -> None:
    """Print over which radius, against the stated one, half and 19 of 20 balls are found."""
    found = np.array([row["found"] for row in rows])
    over = np.array([20.0 * np.log10(row["radius_m"] / row["stated_m"]) for row in rows])
    over = np.clip(over, -60.0, 60.0)

    def loss(model: np.ndarray) -> float:
        share = 0.01 + 0.98 / (1.0 + np.exp(-(over - model[0]) / np.exp(model[1])))
        return -float(np.log(np.where(found, share, 1.0 - share)).sum())

    starts = [minimize(loss, [x, 0.5], method="Nelder-Mead") for x in (-12.0, -6.0, 0.0)]
    best = min(starts, key=lambda one: one.fun)
    sure_db = best.x[0] + np.log(19.0) * np.exp(best.x[1])
    print(
        f"loss {best.fun:.1f}: half are found at {best.x[0]:.1f} dB over the stated radius, 19 of "
        f"20 at {sure_db:.1f} dB"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/detectability"))
    parser.add_argument("--first", type=int)
    parser.add_argument("--scans", type=int, default=20)
    parser.add_argument("--fit", action="store_true", help="choose the constants")
    parser.add_argument("--plastic", action="store_true", help="balls of plastic")
    options = parser.parse_args()
    first = options.first if options.first is not None else (0 if options.fit else 10_100)
    rows = []
    for seed in range(first, first + options.scans):
        rows += scan_rows(seed, options)
        name = "fit" if options.fit else "plastic" if options.plastic else "metal"
        (options.out / f"{name}.json").write_text(json.dumps(rows))
    for kind in sorted({row["kind"] for row in rows}):
        own = [row for row in rows if row["kind"] == kind]
        print_share([row["found"] for row in own], f"balls of the {kind} size found")
        above = [row["found"] for row in own if not row["at_floor"]]
        print_share(above, f"  those above the floor of {2e3 * LEAST_RADIUS_M:g} mm")
    if options.fit:
        choose_margin(rows)


if __name__ == "__main__":
    main()
