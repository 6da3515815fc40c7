"""What `geraf2 inspect` takes the parts in a box to be made of.

    python bench/python/materials.py --out out/materials [--first 0] [--boxes 20] [--planes 12]

A box holds two to four bodies of the population, 3 to 5 cm long, with gaps of 5 to 20 mm. All of
them are metal in even seeds and plastic of permittivity 2.3 to 3.3 in odd ones, because the
simulator knows one material a scene. World plausible. Scenes and runs are kept in `--out` and used
again, so that a stopped script continues; `--cached` makes nothing new. Seeds below 1000 and 10000
to 10039 are for choices, those from 10040 on for claims. Shares come with Wilson intervals (95 %).
"""

import argparse
from collections import Counter
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

import geraf2
from compare_pairs import CLEARANCE_M, WALL_M, scan_parser, scan_spec
from geraf2.geometry.transforms import triple
from geraf2.io.mesh import TriangleMesh
from geraf2.simulation.population_settings import Population
from geraf2.simulation.random_objects import random_object
from inspection import kept_run, print_share

SINGLE = Population(bodies=(("1", 1.0),))
_LENGTH_M, _GAP_M, _PERMITTIVITY = (0.03, 0.05), (0.005, 0.02), (2.3, 3.3)


def content(rng: np.random.Generator) -> list[TriangleMesh]:
    """Bodies, each pushed towards the others until the gap is as drawn."""
    placed: list[TriangleMesh] = []
    for _ in range(int(rng.integers(2, 4, endpoint=True))):
        mesh = random_object(int(rng.integers(10**9)), SINGLE).mesh
        scale = rng.uniform(*_LENGTH_M) / float(np.ptp(mesh.vertices, axis=0).max())
        turn = Rotation.from_euler("z", rng.uniform(0.0, 2.0 * np.pi)).as_matrix()
        vertices = scale * mesh.vertices @ turn.T
        vertices[:, 2] -= vertices[:, 2].min()  # all stand on one floor
        angle, gap = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(*_GAP_M)
        along = np.array([np.cos(angle), np.sin(angle), 0.0])
        if placed:
            others = KDTree(TriangleMesh.joined(placed).vertices)
            # Corners are 1 mm apart: every fourth shows the gap to a millimetre.
            step, few = 0.15, vertices[::4]
            while (
                step > 0.0
                and np.isinf(others.query(few + step * along, distance_upper_bound=gap)[0]).all()
            ):
                step -= 0.001
            vertices = vertices + step * along
        placed.append(TriangleMesh(vertices=vertices, faces=mesh.faces))
    return placed


def run_of(seed: int, options: argparse.Namespace) -> tuple[Path | None, float]:
    """Run of a box, and the permittivity of its bodies (0: metal)."""
    permittivity = float(np.random.default_rng([seed, 12]).uniform(*_PERMITTIVITY)) * (seed % 2)
    folder = options.out / str(seed)
    if (folder / "run" / "mesh_content.ply").is_file():
        return folder / "run", permittivity
    whole = TriangleMesh.joined(content(np.random.default_rng([seed, 11])))
    low, high = whole.vertices.min(axis=0), whole.vertices.max(axis=0)
    mesh = TriangleMesh(vertices=whole.vertices - 0.5 * (low + high), faces=whole.faces)

    def capture() -> geraf2.Capture:
        pose = {"shift_m": np.zeros(3), "turn_deg": 1.0}
        spec = scan_spec(mesh, box_of(mesh), folder, options, **pose, permittivity=permittivity)
        return geraf2.simulate(spec, seed=seed)[0]

    return kept_run(folder, capture, triple(box_of(mesh)), options), permittivity


def box_of(mesh: TriangleMesh) -> np.ndarray:
    """Outer sides of the box around a content [m]."""
    return np.ptp(mesh.vertices, axis=0) + 2.0 * (WALL_M + CLEARANCE_M)


def main() -> None:
    options = scan_parser(__doc__ or "", "out/materials").parse_args()
    kinds, near, held = Counter[tuple[str, str]](), list[bool](), list[bool]()
    for seed in range(options.first, options.first + options.boxes):
        run, permittivity = run_of(seed, options)
        if run is None:
            continue
        true = "plastic" if permittivity else "metal"
        parts = geraf2.inspect(run, write=False).parts
        kinds.update((true, part.material.kind) for part in parts)
        found = [part.material.permittivity for part in parts if permittivity]
        near += [e is not None and abs(e.value / permittivity - 1.0) < 0.1 for e in found]
        held += [abs(e.value - permittivity) < 1.96 * e.sigma for e in found if e is not None]
        levels = [
            "none" if (level := p.material.reflectivity_db) is None else f"{level.value:.1f}"
            for p in parts
        ]
        print(
            f"  {seed}: {true} {permittivity:.2f}: "
            f"{', '.join(p.material.kind for p in parts)}; levels {', '.join(levels)} dB; "
            f"lengths {', '.join(f'{1e3 * p.dimensions_m[0].value:.0f}' for p in parts)} mm",
            flush=True,
        )
    for true in ("metal", "plastic"):
        own = {found: n for (kind, found), n in kinds.items() if kind == true}
        print(f"{true}: " + ", ".join(f"{found} {n}" for found, n in sorted(own.items())))
    named = [t == f for (t, f), n in kinds.items() for _ in range(n) if f != "not determined"]
    print_share(named, "right material of parts with one")
    print_share(near, "permittivity of plastic parts within 10 %")
    print_share(held, "stated 95 % of a permittivity hold")


if __name__ == "__main__":
    main()
