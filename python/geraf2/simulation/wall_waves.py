"""Echo of a far wall that the object shadows, by waves: the integral of (U0 + Us)^2 over the wall.

U0 is the free field of the antenna, Us that of a Kirchhoff sheet over the object's rim.
:mod:`geraf2.simulation.echo` computes the wall's echo without the object; this module computes its
change by the object (docs/math/echo-models.md#far-walls-by-waves).
"""

import itertools
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Bools, Floats, Ints
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.ops.physical_optics import AntennaBlocks, SurfaceElements
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Waveform
from geraf2.simulation.dielectric import cross_walls, phasors, slab_reflection
from geraf2.simulation.shadow_waves import (
    REFINE,
    FaceFrame,
    Lattice,
    Shadow,
    lattice_over,
    rim_edges,
)
from geraf2.simulation.walls import BoxScene

SQUARE = 0.5
"""Cosine of the incidence on a wall above which its shadow is computed by waves; at lower ones the
wall has no specular return."""
ABOVE = 1.5
"""Least height of antennas over a wall, in heights of the object: no shadow is then longer than
three objects."""
CELL_M = 0.0025
"""Cells of sheet and field, and of the walls [m]."""
BLOCK_M = 0.025
"""Antennas that share one shadow, shifted for each, lie within this: 1 cm at 0.4 m moves a rim 2 cm
before or behind the sheet by half a millimetre [m]."""
_FRINGE_M = 0.04
"""Width beyond the shadow over which the object changes the field: three Fresnel zones [m]."""
_PAIRS_PER_STEP = 60_000
"""Antennas times patches computed at once: their phasors stay in a core's cache."""


def box_faces(elements: SurfaceElements) -> Iterator[Bools]:
    """Patches of each face of a box that is turned by less than 45 degrees: masks (n_points,)."""
    normals = elements.normals
    assert normals is not None
    along = np.abs(normals).argmax(axis=1)
    side = np.take_along_axis(normals, along[:, None], axis=1)[:, 0] > 0.0
    label = 2 * along + side
    for number in np.unique(label):
        yield label == number


def is_square(face: SurfaceElements, antennas: AntennaBlocks, blocker: MeshScene) -> bool:
    """Whether antennas see a face so squarely that its shadow is computed by waves.

    From little above the object the shadow and its sheet have no bounds.
    """
    frame = face_frame(face)
    eyes = frame.to_local(0.5 * (antennas.tx + antennas.rx))
    eye, top = eyes.mean(axis=0), frame.to_local(blocker.vertices)[:, 2].max()
    is_above = eyes[:, 2].min() > ABOVE * top
    return bool(is_above and eye[2] > SQUARE * np.linalg.norm(eye))


def shadow_echo(
    scene: BoxScene, face: SurfaceElements, areas: Floats, antennas: AntennaBlocks
) -> NDArray[np.complex64]:
    """Echo that the object adds to that of an unshadowed face: r (V^2 - 1) U0^2 over the face.

    V = (U0 + Us) / U0 is computed for the middle of a block of antennas, as a function of where the
    path to the wall crosses the sheet; U0 is that of each transmitter and each receiver.

    scene: object and walls.
    face: patches of one wall, both of whose faces echo; bulged or not.
    areas: of the patches, (n_points,) [m^2].
    antennas: of one plane.

    Returns the signal, (n_antennas, n_samples).
    """
    frame = face_frame(face)
    middles = 0.5 * (antennas.tx + antennas.rx)
    sheet, height_m = _sheet(scene, frame, middles)
    path_m, spread_m = _shadow_paths(frame, sheet, height_m, face, middles)
    frequencies = node_frequencies(scene.waveform, spread_m)
    blocks = list(_small_blocks(middles, BLOCK_M))
    local = frame.to_local(face.points)
    margin = 6.0 * CELL_M + BLOCK_M * height_m / (frame.to_local(middles)[:, 2].min() - height_m)
    lattice = lattice_over(local[:, :2].min(0) - margin, local[:, :2].max(0) + margin, CELL_M)
    work = partial(
        _block_echo,
        scene=scene,
        face=face,
        areas=areas,
        frame=frame,
        shadow=Shadow(scene.blocker, frame, sheet, lattice, height_m, frequencies),
        antennas=antennas,
    )
    nodes = np.empty((len(middles), len(frequencies)), dtype=np.complex128)
    with ThreadPoolExecutor(scene.num_threads) as pool:
        for rows, values in zip(blocks, pool.map(work, blocks), strict=True):
            nodes[rows] = values
    # Interpolated after division by the phase of the mean path of the shadow.
    wanted = scene.waveform.frequencies_hz
    carrier = 2j * np.pi / SPEED_OF_LIGHT_M_PER_S * (path_m[:, None] + scene.waveform.path_bias_m)
    slow = nodes * np.exp(carrier * frequencies)
    found = (slow @ _interpolation(frequencies, wanted)) * np.exp(-carrier * wanted)
    return np.asarray(found.astype(np.complex64))


