"""A capture from a spec: the echo of every plane, jitter, clutter and noise."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Floats, Progress
from geraf2.errors import UserError
from geraf2.geometry.transforms import triple
from geraf2.io.manifest import DELAY_GIVEN, DELAY_KEY
from geraf2.io.mesh import TriangleMesh
from geraf2.ops._threads import resolve_num_threads
from geraf2.ops.physical_optics import AntennaBlocks, SurfaceElements
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Capture, Pose, Wall
from geraf2.simulation.belt import belt_planes
from geraf2.simulation.dielectric import face_reflection
from geraf2.simulation.echo import EchoScene, Layer, PlaneEcho, Points, plane_echo, wall_layers
from geraf2.simulation.electronics import amplify, convert, leakage
from geraf2.simulation.elements import mesh_elements, rough_displacement
from geraf2.simulation.placement import true_plane, turned_plane
from geraf2.simulation.ray_tubes import Film, SmoothMesh, TubeScene
from geraf2.simulation.scan import ScanPlane, antenna_blocks, scan_planes
from geraf2.simulation.solids import build_solid
from geraf2.simulation.spec import SceneSpec
from geraf2.simulation.streams import stream
from geraf2.simulation.wall_waves import CELL_M
from geraf2.simulation.walls import box_turn, edge_lines, wall_shapes

# Fields of the world that other parts of the spec have as well: name, part, field.
_SHARED = (
    ("position_drift_rms_m", "scan", "position_drift_rms_m"),
    ("position_white_rms_m", "scan", "position_jitter_rms_m"),
    ("pattern_exponent", "scan", "pattern_exponent"),
    ("roughness_rms_m", "figure", "roughness_rms_m"),
    ("channel_phase_rms_deg", "disturbance", "channel_phase_rms_deg"),
)


def simulate(
    spec: SceneSpec, *, seed: int, num_threads: int | None = None, progress: Progress | None = None
) -> tuple[Capture, TriangleMesh]:
    """Physical-optics capture of an object in dielectric boxes, and the object's mesh.

    The signal is the sum of the echoes of object, walls and scatterers (see
    :func:`geraf2.ops.physical_optics.physical_optics`), plus complex white noise, divided by the
    root mean square of the noise-free sum. Single bounce: no
    path touches two surfaces, unless the spec's world enables it.

    Parameters
    ----------
    spec
        The scene.
    seed
        Of jitter, scatterers and noise; the same seed gives the same capture.
    num_threads
        All cores when None.
    progress
        Called with the fraction done, after each plane.

    Returns
    -------
    tuple of Capture and TriangleMesh
        The capture, and the object in its frame ("capture", z up, turntable axis z) [m]; a shell
        with what it holds.

    Raises
    ------
    UserError
        If the object does not fit into its box, or what a shell holds not into it.

    Examples
    --------
    >>> capture, truth = geraf2.simulate(geraf2.examples.small_scene(), seed=0)
    >>> len(capture.poses), truth.vertices.shape[1]
    (6, 3)
    """
    spec = _apply_world(spec)
    parts = [build_solid(figure) for figure in (spec.figure, spec.inside) if figure is not None]
    walls = spec.walls
    turn, middle = box_turn(spec)  # the echoes are made in the frame of the boxes
    placed = parts
    if spec.world.box_turn_deg:
        placed = [replace(p, vertices=(p.vertices - middle) @ turn.T + middle) for p in parts]
    _require_inside(placed[0], walls)
    scene = _echo_scene(spec, placed, walls, seed, resolve_num_threads(num_threads))
    planes, moved = recorded_planes(spec, seed)
    _require_outside(planes, walls)
    echoes: list[PlaneEcho] = []
    for i, plane in enumerate(planes):
        order, offsets = antenna_blocks(plane, spec.numerics.antenna_block_m)
        placed_plane = true_plane(moved[i], spec, seed, i)
        if spec.world.box_turn_deg:
            placed_plane = turned_plane(placed_plane, turn, middle)
        antennas = AntennaBlocks(
            tx=placed_plane.tx[order],
            rx=placed_plane.rx[order],
            offsets=offsets,
            boresight=placed_plane.axes[0],
            pattern_exponent=spec.scan.pattern_exponent,
        )
        echoes.append(plane_echo(scene, antennas).reorder(np.argsort(order)))
        if progress is not None:
            progress((i + 1) / len(planes))
    capture = _capture(spec, planes, _add_disturbances(spec, planes, echoes, seed), seed)
    return capture, TriangleMesh.joined(parts)


def recorded_planes(spec: SceneSpec, seed: int) -> tuple[list[ScanPlane], list[ScanPlane]]:
    """Planes as they are recorded, and as the motion of a belt moves them."""
    if spec.belt is None:
        planes = scan_planes(spec.scan)
        return planes, planes
    recorded, moved = zip(*belt_planes(spec.belt, seed), strict=True)
    return list(recorded), list(moved)


def _apply_world(spec: SceneSpec) -> SceneSpec:
    """Spec with the values of its world in scan, object and disturbance."""
    world = spec.world
    for name, part, key in _SHARED:
        if value := getattr(world, name):
            spec = replace(spec, **{part: replace(getattr(spec, part), **{key: value})})
    if world.roughness_rms_m:
        figure = replace(spec.figure, roughness_length_m=world.roughness_length_m)
        spec = replace(spec, figure=figure)
    if world.channel_phase_rms_deg:
        disturbance = replace(spec.disturbance, n_channels=world.n_channels)
        spec = replace(spec, disturbance=disturbance)
    if world.axis_offset_m:
        part_m = world.axis_offset_m / np.sqrt(2.0)
        spec = replace(spec, scan=replace(spec.scan, axis_offset_m=(part_m, part_m)))
    return spec


def _capture(
    spec: SceneSpec, planes: list[ScanPlane], signals: list[NDArray[np.complex64]], seed: int
) -> Capture:
    poses = tuple(
        Pose(
            signal=signal,
            tx_positions=plane.tx,
            rx_positions=plane.rx,
            axes=plane.axes,
            name=plane.name or f"{i}_{plane.angle_deg:g}",
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
            **({} if spec.world.is_off else {"world": str(spec.world)}),
        },
    )


def _require_inside(truth: TriangleMesh, walls: tuple[Wall, ...]) -> None:
    for wall in walls:
        room = 0.5 * np.asarray(wall.size_m) - wall.thickness_m
        reach = np.abs(truth.vertices - np.asarray(wall.center_m)).max(axis=0)
        if (reach >= room).any():
            raise UserError(
                what="the object does not fit into its box",
                expected=f"at most {_mm(room)} mm from the centre of the {_mm(wall.size_m)} mm box",
                got=f"{_mm(reach)} mm",
                hint=_how_to_fit(truth, wall, room),
            )


def _require_held(shell: MeshScene, held: list[TriangleMesh]) -> None:
    if not all(shell.contains(part.vertices).all() for part in held):
        raise UserError(
            what="the object inside the shell reaches through it",
            where="inside",
            hint="lower inside.height_m, or move inside.center_m",
        )


def _how_to_fit(truth: TriangleMesh, wall: Wall, room: Floats) -> str:
    if (np.ptp(truth.vertices, axis=0) < 2.0 * room).all():
        x, y, z = wall.center_m
        return f"it has the size for it: set figure.center_m to [{x:g}, {y:g}, {z:g}]"
    return "lower figure.height_m or enlarge walls.size_m"


def _require_outside(planes: list[ScanPlane], walls: tuple[Wall, ...]) -> None:
    for number, plane in enumerate(planes):
        for wall in walls[:1]:
            beyond = np.abs(np.concatenate([plane.tx, plane.rx]) - np.asarray(wall.center_m))
            if (beyond <= 0.5 * np.asarray(wall.size_m)).all(axis=1).any():
                raise UserError(
                    what=f"plane {number} of the scan reaches into the box",
                    where="scan",
                    hint="raise its standoff_m or lower its aperture_m",
                )


def _mm(lengths: object) -> str:
    return " x ".join(f"{1e3 * v:.0f}" for v in np.asarray(lengths))


def _echo_scene(
    spec: SceneSpec,
    parts: list[TriangleMesh],
    walls: tuple[Wall, ...],
    seed: int,
    num_threads: int,
) -> EchoScene:
    truth, *held = parts
    blocker = MeshScene(truth.vertices, truth.faces, num_threads=num_threads)
    _require_held(blocker, held)
    figure, world, roughness = spec.figure, spec.world, None
    if figure.roughness_rms_m > 0:
        rng = stream(seed, "roughness")
        roughness = rough_displacement(figure.roughness_rms_m, figure.roughness_length_m, rng)
    facets, areas = mesh_elements(
        truth.vertices, truth.faces, spec.numerics.max_facet_edge_m, roughness
    )
    reflectivity, film = figure.reflectivity, _film(spec, truth)
    if film is not None:
        facets = replace(facets, reflector="slab", slab=film.plate)
    elif world.figure_permittivity:
        reflectivity *= abs(float(face_reflection(np.ones(1), world.figure_permittivity)[0]))
    areas = reflectivity * areas  # used as weights of the echo only
    if world.patch_loss_db:
        areas = areas * _patch_amplitudes(spec, facets.points, seed)
    wall_amplitude = 10.0 ** (-world.wall_loss_db / 20.0)
    traced = blocker
    if held:
        whole = TriangleMesh.joined(parts)
        traced = MeshScene(whole.vertices, whole.faces, num_threads=num_threads)
    return EchoScene(
        waveform=spec.waveform,
        walls=walls,
        blocker=blocker,
        figure=Layer(elements=facets, areas=areas),
        wall_layers=wall_layers(
            walls,
            spec.numerics.wall_patch_m,
            wall_shapes(spec, seed),
            inside_patch_m=CELL_M if world.wall_waves else None,
            inner_sides=spec.disturbance.far_walls,
        ),
        wall_waves=world.wall_waves,
        wall_amplitude=wall_amplitude,
        multipath=world.multipath and spec.disturbance.far_walls,
        tubes=_tubes(spec, traced, walls, wall_amplitude),
        second_bounce=reflectivity**2 if world.second_bounce and film is None else 0.0,
        permittivity=world.figure_permittivity,
        loss_tangent=world.figure_loss_tangent,
        film=film,
        lines=_lines(spec, seed),
        scatterers=_scatterers(spec, truth, blocker, seed),
        num_threads=num_threads,
    )


def _tubes(
    spec: SceneSpec, traced: MeshScene, walls: tuple[Wall, ...], wall_amplitude: float
) -> TubeScene | None:
    """Rays for echoes with more than one bounce; None where the world has none."""
    if not (spec.world.second_bounce or spec.world.figure_permittivity):
        return None
    return TubeScene(
        mesh=SmoothMesh(traced),
        walls=walls,
        waveform=spec.waveform,
        wall_amplitude=wall_amplitude,
    )


def _film(spec: SceneSpec, shell: TriangleMesh) -> Film | None:
    """Wall of the figure; None of a solid one."""
    world = spec.world
    if not world.figure_shell_m:
        return None
    plate = Wall(
        size_m=triple(np.ptp(shell.vertices, axis=0)),
        thickness_m=world.figure_shell_m,
        permittivity=world.figure_permittivity,
    )
    return Film(
        plate=plate,
        loss_tangent=world.figure_loss_tangent,
        n_faces=len(shell.faces),
        held_reflection=-1.0 if spec.inside is None else -spec.inside.reflectivity,
    )


def _scatterers(
    spec: SceneSpec, truth: TriangleMesh, blocker: MeshScene, seed: int
) -> Points | None:
    """Uniform points outside the object, in the innermost box or about the object."""
    if spec.disturbance.scatterer_energy_fraction <= 0:
        return None
    rng, n = stream(seed, "scatterers"), spec.disturbance.n_scatterers
    if spec.walls:
        center = np.asarray(spec.walls[-1].center_m)
        half = 0.5 * np.asarray(spec.walls[-1].size_m) - spec.walls[-1].thickness_m
    else:
        low, high = truth.vertices.min(axis=0), truth.vertices.max(axis=0)
        center, half = 0.5 * (low + high), 0.6 * (high - low)
    found = np.empty((0, 3))
    while len(found) < n:
        points = center + half * rng.uniform(-1.0, 1.0, (2 * n, 3))
        found = np.concatenate([found, points[~blocker.contains(points)]])
    return SurfaceElements(points=found[:n]), rng.normal(size=n) + 1j * rng.normal(size=n)


def _lines(spec: SceneSpec, seed: int) -> Points | None:
    """Points along edges and tape; each line has a random phase."""
    if not (spec.world.edge_energy_fraction and spec.walls):
        return None
    parts = edge_lines(spec.walls[0])
    phases = stream(seed, "lines").uniform(0.0, 2.0 * np.pi, len(parts))
    amplitudes = np.repeat(np.exp(1j * phases), [len(part) for part in parts])
    return SurfaceElements(points=np.concatenate(parts)), amplitudes


def _patch_amplitudes(spec: SceneSpec, points: Floats, seed: int) -> Floats:
    """Amplitude factor of each point of the object, (n_points,)."""
    field = rough_displacement(1.0, spec.world.patch_length_m, stream(seed, "patches"))
    weak = field(points)[:, 0] > 0.0
    return np.where(weak, 10.0 ** (-spec.world.patch_loss_db / 20.0), 1.0)


def _channel_phasors(spec: SceneSpec, seed: int, n_antennas: int) -> NDArray[np.complex64]:
    """Phasor of each antenna's channel, (n_antennas, 1)."""
    n_channels = spec.disturbance.n_channels
    normal = stream(seed, "channels").normal(size=n_channels)
    phase = np.deg2rad(spec.disturbance.channel_phase_rms_deg) * normal
    return np.asarray(np.exp(1j * phase[np.arange(n_antennas) % n_channels, None]), np.complex64)


