"""What `geraf2 compare` finds of a packed box that is put down anew, whole and changed.

    python bench/python/compare_pairs.py --out out/compare [--first 0] [--boxes 20] [--again 1]

A box holds two or three metal bodies of the population; one of them has an 8 mm screw head. It is
scanned, put down anew by up to 5 mm and 3 degrees, its walls bulged anew, in the plausible world,
and scanned again: unchanged (`--again` times), without the head, with one body moved by 2 mm, and
with one body swapped for another of the same length. Scenes and runs are kept in `--out` and used
again, so that a stopped script continues; `--cached` makes nothing new. The comparison is always
new. Seeds below 1000 and 10000 to 10019 are for choices, those from 10020 on for claims. Shares
come with their Wilson intervals (95 %).
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

import geraf2
from geraf2.geometry.components import face_labels
from geraf2.geometry.transforms import triple
from geraf2.geometry.triangles import unit_normals
from geraf2.io.mesh import TriangleMesh, write_mesh
from geraf2.ops.visibility import MeshScene
from geraf2.simulation.population_settings import Population
from geraf2.simulation.random_objects import random_object
from geraf2.simulation.spec import FigureSpec, ScanSpec, SceneSpec
from geraf2.simulation.world import EFFECTS, WorldSpec
from inspection import kept_run, print_share

CHANGES = ("head", "moved", "swapped")
BODIES = Population(
    bodies=(("2", 0.5), ("3", 0.5)),
    size_m=((0.05, 0.06), (0.08, 0.10), (0.09, 0.12)),
    gap_m=(0.006, 0.02),
)
"""Content of a box: bodies of 3 to 6 cm."""
_HEAD_RADIUS_M, _HEAD_HEIGHT_M = 0.004, 0.005
_MOVED_M, _SHIFT_M, _TURN_DEG = 0.002, 0.005, 3.0
WALL_M, CLEARANCE_M = 0.004, 0.016
_FREE_M = np.array([[3, 2], [8, 5], [14, 8], [25, 8], [40, 8], [60, 8]]) * 1e-3
"""Distance of points ahead of a head, and least distance of the content from each [m]."""
_SLOW, _OF_CONTENT = ("waves", "second_bounce"), ("roughness", "patches", "dielectric")


def bodies_of(mesh: TriangleMesh) -> list[TriangleMesh]:
    """Connected bodies of a mesh."""
    labels, n_bodies = face_labels(mesh.faces)
    return [cut(mesh, mesh.faces[labels == body]) for body in range(n_bodies)]


def cut(mesh: TriangleMesh, faces: np.ndarray) -> TriangleMesh:
    used = np.unique(faces)
    return TriangleMesh(vertices=mesh.vertices[used], faces=np.searchsorted(used, faces))


def shift_mesh(mesh: TriangleMesh, by_m: np.ndarray) -> TriangleMesh:
    return TriangleMesh(vertices=mesh.vertices + by_m, faces=mesh.faces)


def place_head(
    bodies: list[TriangleMesh], rng: np.random.Generator
) -> tuple[TriangleMesh, np.ndarray]:
    """Head of a screw on a free spot of the side of a body, and its middle."""
    whole = TriangleMesh.joined(bodies)
    scene = MeshScene(whole.vertices, whole.faces)
    normals, middles = unit_normals(whole.corners), whole.corners.mean(axis=1)
    order = rng.permutation(len(whole.faces))
    for face in order[np.abs(normals[order, 2]) < 0.25]:
        start, normal = middles[face], normals[face]
        gaps = scene.signed_distance(start + _FREE_M[:, :1] * normal)
        if (gaps > _FREE_M[:, 1]).all():
            break
    turn = trimesh.geometry.align_vectors([0, 0, 1], normal)
    # Half of it is in the body, so that the head has no gap below it where the side is bent.
    turn[:3, 3] = start + normal * (0.5 * _HEAD_HEIGHT_M - 0.001)
    made = trimesh.creation.cylinder(_HEAD_RADIUS_M, _HEAD_HEIGHT_M + 0.002, sections=24)
    made = made.subdivide_to_size(0.0025, max_iter=10)
    made.apply_transform(turn)
    mesh = TriangleMesh(vertices=np.asarray(made.vertices), faces=np.asarray(made.faces))
    return mesh, start + 0.5 * _HEAD_HEIGHT_M * normal


def swap_body(body: TriangleMesh, seed: int) -> TriangleMesh:
    """Another body of the population with the same length, at the same position."""
    one = Population(bodies=(("1", 1.0),))
    other = random_object(10**6 + seed, one).mesh
    low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
    scale = float((high - low).max()) / float(np.ptp(other.vertices, axis=0).max())
    return TriangleMesh(vertices=0.5 * (low + high) + scale * other.vertices, faces=other.faces)


def scan_spec(
    mesh: TriangleMesh,
    size_m: np.ndarray,
    folder: Path,
    options: argparse.Namespace,
    *,
    shift_m: np.ndarray,
    turn_deg: float,
    permittivity: float = 0.0,
) -> SceneSpec:
    """Spec of a scan of a box at a shift and a turn, with a content (metal without permittivity).

    The content's roughness and patches are left out: the simulator draws them anew for each scan.
    """
    write_mesh(mesh, folder / "truth.ply")
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    effects = (e for e in EFFECTS if (options.waves or e not in _SLOW) and e not in _OF_CONTENT)
    world = WorldSpec(preset="plausible", effects=tuple(effects), box_turn_deg=turn_deg)
    if permittivity:
        world = replace(world, figure_permittivity=permittivity, figure_loss_tangent=0.01)
    return SceneSpec(
        figure=FigureSpec(
            mesh=str(folder / "truth.ply"),
            height_m=float(high[2] - low[2]),
            center_m=triple(0.5 * (low + high)),
        ),
        walls=(
            geraf2.Wall(
                size_m=triple(size_m),
                thickness_m=WALL_M,
                permittivity=1.6,
                center_m=triple(shift_m),
            ),
        ),
        scan=ScanSpec(
            n_poses=options.planes,
            spacing_m=options.spacing_m,
            aperture_m=(0.14, 0.14),
            standoff_m=0.30,
        ),
        world=world,
    )


class PackedBox:
    """Content of a seed, whole and changed."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng([seed, 7])
        self.seed = seed
        self.bodies = bodies_of(random_object(seed, BODIES).mesh)
        self.head, self.head_m = place_head(self.bodies, rng)
        self.changed = int(rng.integers(len(self.bodies)))
        angle = rng.uniform(0, 2 * np.pi)
        self.shift_m = _MOVED_M * np.array([np.cos(angle), np.sin(angle), 0.0])
        extents = np.ptp(TriangleMesh.joined([*self.bodies, self.head]).vertices, axis=0)
        self.size_m = extents + 2.0 * (WALL_M + CLEARANCE_M)

    def content(self, change: str) -> TriangleMesh:
        bodies, head = list(self.bodies), [self.head]
        one = bodies[self.changed]
        if change == "moved":
            bodies[self.changed] = shift_mesh(one, self.shift_m)
            if KDTree(one.vertices).query(self.head_m)[0] < _HEAD_HEIGHT_M:
                head = [shift_mesh(self.head, self.shift_m)]
        if change == "swapped":
            bodies[self.changed] = swap_body(one, self.seed)
        return TriangleMesh.joined([*bodies, *([] if change == "head" else head)])

    def spec(self, change: str, folder: Path, options: argparse.Namespace) -> tuple[SceneSpec, int]:
        """Spec of a scan of the box where it was put down, and the seed of its errors."""
        number = ("reference", *CHANGES).index(change) if change[:5] != "again" else 10
        number += int(change[5:] or 0) if change[:5] == "again" else 0
        rng = np.random.default_rng([self.seed, 100 + number])
        turn_deg, shift = rng.uniform(-_TURN_DEG, _TURN_DEG), np.zeros(3)
        shift[:2] = rng.uniform(-_SHIFT_M, _SHIFT_M, 2)
        turn = Rotation.from_euler("z", turn_deg, degrees=True).as_matrix()
        mesh = self.content(change)
        placed = TriangleMesh(vertices=mesh.vertices @ turn.T + shift, faces=mesh.faces)
        spec = scan_spec(placed, self.size_m, folder, options, shift_m=shift, turn_deg=turn_deg)
        return spec, 1000 * self.seed + number

    def run(self, change: str, options: argparse.Namespace) -> Path | None:
        """Folder of the run of a scan; None where nothing is made."""
        folder = options.out / str(self.seed) / change

        def scanned() -> geraf2.Capture:
            spec, seed = self.spec(change, folder, options)
            capture = geraf2.simulate(spec, seed=seed)[0]
            # Nobody knows where the box was put down.
            walls = tuple(replace(wall, center_m=(0.0, 0.0, 0.0)) for wall in capture.walls)
            return replace(capture, walls=walls)

        return kept_run(folder, scanned, triple(self.size_m), options)