def face_frame(face: SurfaceElements) -> FaceFrame:
    """Plane of a face's patches, its normal their mean's."""
    assert face.normals is not None
    assert face.edges is not None
    normal = face.normals.mean(axis=0)
    normal /= np.linalg.norm(normal)
    along = face.edges[:, 0].mean(axis=0)
    along -= (along @ normal) * normal
    along /= np.linalg.norm(along)
    rows = np.stack([along, np.cross(normal, along), normal])
    local = face.points @ rows.T
    return FaceFrame(origin=0.5 * (local.min(axis=0) + local.max(axis=0)) @ rows, rows=rows)


def _shadow_paths(
    frame: FaceFrame, sheet: Lattice, height_m: float, face: SurfaceElements, middles: Floats
) -> tuple[Floats, float]:
    """Middle of the two-way paths over the shadow, (n_antennas,), and their largest spread [m]."""
    local, eyes = frame.to_local(face.points)[:, :2], frame.to_local(middles)
    share = (eyes[:, 2] / (eyes[:, 2] - height_m))[:, None]
    last = sheet.first + sheet.cell_m * (np.asarray(sheet.shape) - 1)
    low, high = (
        np.clip(at + share * (corner - at) + pad, local.min(axis=0), local.max(axis=0))
        for corner, pad in ((sheet.first, -_FRINGE_M), (last, _FRINGE_M))
        for at in (eyes[:, :2],)
    )
    near = np.clip(eyes[:, :2], low, high) - eyes[:, :2]
    far = np.maximum(np.abs(low - eyes[:, :2]), np.abs(high - eyes[:, :2]))
    shortest, longest = (np.hypot(np.hypot(*off.T), eyes[:, 2]) for off in (near, far))
    return shortest + longest, float(2.0 * (longest - shortest).max())


def node_frequencies(waveform: Waveform, spread_m: float) -> Floats:
    """Equidistant frequencies from which those of a waveform are interpolated, (n_nodes,) [Hz].

    spread_m: largest difference of the paths, once their middle is subtracted [m].
    """
    wanted = waveform.frequencies_hz
    low, high = float(wanted.min()), float(wanted.max())
    # Half of the change of phase over the band, c: 1.6 c + 2 nodes leave 0.004 of the echo at most.
    half = np.pi * (high - low) * 0.5 * spread_m / SPEED_OF_LIGHT_M_PER_S
    n = min(len(wanted), int(np.ceil(1.6 * half)) + 2)
    return np.linspace(low, high, n) if n > 1 else np.array([low])


def _interpolation(nodes: Floats, wanted: Floats) -> Floats:
    """Polynomial through values at the nodes, (n_nodes, n_wanted)."""
    if len(nodes) == 1:
        return np.ones((1, len(wanted)))
    scaled = [(2.0 * f - nodes[0] - nodes[-1]) / (nodes[-1] - nodes[0]) for f in (nodes, wanted)]
    there, here = (np.polynomial.chebyshev.chebvander(s, len(nodes) - 1) for s in scaled)
    return np.asarray(np.linalg.solve(there.T, here.T))


def _sheet(scene: BoxScene, frame: FaceFrame, middles: Floats) -> tuple[Lattice, float]:
    """Cells that hold the shadow on a plane through the rim, for all antennas, and its height."""
    eye = middles.mean(axis=0)
    rim = frame.to_local(rim_edges(scene.blocker.vertices, scene.blocker.faces, eye))
    height_m = float(rim[:, 2].mean())
    vertices, eyes = frame.to_local(scene.blocker.vertices), frame.to_local(middles)
    low, high = [], []
    # The shadow on a plane is monotonic in the eye: corners of the antennas' box bound it.
    for corner in itertools.product(*zip(eyes.min(axis=0), eyes.max(axis=0), strict=True)):
        there = np.asarray(corner)
        share = (there[2] - height_m) / (there[2] - vertices[:, 2:])
        cast = there[:2] + share * (vertices[:, :2] - there[:2])
        low.append(cast.min(axis=0))
        high.append(cast.max(axis=0))
    lattice = lattice_over(np.min(low, axis=0), np.max(high, axis=0), CELL_M / REFINE)
    return lattice, height_m


def _small_blocks(middles: Floats, side_m: float) -> Iterator[Ints]:
    """Rows of the antennas in each block of a raster, no longer than the limit."""
    label = np.zeros(len(middles), dtype=np.int64)
    for axis in range(3):
        first, extent = middles[:, axis].min(), np.ptp(middles[:, axis])
        n = max(1, int(np.ceil(extent / side_m)))
        cell = np.clip((middles[:, axis] - first) / max(extent, 1e-12) * n, 0, n - 1)
        label = label * n + cell.astype(np.int64)
    for number in np.unique(label):
        yield np.flatnonzero(label == number)


