"""Captures of bodies whose echo is that of Maxwell's equations, beside the specs of their twins.

    OMP_NUM_THREADS=1 python bench/full_wave/captures.py OUT [--only ball cup]

Makes OUT/NAME/scene, a scene folder with its truth, and OUT/NAME/twin.toml with truth.ply, the spec
from which `geraf2 simulate` makes the same scan by physical optics. comparison.py compares
them. What is there is kept. A body takes 1 to 10 minutes of one
core. The captures are in the public domain (CC0 1.0), which each states in its provenance.
"""

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from bodies import BODIES, Body
from box import Leg, direct, flashes, legs
from cluster import Cluster, cluster_echoes
from echo import Dipoles, echoes, interpolated, nodes
from mirror import Mirror, returned

from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.io.container import LOS_NAME, TRUTH_NAME
from geraf2.io.manifest import DELAY_GIVEN, DELAY_KEY
from geraf2.io.mesh import write_mesh
from geraf2.io.toml import write_toml
from geraf2.scene import Capture, LosPrior, Pose
from geraf2.scene.store import save_capture
from geraf2.simulation.scan import ScanPlane, scan_planes
from geraf2.simulation.spec import (
    DisturbanceSpec,
    FigureSpec,
    NumericsSpec,
    RingSpec,
    ScanSpec,
    SceneSpec,
)
from geraf2.simulation.world import WorldSpec

PRIOR_SIDE_M = 0.12
"""Side of the cube in which the content is sought."""
SCAN = ScanSpec(n_poses=12, spacing_m=0.004, rings=(RingSpec(n_poses=6, elevation_deg=40.0),))
IN_BOX = ScanSpec(n_poses=12, spacing_m=0.006)
"""Each far wall adds paths: fewer antennas."""


@dataclass
class Echoes:
    """Echoes of a body plane by plane; those of planes that a turn makes equal are kept."""

    body: Body | Cluster
    wavenumbers: np.ndarray

    def __post_init__(self) -> None:
        at = nodes(self.wavenumbers.min(), self.wavenumbers.max(), self.body.n_nodes)
        self.scatterers = [self.body.scatterer(k) for k in at]
        self._known: dict[bytes, np.ndarray] = {}

    def of(self, plane: ScanPlane) -> np.ndarray:
        """Echoes of a plane's antennas, vertical dipoles, (n_antennas, n_wavenumbers)."""
        step = np.deg2rad(self.body.alike_deg)
        back = np.deg2rad(plane.angle_deg)
        back = -step * np.floor(back / step) if step else -back
        c, s = np.cos(back), np.sin(back)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]).T
        tx, rx, (up,) = (v @ turn for v in (plane.tx, plane.rx, plane.axes[2:]))
        key = np.round(1e9 * np.concatenate([tx, rx, up[None]])).astype(np.int64).tobytes()
        if key not in self._known:
            self._known[key] = self._of_antennas(tx, rx, up)
        return self._known[key]

    def _of_antennas(self, tx: np.ndarray, rx: np.ndarray, up: np.ndarray) -> np.ndarray:
        box, at = self.body.box, np.array([s.k for s in self.scatterers])
        paths = [legs(p, up, box, at) if box else [direct(p, up, at)] for p in (rx, tx)]
        ends = [[self._dipoles(leg) for leg in own] for own in paths]
        between = cluster_echoes if isinstance(self.body, Cluster) else echoes
        found = between(self.scatterers, *ends)
        total = flashes(tx, rx, up, box, self.wavenumbers) if box else 0.0
        if box:
            total = total + self._by_mirrors(ends, [leg.face for leg in paths[0][1:]])
        for i, one in enumerate(ends[0]):
            for j, two in enumerate(ends[1]):
                delay = one.ranges + two.ranges
                total = total + interpolated(found[i, j], at, self.wavenumbers, delay)
        return total

    def _by_mirrors(self, ends: list[list[Dipoles]], faces: list[tuple[int, int]]) -> np.ndarray:
        """Echoes of waves that meet the body before and after a far wall."""
        box, at = self.body.box, np.array([s.k for s in self.scatterers])
        mirrors = [
            Mirror(
                side * np.eye(3)[axis] @ self.body.turn,
                0.5 * box.size_m[axis] - box.thickness_m,
                box,
            )
            for axis, side in faces
        ]
        delay = ends[0][0].ranges + ends[1][0].ranges
        found = returned(self.scatterers, ends[0][0], ends[1][0], mirrors)
        paths = [
            interpolated(own, at, self.wavenumbers, delay + 2 * mirror.distance_m)
            for own, mirror in zip(found, mirrors, strict=True)
        ]
        return sum(paths, np.zeros((len(delay), len(self.wavenumbers))))

    def _dipoles(self, leg: Leg) -> Dipoles:
        return Dipoles(leg.positions @ self.body.turn, leg.directions @ self.body.turn)