def scan_parser(text: str, out: str) -> argparse.ArgumentParser:
    """Options of the boxes that are scanned, and of their scans and runs."""
    parser = argparse.ArgumentParser(description=text.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path(out))
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--boxes", type=int, default=20)
    parser.add_argument("--planes", type=int, default=12)
    parser.add_argument("--spacing-m", type=float, default=0.004)
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--waves", action="store_true", help="walls as waves, second bounces, too")
    parser.add_argument("--cached", action="store_true", help="count only what was run before")
    return parser


def main() -> None:
    parser = scan_parser(__doc__ or "", "out/compare")
    parser.add_argument("--again", type=int, default=1)
    parser.add_argument("--changes", nargs="*", choices=CHANGES, default=CHANGES)
    options = parser.parse_args()
    verdicts: dict[str, list[bool]] = {}
    for seed in range(options.first, options.first + options.boxes):
        box = PackedBox(seed)
        reference = box.run("reference", options)
        for change in (*(f"again{n}" for n in range(options.again)), *options.changes):
            run = None if reference is None else box.run(change, options)
            if run is None or reference is None:
                continue
            found = geraf2.compare(run, [reference])
            verdicts.setdefault(change.rstrip("0123456789"), []).append(found.changed)
            print(f"  {seed} {change}: {'; '.join(map(str, found.changes)) or 'unchanged'}")
    for change, changed in verdicts.items():
        what = "unchanged box reported as changed" if change == "again" else f"{change}: found"
        print_share(changed, what)


if __name__ == "__main__":
    main()