def _block_echo(
    rows: Ints,
    *,
    scene: BoxScene,
    face: SurfaceElements,
    areas: Floats,
    frame: FaceFrame,
    shadow: Shadow,
    antennas: AntennaBlocks,
) -> NDArray[np.complex128]:
    """Change of the echo at some antennas and the nodes, (n_rows, n_nodes)."""
    tx, rx = antennas.tx[rows], antennas.rx[rows]
    middles = 0.5 * (tx + rx)
    eye = middles.mean(axis=0)
    weights, used = _patch_weights(scene, face, areas, antennas, eye, shadow.frequencies_hz)
    points = face.points[used]
    shift = (
        -shadow.displace(frame.to_local(middles), frame.to_local(eye[None])[0]) / shadow.wall.cell_m
    )
    reach = max(1, int(np.ceil(np.abs(shift).max())))
    u, v = (shift / reach).T
    # Quadratic in the shift, through the positions of the stencil.
    shares = np.stack(
        (
            1 - u**2 - v**2 + u * v,
            *((u**2 + u) / 2 - u * v, (u**2 - u) / 2),
            *((v**2 + v) / 2 - u * v, (v**2 - v) / 2),
            u * v,
        )
    )
    change = shadow.change(eye)
    parts = _sample(change, shadow.wall, frame.to_local(points)[:, :2], reach) * weights
    by_node = np.ascontiguousarray(np.transpose(parts, (2, 1, 0)))  # node, patch, stencil
    found = np.empty((len(rows), len(shadow.frequencies_hz)), dtype=np.complex128)
    n_step = max(1, _PAIRS_PER_STEP // max(1, len(points)))
    for start in range(0, len(rows), n_step):
        part = slice(start, start + n_step)
        ranges = [_distances(positions[part], points) for positions in (tx, rx)]
        wave = phasors(ranges[0] + ranges[1] + scene.waveform.path_bias_m, shadow.frequencies_hz)
        wave *= (1.0 / (ranges[0] * ranges[1])).astype(np.float32)
        found[part] = np.einsum("fak,ka->af", wave @ by_node, shares[:, part])
    return found


def _distances(antennas: Floats, points: Floats) -> Floats:
    # About the points' middle: the products then lose 1e-16 of a square of decimetres.
    middle = points.mean(axis=0)
    a, p = antennas - middle, points - middle
    square = (a**2).sum(axis=1)[:, None] + (p**2).sum(axis=1) - 2.0 * (a @ p.T)
    return np.asarray(np.sqrt(square))


_STENCIL = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1))


def _sample(
    values: NDArray[np.complex64], lattice: Lattice, positions: Floats, reach: int
) -> NDArray[np.complex64]:
    """Rows (n_cells, n_nodes) about positions (n, 2) [m], bilinear -> (n_stencil, n, n_nodes)."""
    cells = (positions - lattice.first) / lattice.cell_m
    low = np.floor(cells).astype(np.int64)
    part = (cells - low).astype(np.float32)
    found = np.zeros((len(_STENCIL), len(positions), values.shape[1]), dtype=np.complex64)
    for number, step in enumerate(_STENCIL):
        for corner in itertools.product(range(2), range(2)):
            weight = np.abs(1.0 - np.array(corner, np.float32) - part).prod(axis=1)
            if weight.max() < 1e-6:
                continue
            at = np.clip(low + reach * np.array(step) + corner, 0, np.array(lattice.shape) - 1)
            found[number] += weight[:, None] * values[at[:, 0] * lattice.shape[1] + at[:, 1]]
    return found


def _patch_weights(
    scene: BoxScene,
    face: SurfaceElements,
    areas: Floats,
    antennas: AntennaBlocks,
    eye: Floats,
    frequencies_hz: Floats,
) -> tuple[NDArray[np.complex64], Bools]:
    """Integrand without ranges and shadow, for a block's middle, (n_used, n_nodes)."""
    assert face.slab is not None
    assert face.normals is not None
    assert face.edges is not None
    toward = eye - face.points
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    cosine = np.einsum("pi,pi->p", toward, face.normals)
    used = cosine > 0.0
    toward, cosine, points = toward[used], cosine[used], face.points[used]
    crossed, excess_m = cross_walls(points, eye, scene.walls, scene.wall_amplitude)
    gain = np.maximum(-toward @ antennas.boresight, 0.0) ** (2 * antennas.pattern_exponent)
    real = areas[used] * cosine * crossed**2 * gain
    weights = phasors(2.0 * excess_m, frequencies_hz).T
    weights *= slab_reflection(cosine, face.slab, frequencies_hz, crossing=scene.wall_amplitude)
    k = 2.0 * np.pi * frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    for edge in np.moveaxis(face.edges[used], 1, 0):
        # The phase is linear over a patch; sin(x) / x varies little over the band: two nodes do.
        at = [np.sinc(2.0 / np.pi * q * np.einsum("pi,pi->p", edge, toward)) for q in (k[0], k[-1])]
        share = np.linspace(0.0, 1.0, len(k), dtype=np.float32)
        weights *= (
            at[0].astype(np.float32)[:, None] * (1 - share)
            + at[1].astype(np.float32)[:, None] * share
        )
    weights *= (1j / (4.0 * np.pi) * real).astype(np.complex64)[:, None]
    return weights, used