def spec_of(body: Body | Cluster, truth: Path) -> SceneSpec:
    """Spec of the twin by physical optics."""
    vertices = body.mesh().vertices
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    world = WorldSpec()
    if (e := body.permittivity) is not None:
        world = WorldSpec(figure_permittivity=e.real, figure_loss_tangent=e.imag / e.real)
    return SceneSpec(
        world=world,
        figure=FigureSpec(
            mesh=str(truth),
            height_m=float(high[2] - low[2]),
            center_m=tuple(np.round(0.5 * (low + high), 9).tolist()),
        ),
        walls=() if body.box is None else (body.box,),
        scan=SCAN if body.box is None else IN_BOX,
        disturbance=DisturbanceSpec(snr_db=20.0),
        numerics=NumericsSpec(max_facet_edge_m=0.001),
    )


def capture_of(spec: SceneSpec, echo: Echoes, seed: int = 0) -> Capture:
    """Capture in the simulator's convention: exp(-j k path), unit mean power before noise."""
    frequencies_hz = spec.waveform.frequencies_hz
    k = 2 * np.pi * frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    bias = np.exp(-1j * k * spec.waveform.path_bias_m)
    planes = scan_planes(spec.scan)
    signals = [np.conj(echo.of(plane)) * bias for plane in planes]
    power = np.mean([np.mean(np.abs(signal) ** 2) for signal in signals])
    rng = np.random.default_rng(seed)
    sigma = np.sqrt(0.5 * 10 ** (-spec.disturbance.snr_db / 10))
    poses = []
    for number, (plane, signal) in enumerate(zip(planes, signals, strict=True)):
        noise = sigma * (rng.normal(size=(*signal.shape, 2)) @ (1, 1j))
        poses.append(
            Pose(
                signal=(signal / np.sqrt(power) + noise).astype(np.complex64),
                tx_positions=plane.tx,
                rx_positions=plane.rx,
                axes=plane.axes,
                name=f"{number}_{plane.angle_deg:g}",
                angle_deg=plane.angle_deg,
            )
        )
    return Capture(
        waveform=spec.waveform,
        poses=tuple(poses),
        walls=spec.walls,
        provenance={
            "importer": "bench/full_wave/captures.py",
            "source": "Maxwell's equations",
            "license": "CC0-1.0",
            "seed": str(seed),
            "phase_sign": "-1",
            DELAY_KEY: DELAY_GIVEN,
        },
    )


def make(name: str, out: Path) -> None:
    body, folder = BODIES[name], out / name
    if (folder / "scene").is_dir():
        return
    started = time.perf_counter()
    folder.mkdir(parents=True, exist_ok=True)
    truth = body.mesh()
    write_mesh(truth, folder / TRUTH_NAME)
    spec = spec_of(body, Path(TRUTH_NAME))
    write_toml(folder / "twin.toml", spec)
    k = 2 * np.pi * spec.waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    echo = Echoes(body, k)
    residual = max(s.residual for s in echo.scatterers)
    capture = capture_of(spec, echo)
    capture = replace(capture, provenance={**capture.provenance, "residual": f"{residual:.1e}"})

    def write_extras(inside: Path) -> None:
        write_mesh(truth, inside / TRUTH_NAME, frame=capture.frame)
        sides = (PRIOR_SIDE_M,) * 3 if body.box is None else body.box.size_m
        prior = LosPrior.from_box(sides, (0.0, 0.0, 0.0))
        write_mesh(prior.mesh, inside / LOS_NAME, frame=capture.frame)

    save_capture(capture, folder / "scene", extras=write_extras)
    seconds = time.perf_counter() - started
    print(f"{name:10s} residual {residual:.1e}, {seconds:.0f} s", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", nargs="*", choices=BODIES, default=list(BODIES))
    chosen = parser.parse_args()
    if chosen.out.is_file():
        parser.error(f"{chosen.out} is a file, expected a folder")
    for name in chosen.only:
        make(name, chosen.out)


if __name__ == "__main__":
    main()
