"""What a scan without a prior is taken to be where it holds no single carton.

    python bench/python/other_boxes.py [--kinds air open tube skewed tapered nested pair carton can]
        [--first 0] [--scans 8] [--preset fast] [--out out/other_boxes]

Content of the population, metal, 5 to 8 cm: in free air, in a box without a top, in a tube of
board, in a box whose corners are 6 to 20 degrees off a right angle, in one whose walls lean by 4 to
12 degrees, in a carton within a carton, in two cartons side by side, in one carton, and an upright
can in a carton. 18 planes in two rings, 4 mm, 20 dB, ideal. The walls of a tube and of boxes that
are no cuboids echo by physical optics; echoes from within them get the delay and loss of two passes
at normal incidence. With `--preset` each scan is reconstructed without a prior, too, and boxes that
are no cuboids with the true one. Rows are kept in `--out`. Seeds below 1000 are for choices, those
from 10,000 on for claims. Shares come with their Wilson intervals (95 %).
"""

import argparse
import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh

import geraf2
from compare_pairs import shift_mesh
from geraf2.calibration.box_finder import find_box
from geraf2.io.mesh import TriangleMesh
from geraf2.ops.physical_optics import AntennaBlocks, SurfaceElements
from geraf2.ops.visibility import MeshScene
from geraf2.simulation.echo import EchoScene, Layer, plane_echo, wall_layers
from geraf2.simulation.elements import mesh_elements, select
from geraf2.simulation.population_settings import Population
from geraf2.simulation.random_objects import random_object
from geraf2.simulation.scan import antenna_blocks, scan_planes
from geraf2.simulation.spec import AWR1843, RingSpec, ScanSpec

KINDS = ("air", "open", "tube", "nested", "pair", "carton", "can", "skewed", "tapered")
CONTENT = Population(
    bodies=(("1", 0.6), ("2", 0.4)), size_m=((0.05, 0.08), (0.06, 0.08), (0.06, 0.08)), plastic=0.0
)
_PERMITTIVITY, _PATCH_M, _SNR_DB = 1.6, 0.005, 20.0
_SCAN = ScanSpec(
    n_poses=12,
    spacing_m=0.004,
    aperture_m=(0.14, 0.14),
    standoff_m=0.34,
    rings=(RingSpec(n_poses=6, elevation_deg=25.0),),
)


@dataclass(frozen=True)
class Drawn:
    """Content and walls of a scan."""

    content: TriangleMesh
    walls: tuple[geraf2.Wall, ...] = ()
    layers: tuple[Layer, ...] = ()
    """Of the outside, whose rays cross nothing."""
    inner: tuple[Layer, ...] = ()
    """Of the inside of a tube or of a box that is no cuboid."""
    crossed: geraf2.Wall | None = None
    """Material of these."""
    size_m: tuple[float, ...] = ()
    """Sides of a box, radius and height of a tube, or distances of walls."""
    walls_deg: tuple[tuple[float, float], ...] = ()
    """Azimuth and elevation of the normals of walls that form no cuboid."""
    outside: geraf2.LosPrior | None = None
    """Of a box that is no cuboid."""


def tube_layer(
    radius_m: float, height_m: float, center_m: np.ndarray, wall: geraf2.Wall, *, inside: bool
) -> Layer:
    """Patches of an upright tube, as seen from outside or from inside."""
    radius = radius_m - (wall.thickness_m if inside else 0.0)
    n, m = int(np.ceil(2 * np.pi * radius / 0.003)), int(np.ceil(height_m / _PATCH_M))
    angle, z = np.meshgrid(
        2 * np.pi * np.arange(n) / n, height_m * ((np.arange(m) + 0.5) / m - 0.5), indexing="ij"
    )
    angle, z = angle.ravel(), z.ravel()
    outward = np.stack([np.cos(angle), np.sin(angle), np.zeros(angle.size)], axis=1)
    along = np.stack([-np.sin(angle), np.cos(angle), np.zeros(angle.size)], axis=1)
    half = np.pi * radius / n, 0.5 * height_m / m
    up = np.broadcast_to([0.0, 0.0, half[1]], along.shape)
    points = radius * outward + np.outer(z, [0.0, 0.0, 1.0]) + center_m
    elements = tuple(
        SurfaceElements(
            points=points,
            normals=-outward if inside else outward,
            edges=np.stack([half[0] * along, up], axis=1),
            shape="rectangle",
            reflector=face,
            slab=wall,
        )
        for face in ("first_face", "second_face")
    )
    areas = np.full(len(points), 4.0 * half[0] * half[1])
    return Layer(elements=elements, areas=areas, can_be_hidden=inside)


