"""Signals of one scan plane: object, walls, scatterers."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Bools, Floats, Ints
from geraf2.ops.physical_optics import AntennaBlocks, SurfaceElements, physical_optics
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Wall
from geraf2.simulation.dielectric import n_crossings
from geraf2.simulation.elements import select, wall_elements
from geraf2.simulation.multipath import multipath_echo
from geraf2.simulation.ray_tubes import (
    Film,
    TubeScene,
    back_face,
    behind_film,
    second_bounce,
    tube_echo,
)
from geraf2.simulation.scan import block_centers
from geraf2.simulation.wall_waves import box_faces, is_square, shadow_echo
from geraf2.simulation.walls import BoxScene, WallShape

# Elements are kept while they face the block's centre to within this cosine: a facet just over
# the horizon of the centre may be lit at the block's edge, 2 cm away at 0.3 m.
_HORIZON = -0.15
# Rays leave a facet this far above it [m]; flat neighbours of a curved surface do not hide it.
_LIFT_M = 2e-5


Points = tuple[SurfaceElements, NDArray[np.complex128]]
"""Points and their complex areas before scaling, (n_points,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Layer:
    """Elements that the same boxes hide and delay."""

    elements: SurfaceElements
    """The object's facets, or the patches of walls."""
    areas: Floats
    """(n_points,) [m^2]."""
    can_be_hidden: bool = True
    """False where nothing can lie in front of the lit side."""
    walls: tuple[Wall, ...] | None = None
    """Boxes that its rays cross, where they are not the scene's."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EchoScene(BoxScene):
    """All reflectors, cut into elements once for all planes."""

    figure: Layer
    """The object."""
    wall_layers: tuple[Layer, ...] = ()
    """The walls, see :func:`wall_layers`."""
    lines: Points | None = None
    """Points along edges and tape, if any."""
    scatterers: Points | None = None
    """Random weak points, if any."""
    wall_waves: bool = False
    """Whether the object's shadow on far walls is that of a wave rather than of rays."""
    multipath: bool = False
    """Whether multipath via the walls is added."""
    tubes: TubeScene | None = None
    """Rays for echoes of the object with more than one bounce."""
    second_bounce: float = 0.0
    """Amplitude of the second bounce over that of metal; 0: none."""
    permittivity: float = 0.0
    """Relative permittivity of the object, whose back face then echoes; 0: metal."""
    loss_tangent: float = 0.0
    """Loss tangent of the object."""
    film: Film | None = None
    """Wall of the object where it is a shell, whose far side and content then echo."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaneEcho:
    """Noise-free signals of one plane by origin, each (n_antennas, n_samples)."""

    figure: NDArray[np.complex64]
    walls: NDArray[np.complex64]
    scatterers: NDArray[np.complex64] | None
    lines: NDArray[np.complex64] | None = None

    def reorder(self, rows: Ints) -> "PlaneEcho":
        """Signals of the antennas in another order, (n_antennas,)."""
        parts: dict[str, Any] = {k: None if v is None else v[rows] for k, v in vars(self).items()}
        return replace(self, **parts)


def plane_echo(scene: EchoScene, antennas: AntennaBlocks) -> PlaneEcho:
    """Echoes of everything in the scene at one plane's antennas.

    scene: all reflectors.
    antennas: the plane, in blocks that share a visibility test.
    """
    figure = _layer_echo(scene, antennas, scene.figure)
    if scene.tubes is not None:
        figure += _tubes_echo(scene, scene.tubes, antennas)
    walls = np.zeros_like(figure)
    if scene.multipath:
        walls += multipath_echo(scene.figure.elements, scene.figure.areas, antennas, scene)
    for layer in scene.wall_layers:
        walls += _wall_echo(scene, antennas, layer)
    return PlaneEcho(
        figure=figure,
        walls=walls,
        scatterers=_points_echo(scene, antennas, scene.scatterers),
        lines=_points_echo(scene, antennas, scene.lines),
    )


def _tubes_echo(
    scene: EchoScene, tubes: TubeScene, antennas: AntennaBlocks
) -> NDArray[np.complex64]:
    """Second bounces on the object, and echoes of its back face or from inside a shell."""
    centers = block_centers(antennas)

    def block_echo(number: int) -> NDArray[np.complex64]:
        rows = slice(antennas.offsets[number], antennas.offsets[number + 1])
        tx, rx = antennas.tx[rows], antennas.rx[rows]
        found = np.zeros((len(tx), scene.waveform.n_samples), dtype=np.complex64)
        if scene.second_bounce:
            twice = second_bounce(tubes, centers[number], antennas)
            found += np.float32(scene.second_bounce) * tube_echo(twice, tx, rx, scene.waveform)
        if scene.film is not None:
            back = behind_film(tubes, centers[number], antennas, scene.film)
            found += tube_echo(back, tx, rx, scene.waveform)
        elif scene.permittivity:
            material = (scene.permittivity, scene.loss_tangent)
            back = back_face(tubes, centers[number], antennas, material)
            found += tube_echo(back, tx, rx, scene.waveform)
        return found

    with ThreadPoolExecutor(scene.num_threads) as pool:
        return np.concatenate(list(pool.map(block_echo, range(len(centers)))))


def _points_echo(
    scene: EchoScene, antennas: AntennaBlocks, points: Points | None
) -> NDArray[np.complex64] | None:
    if points is None:
        return None
    elements, amplitudes = points
    seen = _visibility(scene.blocker, elements, antennas)
    return _echo(scene, antennas, elements, seen * amplitudes)


def _wall_echo(scene: EchoScene, antennas: AntennaBlocks, layer: Layer) -> NDArray[np.complex64]:
    if not (scene.wall_waves and layer.can_be_hidden):
        return _layer_echo(scene, antennas, layer)
    waves = scene if layer.walls is None else replace(scene, walls=layer.walls)
    signal = np.zeros((len(antennas.tx), scene.waveform.n_samples), dtype=np.complex64)
    for rows in box_faces(layer.elements):
        face = replace(layer, elements=select(layer.elements, rows), areas=layer.areas[rows])
        if is_square(face.elements, antennas, scene.blocker):
            # The unshadowed echo, and its change by the object.
            signal += _layer_echo(scene, antennas, replace(face, can_be_hidden=False))
            signal += shadow_echo(waves, face.elements, face.areas, antennas)
        else:
            signal += _layer_echo(scene, antennas, face)
    return signal


def _layer_echo(scene: EchoScene, antennas: AntennaBlocks, layer: Layer) -> NDArray[np.complex64]:
    blocker = scene.blocker if layer.can_be_hidden else None
    seen = _visibility(blocker, layer.elements, antennas)
    used = np.asarray(seen.any(axis=0))
    weights = seen[:, used] * layer.areas[used]
    return _echo(scene, antennas, select(layer.elements, used), weights, layer.walls)


def _echo(
    scene: EchoScene,
    antennas: AntennaBlocks,
    elements: SurfaceElements,
    weights: NDArray[np.floating | np.complexfloating],
    walls: tuple[Wall, ...] | None = None,
) -> NDArray[np.complex64]:
    walls = scene.walls if walls is None else walls
    if scene.wall_amplitude != 1.0:
        crossed = 2 * n_crossings(block_centers(antennas), elements.points, walls)
        weights = weights * scene.wall_amplitude**crossed
    if elements.slab in scene.walls:
        elements = replace(elements, slab_crossing=scene.wall_amplitude)
    signal = physical_optics(
        elements,
        weights.astype(np.complex64),
        antennas,
        scene.waveform,
        walls=walls,
        num_threads=scene.num_threads,
    )
    return signal.astype(np.complex64, copy=False)


def _visibility(
    blocker: MeshScene | None, elements: SurfaceElements, antennas: AntennaBlocks
) -> Bools:
    """Whether each block's centre sees each element, (n_blocks, n_points)."""
    centers = block_centers(antennas)
    seen = np.zeros((len(centers), elements.points.shape[0]), dtype=np.bool_)
    normals = elements.normals
    starts = elements.points if normals is None else elements.points + _LIFT_M * normals
    for block, center in enumerate(centers):
        if normals is None:
            facing = np.arange(starts.shape[0])
        else:
            toward = center - elements.points
            cosine = np.einsum("pi,pi->p", toward, normals) / np.linalg.norm(toward, axis=1)
            facing = np.flatnonzero(cosine > _HORIZON)
        if blocker is None:
            seen[block, facing] = True
        else:
            targets = np.broadcast_to(center, (facing.size, 3))
            seen[block, facing] = ~blocker.occluded(starts[facing], targets)
    return seen


def wall_layers(
    walls: Sequence[Wall],
    patch_m: float,
    shapes: Sequence[WallShape | None] | None = None,
    *,
    inside_patch_m: float | None = None,
    inner_sides: bool = True,
) -> tuple[Layer, ...]:
    """Both faces of every wall, as seen from outside and from inside its box.

    walls: the boxes.
    patch_m: largest side of a patch [m].
    shapes: deviation of each box's walls from their planes; all plane when None.
    inside_patch_m: largest side of a patch of the inner sides; as the others when None [m].
    inner_sides: whether walls echo as seen from inside their box, too.
    """
    layers = []
    for number, wall in enumerate(walls):
        shape = None if shapes is None else shapes[number]
        for inside in (False, True)[: 1 + inner_sides]:
            side_m = inside_patch_m if inside and inside_patch_m else patch_m
            patches, areas = wall_elements(wall, side_m, inside=inside, shape=shape)
            # The object lies within all boxes: it hides their inner sides only.
            layers.append(
                Layer(
                    elements=patches,
                    areas=areas,
                    can_be_hidden=inside,
                    walls=None if shape is None else _find_crossed(walls, number, shape, inside),
                )
            )
    return tuple(layers)


def _find_crossed(
    walls: Sequence[Wall], number: int, shape: WallShape, inside: bool
) -> tuple[Wall, ...]:
    """Boxes that rays to a bulged wall cross, none of which its patches stick into."""
    # To its outer side: the boxes around it. To its inner side: also its own, enlarged: a plane
    # slab's path depends on the angle of crossing, not on the slab's position.
    outer = tuple(walls[:number])
    if not inside:
        return outer
    own, more = walls[number], 2.0 * shape.reach_m
    x, y, z = own.size_m
    return (*outer, replace(own, size_m=(x + more, y + more, z + more)), *walls[number + 1 :])
