"""How often pieces that are not there are named likely ghosts, and true small parts are not.

    python bench/python/ghosts.py [RUN=TRUTH...] [--screws 10 --out out/ghosts] [--preset best]

Each `RUN` is a folder of `geraf2 reconstruct`, each `TRUTH` a mesh in metres. `--screws` simulates
objects of 8 cm beside a cylinder 8 mm wide and 8 mm high, in cartons of 18 cm, from 5 to 16 planes
on rasters of 4 to 6 mm, and reconstructs them in `--out`, where both are kept.

A piece is there if at least half of its area lies within 5 mm of the truth, and it is a ghost if
none of it does; pieces between are counted apart. A true part is small if its area is below a tenth
of the largest piece's. Shares come with their Wilson intervals (95 %).
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import geraf2
from geraf2.geometry.components import face_labels
from geraf2.geometry.triangles import vertex_areas
from geraf2.io.mesh import TriangleMesh, read_mesh, write_mesh
from geraf2.io.run_folder import CONTENT_NAME, GHOSTS_NAME
from geraf2.scene import Wall
from geraf2.simulation.figures import build_figure
from geraf2.simulation.spec import FigureSpec, NumericsSpec, ScanSpec, SceneSpec
from geraf2.surfaces.isosurface import signed_distances
from geraf2.surfaces.pieces import LIKELY
from inspection import cylinder, surface, wilson

NEAR_M = 0.005
SMALL_SHARE = 0.1
OBJECTS = ("llama", "dog", "jug", "hammer", "knot")


@dataclass(frozen=True, kw_only=True)
class Found:
    run: str
    probability: float
    there: float
    """Share of its area near the truth."""
    area_share: float
    """Area over that of the largest piece."""
    away_m: float
    """Median distance to the truth."""


def pieces(run: Path, truth: Path) -> list[Found]:
    true = read_mesh(truth)
    parts = [
        read_mesh(run / name) for name in (CONTENT_NAME, GHOSTS_NAME) if (run / name).is_file()
    ]
    mesh = TriangleMesh.joined(parts)
    probability = np.concatenate([part.confidence for part in parts])
    labels, n_pieces = face_labels(mesh.faces)
    of_vertex = np.zeros(len(mesh.vertices), dtype=int)
    of_vertex[mesh.faces] = labels[:, None]
    areas = vertex_areas(mesh.vertices, mesh.faces)
    away = np.abs(signed_distances(true, mesh.vertices))
    total = np.bincount(of_vertex, areas, n_pieces)
    near = np.bincount(of_vertex, areas * (away <= NEAR_M), n_pieces)
    return [
        Found(
            run=f"{run.parent.name}/{run.name}"[-40:],
            probability=float(probability[of_vertex == k][0]),
            there=float(near[k] / total[k]),
            area_share=float(total[k] / total.max()),
            away_m=float(np.median(away[of_vertex == k])),
        )
        for k in range(n_pieces)
    ]


def screw_scene(seed: int, out: Path, preset: str) -> tuple[Path, Path]:
    """Run and truth of an object with a small cylinder beside it."""
    rng = np.random.default_rng(seed)
    folder = out / f"screw-{seed}"
    run, truth, scene = folder / preset, folder / "truth.ply", folder / "scene"
    if not (scene / "scene.toml").is_file():
        folder.mkdir(parents=True, exist_ok=True)
        thing = build_figure(OBJECTS[seed % len(OBJECTS)])
        scale = 0.08 / np.ptp(thing.vertices, axis=0).max()
        middle = 0.5 * (thing.vertices.min(axis=0) + thing.vertices.max(axis=0))
        thing = TriangleMesh(vertices=scale * (thing.vertices - middle), faces=thing.faces)
        screw = surface(cylinder((0, 0, 0), 2, 0.004, 0.004, 0.0005))
        position = np.ones(3)
        while not 0.018 < signed_distances(thing, position[None])[0] < 0.03:
            position = rng.uniform(-0.06, 0.06, 3)
        screw = TriangleMesh(vertices=screw.vertices + position, faces=screw.faces)
        write_mesh(TriangleMesh.joined([thing, screw]), folder / "parts.ply")
        both = read_mesh(folder / "parts.ply")
        size = np.ptp(both.vertices, axis=0)
        spec = SceneSpec(
            figure=FigureSpec(mesh=str(folder / "parts.ply"), height_m=float(size[2])),
            walls=(Wall(size_m=(0.18, 0.18, 0.18), thickness_m=0.004, permittivity=1.6),),
            scan=ScanSpec(
                n_poses=int(rng.integers(5, 17)),
                spacing_m=float(rng.choice([0.004, 0.005, 0.006])),
                aperture_m=(0.12, 0.16),
                start_angle_deg=float(rng.uniform(0, 360)),
            ),
            numerics=NumericsSpec(wall_patch_m=0.02, antenna_block_m=0.07),
        )
        capture, true = geraf2.simulate(spec, seed=seed)
        write_mesh(true, truth)
        geraf2.save_capture(capture, scene)
    if not (run / CONTENT_NAME).is_file():
        geraf2.reconstruct(scene, (0.18, 0.18, 0.18), preset, run, overwrite=True)
    return run, truth


def share(name: str, marks: list[bool]) -> None:
    if not marks:
        print(f"{name}: none")
        return
    low, high = wilson(sum(marks), len(marks))
    print(f"{name}: {sum(marks)} of {len(marks)} ({100 * low:.0f} to {100 * high:.0f} %)")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="*", metavar="RUN=TRUTH")
    parser.add_argument("--screws", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out/ghosts"))
    parser.add_argument("--preset", default="best")
    arguments = parser.parse_args()
    pairs = [tuple(map(Path, pair.split("=", 1))) for pair in arguments.runs]
    screws = [screw_scene(n, arguments.out, arguments.preset) for n in range(arguments.screws)]
    found = [piece for pair in [*pairs, *screws] for piece in pieces(*pair)]
    for piece in found:
        print(
            f"{piece.run:40s} p {piece.probability:.3f}  near {piece.there:.2f}"
            f"  area {piece.area_share:.4f}  away {1e3 * piece.away_m:6.1f} mm"
        )
    ghosts = [p for p in found if p.there == 0.0]
    small = [p for p in found if p.there >= 0.5 and p.area_share < SMALL_SHARE]
    share("pieces that are not there, named", [p.probability < LIKELY for p in ghosts])
    share("true small parts, named", [p.probability < LIKELY for p in small])
    other = [p for p in found if p.there >= 0.5 and p.area_share >= SMALL_SHARE]
    share("other true pieces, named", [p.probability < LIKELY for p in other])
    share("between", [p.probability < LIKELY for p in found if 0.0 < p.there < 0.5])


if __name__ == "__main__":
    main()