def _energy(signals: list[NDArray[np.complex64]]) -> float:
    return float(sum(np.square(np.abs(s), dtype=np.float64).sum() for s in signals))


def _clutter(
    echoes: list[PlaneEcho], parts: list[NDArray[np.complex64] | None], energy_fraction: float
) -> list[NDArray[np.complex64]] | None:
    """Echoes of one kind, scaled to a share of the object's energy; None without any."""
    known = [part for part in parts if part is not None]
    if not known or _energy(known) == 0.0:
        return None
    wanted = energy_fraction * _energy([e.figure for e in echoes])
    scale = np.float32(np.sqrt(wanted / _energy(known)))
    return [scale * part for part in known]


def _add_disturbances(
    spec: SceneSpec, planes: list[ScanPlane], echoes: list[PlaneEcho], seed: int
) -> list[NDArray[np.complex64]]:
    """Sum of all echoes at unit mean power, with the errors and noise of the receiver."""
    world = spec.world
    signals = [e.figure + e.walls for e in echoes]
    for parts, fraction in (
        ([e.scatterers for e in echoes], spec.disturbance.scatterer_energy_fraction),
        ([e.lines for e in echoes], world.edge_energy_fraction),
    ):
        clutter = _clutter(echoes, parts, fraction)
        if clutter is not None:
            signals = [s + c for s, c in zip(signals, clutter, strict=True)]
    n_samples = sum(s.size for s in signals)
    unit = np.float32(1.0 / np.sqrt(_energy(signals) / n_samples))
    signals = [unit * s for s in signals]
    if world.leakage_db > -np.inf:
        apart = (np.linalg.norm(plane.tx - plane.rx, axis=1) for plane in planes)
        signals = [
            s + leakage(world, spec.waveform, apart_m, seed).astype(np.complex64)
            for s, apart_m in zip(signals, apart, strict=True)
        ]
    signals = [(s * _channel_phasors(spec, seed, len(s))).astype(s.dtype) for s in signals]
    signals = _add_noise(amplify(world, signals, seed), spec.disturbance.snr_db, seed)
    return convert(world, signals, seed)


def _add_noise(
    signals: list[NDArray[np.complex64]], snr_db: float, seed: int
) -> list[NDArray[np.complex64]]:
    """Add complex white noise; the signals have unit mean power."""
    if snr_db == np.inf:
        return signals
    # Complex noise of total variance 10^(-snr / 10): half in each part.
    sigma = np.float32(np.sqrt(0.5 * 10.0 ** (-snr_db / 10.0)))
    noisy = []
    for i, signal in enumerate(signals):
        parts = stream(seed, "noise", i).standard_normal((*signal.shape, 2), dtype=np.float32)
        noisy.append((signal + sigma * (parts[..., 0] + 1j * parts[..., 1])).astype(np.complex64))
    return noisy
