"""What a scan without a prior is taken to be where it holds no single carton.

    python bench/python/other_boxes.py [--kinds air open nested pair carton can]
        [--first 0] [--scans 8] [--preset fast]

Content of the population, metal, 5 to 8 cm: in free air, in a box without a top, in a carton within
a carton, in two cartons side by side, in one carton, and an upright can in a carton. 18 planes in
two rings, 4 mm, 20 dB, ideal. With `--preset` each scan is reconstructed without a prior, too.
Seeds below 1000 are for choices, those from 10,000 on for claims.
"""

import argparse
import json
from dataclasses import dataclass, replace

import numpy as np
import trimesh

import geraf2
from compare_pairs import shift_mesh
from geraf2.calibration.box_finder import find_box
from geraf2.io.mesh import TriangleMesh
from geraf2.ops.physical_optics import AntennaBlocks
from geraf2.ops.visibility import MeshScene
from geraf2.simulation.echo import EchoScene, Layer, plane_echo, wall_layers
from geraf2.simulation.elements import mesh_elements, select
from geraf2.simulation.population_settings import Population
from geraf2.simulation.random_objects import random_object
from geraf2.simulation.scan import antenna_blocks, scan_planes
from geraf2.simulation.spec import AWR1843, RingSpec, ScanSpec

KINDS = ("air", "open", "nested", "pair", "carton", "can")
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
    """Patches of the walls."""
    size_m: tuple[float, ...] = ()
    """Sides of the box."""


def without_top(layer: Layer, top_m: float) -> Layer:
    kept = layer.elements.points[:, 2] < top_m - 1e-3
    return replace(layer, elements=select(layer.elements, kept), areas=layer.areas[kept])


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
    drawn_scene = EchoScene(
        waveform=AWR1843,
        walls=scene.walls,
        blocker=blocker,
        figure=Layer(elements=facets, areas=areas),
        wall_layers=scene.layers,
        num_threads=1,
    )
    planes, signals = scan_planes(_SCAN), []
    for plane in planes:
        order, offsets = antenna_blocks(plane, 0.04)
        antennas = AntennaBlocks(
            tx=plane.tx[order], rx=plane.rx[order], offsets=offsets, boresight=plane.axes[0]
        )
        echo = plane_echo(drawn_scene, antennas).reorder(np.argsort(order))
        signals.append(echo.figure + echo.walls)
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


def score(capture: geraf2.Capture, scene: Drawn, preset: str) -> float:
    """F1 at 5 mm; 0 where there is no result."""
    try:
        result = geraf2.reconstruct(capture, None, preset)
    except geraf2.UserError as error:
        print(f"    {error}")
        return 0.0
    return round(geraf2.evaluate(result, scene.content).f1(0.005), 4)


def measured(kind: str, seed: int, preset: str | None) -> dict:
    """What a scan is taken to be."""
    scene = drawn(kind, seed)
    capture = capture_of(scene, seed)
    row: dict = {"kind": kind, "seed": seed, "true_m": np.round(scene.size_m, 4).tolist()}
    try:
        found = find_box(capture)
        row["found"], row["text"] = type(found).__name__, str(found)
    except geraf2.UserError as error:
        row["found"], row["text"] = type(error).__name__, str(error)
    if preset is not None:
        row["f1"] = score(capture, scene, preset)
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--scans", type=int, default=8)
    parser.add_argument("--preset")
    options = parser.parse_args()
    for kind in options.kinds:
        for seed in range(options.first, options.first + options.scans):
            row = measured(kind, seed, options.preset)
            print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