def panel_layer(quad: np.ndarray, wall: geraf2.Wall, *, inside: bool) -> Layer:
    """Patches of a flat wall, corners counter-clockwise from outside, (4, 3) [m]."""
    first, second = quad[1] - quad[0], quad[3] - quad[0]
    outward = np.cross(first, second) / np.linalg.norm(np.cross(first, second))
    n, m = (int(np.ceil(np.linalg.norm(edge) / _PATCH_M)) for edge in (first, second))
    u, v = ((np.arange(k) + 0.5) / k for k in (n, m))
    u, v = (each.ravel()[:, None] for each in np.meshgrid(u, v, indexing="ij"))
    points = (1 - v) * ((1 - u) * quad[0] + u * quad[1]) + v * ((1 - u) * quad[3] + u * quad[2])
    along = (1 - v) * first + v * (quad[2] - quad[3])
    up = (1 - u) * second + u * (quad[2] - quad[1])
    elements = tuple(
        SurfaceElements(
            points=points - inside * wall.thickness_m * outward,
            normals=np.broadcast_to(-outward if inside else outward, points.shape),
            edges=0.5 * np.stack([along / n, up / m], axis=1),
            shape="rectangle",
            reflector=face,
            slab=wall,
        )
        for face in ("first_face", "second_face")
    )
    areas = np.linalg.norm(np.cross(along / n, up / m), axis=1)
    return Layer(elements=elements, areas=areas, can_be_hidden=inside)


def box_quads(normals: np.ndarray, offsets_m: np.ndarray, ends_m: tuple) -> list[np.ndarray]:
    """Corners of four upright or leaning walls, bottom and top, (4, 3) each [m]."""
    rims = []
    for z in ends_m:
        pairs = [(k, (k + 1) % 4) for k in range(4)]
        rows = [np.stack([normals[i], normals[j], [0.0, 0.0, 1.0]]) for i, j in pairs]
        values = [[offsets_m[i], offsets_m[j], z] for i, j in pairs]
        rims.append(np.array([np.linalg.solve(*each) for each in zip(rows, values, strict=True)]))
    low, high = rims
    walls = [np.stack([low[k - 1], low[k], high[k], high[k - 1]]) for k in range(4)]
    return [*walls, low[::-1], high]


def drawn_planes(
    kind: str, room: np.ndarray, middle: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, tuple[float, float]]:
    """Normals and offsets of four walls around content, and the heights of bottom and top [m]."""
    azimuth = np.deg2rad(rng.uniform(-45.0, 45.0) + 90.0 * np.arange(4))
    lean = np.zeros(4)
    height = max(float(room[2]) + rng.uniform(0.03, 0.07), 0.12)
    least = 0.5 * float(np.linalg.norm(room[:2]))
    if kind == "skewed":
        azimuth[1::2] += rng.choice([-1, 1]) * np.deg2rad(rng.uniform(6.0, 20.0))
    else:
        lean = rng.choice([-1, 1]) * np.deg2rad(rng.uniform(4.0, 12.0, 4))
    normals = np.stack(
        [np.cos(azimuth) * np.cos(lean), np.sin(azimuth) * np.cos(lean), np.sin(lean)], axis=1
    )
    gaps = least + 0.5 * height * np.abs(np.sin(lean)) + np.tile(rng.uniform(0.015, 0.04, 2), 2)
    return normals, np.maximum(gaps, 0.06) + normals @ middle, (-0.5 * height, 0.5 * height)


