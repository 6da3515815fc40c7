"""A capture from a spec: the echo of every plane, jitter, clutter and noise."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Floats, Ints
from geraf2.errors import UserError
from geraf2.io.manifest import DELAY_GIVEN, DELAY_KEY
from geraf2.io.mesh import TriangleMesh
from geraf2.ops._threads import resolve_num_threads
from geraf2.ops.physical_optics import AntennaBlocks, SurfaceElements
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Capture, Pose, Wall
from geraf2.simulation.echo import EchoScene, Layer, PlaneEcho, plane_echo, wall_layers
from geraf2.simulation.elements import mesh_elements, rough_displacement
from geraf2.simulation.scan import ScanPlane, antenna_blocks, scan_planes
from geraf2.simulation.solids import build_solid
from geraf2.simulation.spec import ScanSpec, SceneSpec

Progress = Callable[[int, int], None]
"""Called with planes done and planes in all."""

# Independent random streams of one seed.
_JITTER, _SCATTERERS, _NOISE, _DRIFT, _CHANNELS, _ROUGHNESS = range(6)
# A drift is the sum of this many cosines over the antennas of a plane, the slowest a constant.
_N_DRIFT_TERMS = 5


def simulate(
    spec: SceneSpec, *, seed: int, num_threads: int | None = None, progress: Progress | None = None
) -> tuple[Capture, TriangleMesh]:
    """Physical-optics capture of a metal object in dielectric boxes, and the object's mesh.

    The signal is the sum of the echoes of object, walls and scatterers (see
    :func:`geraf2.ops.physical_optics.physical_optics`), plus complex white noise, divided by the
    root mean square of the noise-free sum. Single bounce: no path touches two surfaces.

    spec: the scene.
    seed: of jitter, scatterers and noise; the same seed gives the same capture.
    num_threads: all cores when None.
    progress: told after each plane.

    Returns the capture, and the object in its frame ("capture", z up, turntable axis z) [m].
    Raises UserError where the object does not fit into its box.

    >>> capture, truth = geraf2.simulate(geraf2.examples.small_scene(), seed=0)
    >>> len(capture.poses), truth.vertices.shape[1]
    (6, 3)
    """
    truth = build_solid(spec.figure)
    walls = spec.walls
    _require_inside(truth, walls)
    scene = _echo_scene(spec, truth, walls, seed, resolve_num_threads(num_threads))
    planes = scan_planes(spec.scan)
    order, offsets = antenna_blocks(
        planes[0].shape, spec.scan.spacing_m, spec.numerics.antenna_block_m
    )
    back = np.argsort(order)
    echoes: list[PlaneEcho] = []
    for i, plane in enumerate(planes):
        shift = position_error(plane, spec.scan, seed, i)
        tx, rx = plane.tx + shift, plane.rx + shift
        antennas = AntennaBlocks(
            tx=tx[order],
            rx=rx[order],
            offsets=offsets,
            boresight=plane.axes[0],
            pattern_exponent=spec.scan.pattern_exponent,
        )
        echoes.append(_reorder(plane_echo(scene, antennas), back))
        if progress is not None:
            progress(i + 1, len(planes))
    return _capture(spec, planes, _add_disturbances(spec, echoes, seed), seed), truth


def _capture(
    spec: SceneSpec, planes: list[ScanPlane], signals: list[NDArray[np.complex64]], seed: int
) -> Capture:
    poses = tuple(
        Pose(
            signal=signal,
            tx_positions=plane.tx,
            rx_positions=plane.rx,
            axes=plane.axes,
            name=f"{i}_{plane.angle_deg:g}",
            angle_deg=plane.angle_deg,
        )
        for i, (plane, signal) in enumerate(zip(planes, signals, strict=True))
    )
    figure = spec.figure.name or spec.figure.mesh
    return Capture(
        waveform=spec.waveform,
        poses=poses,
        walls=spec.walls,
        provenance={
            "importer": "simulate",
            "source": str(figure).rsplit("/", maxsplit=1)[-1],
            "seed": str(seed),
            "phase_sign": "-1",
            DELAY_KEY: DELAY_GIVEN,
        },
    )


def _require_inside(truth: TriangleMesh, walls: tuple[Wall, ...]) -> None:
    for wall in walls:
        room = 0.5 * np.asarray(wall.size_m) - wall.thickness_m
        reach = np.abs(truth.vertices - np.asarray(wall.center_m)).max(axis=0)
        if (reach >= room).any():
            raise UserError(
                what="the figure does not fit into its box",
                expected=f"at most {_mm(room)} mm from the centre of the {_mm(wall.size_m)} mm box",
                got=f"{_mm(reach)} mm",
                hint="lower figure.height_m or enlarge walls.size_m",
            )


def _mm(lengths: object) -> str:
    return " x ".join(f"{1e3 * v:.0f}" for v in np.asarray(lengths))


def _echo_scene(
    spec: SceneSpec, truth: TriangleMesh, walls: tuple[Wall, ...], seed: int, num_threads: int
) -> EchoScene:
    blocker = MeshScene(truth.vertices, truth.faces, num_threads=num_threads)
    roughness = None
    if spec.figure.roughness_rms_m > 0:
        roughness = rough_displacement(
            spec.figure.roughness_rms_m,
            spec.figure.roughness_length_m,
            np.random.default_rng([seed, _ROUGHNESS]),
        )
    facets, areas = mesh_elements(
        truth.vertices, truth.faces, spec.numerics.max_facet_edge_m, roughness
    )
    areas = spec.figure.reflectivity * areas  # weights of the echo: nothing else is made of them
    scatterers, amplitudes = None, None
    if spec.disturbance.scatterer_energy_fraction > 0:
        rng = np.random.default_rng([seed, _SCATTERERS])
        n = spec.disturbance.n_scatterers
        scatterers = SurfaceElements(points=_free_points(truth, walls, blocker, n, rng))
        amplitudes = rng.normal(size=n) + 1j * rng.normal(size=n)
    return EchoScene(
        waveform=spec.waveform,
        walls=walls,
        blocker=blocker,
        figure=Layer(elements=(facets,), areas=areas),
        wall_layers=wall_layers(walls, spec.numerics.wall_patch_m),
        scatterers=scatterers,
        scatterer_amplitudes=amplitudes,
        num_threads=num_threads,
    )


def _free_points(
    truth: TriangleMesh,
    walls: tuple[Wall, ...],
    blocker: MeshScene,
    n_points: int,
    rng: np.random.Generator,
) -> Floats:
    """Uniform points in the innermost box (or the object's bounding box) outside the object."""
    if walls:
        center = np.asarray(walls[-1].center_m)
        half = 0.5 * np.asarray(walls[-1].size_m) - walls[-1].thickness_m
    else:
        low, high = truth.vertices.min(axis=0), truth.vertices.max(axis=0)
        center, half = 0.5 * (low + high), 0.6 * (high - low)
    found = np.empty((0, 3))
    while found.shape[0] < n_points:
        points = center + half * rng.uniform(-1.0, 1.0, (2 * n_points, 3))
        found = np.concatenate([found, points[~blocker.contains(points)]])
    return found[:n_points]


def position_error(plane: ScanPlane, scan: ScanSpec, seed: int, number: int) -> Floats:
    """Difference of the true from the recorded place of each antenna, (n_antennas, 3) [m].

    Transmitter and receiver move together. The object turns about an axis that lies at
    `axis_offset_m`; seen from the object, the radar is displaced the other way.
    """
    n = len(plane.tx)
    jitter = np.random.default_rng([seed, _JITTER, number]).normal(size=(n, 3))
    amplitudes = np.random.default_rng([seed, _DRIFT, number]).normal(size=(_N_DRIFT_TERMS, 3))
    amplitudes /= np.sqrt(1.0 + 0.5 * (_N_DRIFT_TERMS - 1))  # one constant, the others cosines
    phase = np.pi * (np.arange(n)[:, None] + 0.5) / n * np.arange(_N_DRIFT_TERMS)
    radial, across = scan.axis_offset_m
    axis = -radial * plane.axes[0] + across * plane.axes[1]
    return np.asarray(
        scan.position_jitter_rms_m * jitter
        + scan.position_drift_rms_m * (np.cos(phase) @ amplitudes)
        - axis
    )


def _reorder(echo: PlaneEcho, back: Ints) -> PlaneEcho:
    return PlaneEcho(
        figure=echo.figure[back],
        walls=echo.walls[back],
        scatterers=None if echo.scatterers is None else echo.scatterers[back],
    )


def _channel_phasors(spec: SceneSpec, seed: int, n_antennas: int) -> NDArray[np.complex64]:
    """Phasor that each channel puts on its antennas, (n_antennas, 1)."""
    n_channels = spec.disturbance.n_channels
    normal = np.random.default_rng([seed, _CHANNELS]).normal(size=n_channels)
    phase = np.deg2rad(spec.disturbance.channel_phase_rms_deg) * normal
    return np.asarray(np.exp(1j * phase[np.arange(n_antennas) % n_channels, None]), np.complex64)


def _energy(signals: list[NDArray[np.complex64]]) -> float:
    return float(sum(np.square(np.abs(s), dtype=np.float64).sum() for s in signals))


def _add_disturbances(
    spec: SceneSpec, echoes: list[PlaneEcho], seed: int
) -> list[NDArray[np.complex64]]:
    """Sum of all echoes at unit mean power, with scatterers and noise at the asked levels."""
    clutter = [e.scatterers for e in echoes if e.scatterers is not None]
    scale = 0.0
    if clutter:
        wanted = spec.disturbance.scatterer_energy_fraction * _energy([e.figure for e in echoes])
        scale = float(np.sqrt(wanted / _energy(clutter)))
    signals = [
        e.figure + e.walls + (0 if e.scatterers is None else np.float32(scale) * e.scatterers)
        for e in echoes
    ]
    n_samples = sum(s.size for s in signals)
    unit = np.float32(1.0 / np.sqrt(_energy(signals) / n_samples))
    signals = [(unit * s * _channel_phasors(spec, seed, len(s))).astype(s.dtype) for s in signals]
    if spec.disturbance.snr_db == np.inf:
        return signals
    # Complex noise of total variance 10^(-snr / 10): half in each part.
    sigma = np.float32(np.sqrt(0.5 * 10.0 ** (-spec.disturbance.snr_db / 10.0)))
    noisy = []
    for i, signal in enumerate(signals):
        rng = np.random.default_rng([seed, _NOISE, i])
        parts = rng.standard_normal((*signal.shape, 2), dtype=np.float32)
        noisy.append((signal + sigma * (parts[..., 0] + 1j * parts[..., 1])).astype(np.complex64))
    return noisy