def without_top(layer: Layer, top_m: float) -> Layer:
    kept = layer.elements[0].points[:, 2] < top_m - 1e-3
    elements = tuple(select(each, kept) for each in layer.elements)
    return replace(layer, elements=elements, areas=layer.areas[kept])


def drawn(kind: str, seed: int) -> Drawn:
    """Content and walls of a kind."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    content = random_object(int(rng.integers(10**9)), CONTENT).mesh
    thickness, middle = rng.uniform(0.002, 0.006), np.array([*rng.uniform(-0.01, 0.01, 2), 0.0])
    if kind == "can":
        made = trimesh.creation.cylinder(rng.uniform(0.02, 0.03), rng.uniform(0.05, 0.08), 96)
        content = TriangleMesh(vertices=np.array(made.vertices), faces=np.array(made.faces))
    room = np.ptp(content.vertices, axis=0)

    def wall(size, center) -> geraf2.Wall:
        return geraf2.Wall(
            size_m=tuple(size),
            thickness_m=thickness,
            permittivity=_PERMITTIVITY,
            center_m=tuple(center),
        )

    def layers(*walls: geraf2.Wall) -> tuple[Layer, ...]:
        return wall_layers(walls, _PATCH_M)

    if kind == "air":
        return Drawn(content)
    if kind == "tube":
        radius = float(np.linalg.norm(room[:2])) / 2 + rng.uniform(0.015, 0.04)
        height = float(room[2]) + rng.uniform(0.06, 0.15)
        material = wall((2 * radius, 2 * radius, height), middle)
        outer, inner = (
            tube_layer(radius, height, middle, material, inside=inside) for inside in (False, True)
        )
        return Drawn(content, (), (outer,), (inner,), material, (radius, height))
    if kind in ("skewed", "tapered"):
        normals, offsets, ends = drawn_planes(kind, room, middle, rng)
        quads = box_quads(normals, offsets, ends)
        lowest, highest = np.min(quads, axis=(0, 1)), np.max(quads, axis=(0, 1))
        material = wall(highest - lowest, 0.5 * (lowest + highest))
        outer, inner = (
            tuple(panel_layer(quad, material, inside=inside) for quad in quads)
            for inside in (False, True)
        )
        angles = np.rad2deg([np.arctan2(normals[:, 1], normals[:, 0]), np.arcsin(normals[:, 2])])
        distances = (*(offsets - normals @ middle), ends[1])
        stated = tuple((float(a), float(b)) for a, b in angles.T.round(2))
        hull = trimesh.convex.convex_hull(np.concatenate(quads))
        mesh = TriangleMesh(vertices=np.array(hull.vertices), faces=np.array(hull.faces))
        outside = geraf2.LosPrior.from_mesh(mesh)
        return Drawn(content, (), outer, inner, material, distances, stated, outside)
    size = np.maximum(room + 2 * thickness + rng.uniform(0.02, 0.06, 3), 0.12)
    if kind == "pair":
        shift = np.array([0.5 * size[0] + rng.uniform(0.002, 0.02), 0.0, 0.0])
        boxes = [wall(size, middle + side * shift) for side in (-1, 1)]
        both = TriangleMesh.joined([shift_mesh(content, -shift), shift_mesh(content, shift)])
        return Drawn(both, tuple(boxes), layers(boxes[0]) + layers(boxes[1]), size_m=tuple(size))
    box = wall(size, middle)
    if kind == "nested":
        outer = wall(size + 2 * rng.uniform(0.015, 0.03, 3) + 2 * thickness, middle)
        return Drawn(content, (outer, box), layers(outer, box), size_m=outer.size_m)
    made = layers(box)
    if kind == "open":
        made = tuple(without_top(layer, middle[2] + 0.5 * size[2] - thickness) for layer in made)
    return Drawn(content, (box,), made, size_m=tuple(size))


def capture_of(scene: Drawn, seed: int) -> geraf2.Capture:
    """Scan with noise of a drawn scene."""
    mesh = scene.content
    blocker = MeshScene(mesh.vertices, mesh.faces)
    facets, areas = mesh_elements(mesh.vertices, mesh.faces, 0.0012, None)
    nothing = Layer(elements=(select(facets, areas < 0.0),), areas=areas[:0])
    outside = EchoScene(
        waveform=AWR1843,
        walls=scene.walls,
        blocker=blocker,
        figure=Layer(elements=(facets,), areas=areas),
        wall_layers=scene.layers,
        num_threads=1,
    )
    parts = [outside]
    if scene.crossed is not None:
        index, t = np.sqrt(_PERMITTIVITY), scene.crossed.thickness_m
        longer = replace(AWR1843, path_bias_m=AWR1843.path_bias_m + 2 * (index - 1) * t)
        loss = (1 - ((index - 1) / (index + 1)) ** 2) ** 2
        inner = tuple(replace(each, areas=loss * each.areas) for each in scene.inner)
        parts = [
            replace(outside, figure=nothing),
            replace(
                outside,
                waveform=longer,
                figure=Layer(elements=(facets,), areas=loss * areas),
                wall_layers=inner,
            ),
        ]
    planes, signals = scan_planes(_SCAN), []
    for plane in planes:
        order, offsets = antenna_blocks(plane, 0.04)
        antennas = AntennaBlocks(
            tx=plane.tx[order], rx=plane.rx[order], offsets=offsets, boresight=plane.axes[0]
        )
        echoes = [plane_echo(part, antennas).reorder(np.argsort(order)) for part in parts]
        signals.append(sum(echo.figure + echo.walls for echo in echoes))
    rng = np.random.default_rng([seed, 99])
    rms = np.sqrt(np.mean([np.mean(np.abs(s) ** 2) for s in signals]))
    sigma = rms * 10 ** (-_SNR_DB / 20) / np.sqrt(2)
    poses = tuple(
        geraf2.Pose(
            signal=np.asarray(
                s + sigma * (rng.normal(size=s.shape) + 1j * rng.normal(size=s.shape)), np.complex64
            ),
            tx_positions=plane.tx,
            rx_positions=plane.rx,
            axes=plane.axes,
            name=str(number),
            angle_deg=plane.angle_deg,
        )
        for number, (s, plane) in enumerate(zip(signals, planes, strict=True))
    )
    return geraf2.Capture(waveform=AWR1843, poses=poses)


def score(capture: geraf2.Capture, prior, scene: Drawn, preset: str) -> float:
    """F1 at 5 mm; 0 where there is no result."""
    try:
        result = geraf2.reconstruct(capture, prior, preset)
    except geraf2.UserError as error:
        print(f"    {error}")
        return 0.0
    return round(geraf2.evaluate(result, scene.content).f1(0.005), 4)


def measured(kind: str, seed: int, preset: str | None) -> dict:
    """What a scan is taken to be."""
    scene = drawn(kind, seed)
    capture = capture_of(scene, seed)
    row: dict = {"kind": kind, "seed": seed, "true_m": np.round(scene.size_m, 4).tolist()}
    if scene.walls_deg:
        row["walls_deg"] = scene.walls_deg
    try:
        found = find_box(capture)
        row["found"], row["text"] = type(found).__name__, str(found)
    except geraf2.UserError as error:
        row["found"], row["text"] = type(error).__name__, str(error)
    if preset is not None:
        row["f1"] = score(capture, None, scene, preset)
    if preset is not None and scene.outside is not None:
        row["f1_given"] = score(capture, scene.outside, scene, preset)
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--scans", type=int, default=8)
    parser.add_argument("--preset")
    parser.add_argument("--out", type=Path, default=Path("out/other_boxes"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for kind in options.kinds:
        for seed in range(options.first, options.first + options.scans):
            row = measured(kind, seed, options.preset)
            print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
