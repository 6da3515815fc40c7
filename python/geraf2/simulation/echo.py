"""Signals of one scan plane: object, walls, scatterers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Bools, Floats
from geraf2.ops.physical_optics import AntennaBlocks, SurfaceElements, physical_optics
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Wall, Waveform
from geraf2.simulation.elements import wall_elements

# Elements are kept while they face the block's centre to within this cosine: a facet just over
# the horizon of the centre may be lit at the block's edge, 2 cm away at 0.3 m.
_HORIZON = -0.15
# Rays leave a facet this far above it [m]; flat neighbours of a curved surface do not hide it.
_LIFT_M = 2e-5


@dataclass(frozen=True, kw_only=True, eq=False)
class Layer:
    """Elements that lie in the same places, and are thus seen and hidden together."""

    elements: tuple[SurfaceElements, ...]
    """The figure's facets, or both faces of a wall; equal points and normals."""
    areas: Floats
    """(n_points,) [m^2]."""
    can_be_hidden: bool = True
    """False where nothing can stand before the side that is lit."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EchoScene:
    """Everything that echoes, cut into elements once for all planes."""

    waveform: Waveform
    walls: tuple[Wall, ...]
    blocker: MeshScene
    """What hides: the metal object. Walls weaken and delay, they hide nothing."""
    figure: Layer
    """The object."""
    wall_layers: tuple[Layer, ...] = ()
    """The walls, see :func:`wall_layers`."""
    scatterers: SurfaceElements | None = None
    """Random weak points, if any."""
    scatterer_amplitudes: NDArray[np.complex128] | None = None
    """Their complex areas before scaling, (n_scatterers,)."""
    num_threads: int = 1


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaneEcho:
    """Noise-free signals of one plane by origin, each (n_antennas, n_samples)."""

    figure: NDArray[np.complex64]
    walls: NDArray[np.complex64]
    scatterers: NDArray[np.complex64] | None


def plane_echo(scene: EchoScene, antennas: AntennaBlocks) -> PlaneEcho:
    """Echoes of everything in the scene at one plane's antennas.

    scene: what echoes.
    antennas: the plane, in blocks that share a visibility test.
    """
    figure = _layer_echo(scene, antennas, scene.figure)
    walls = np.zeros_like(figure)
    for layer in scene.wall_layers:
        walls += _layer_echo(scene, antennas, layer)
    scatterers = None
    if scene.scatterers is not None and scene.scatterer_amplitudes is not None:
        seen = _visibility(scene.blocker, scene.scatterers, antennas)
        scatterers = _echo(scene, antennas, scene.scatterers, seen * scene.scatterer_amplitudes)
    return PlaneEcho(figure=figure, walls=walls, scatterers=scatterers)


def _layer_echo(scene: EchoScene, antennas: AntennaBlocks, layer: Layer) -> NDArray[np.complex64]:
    blocker = scene.blocker if layer.can_be_hidden else None
    seen = _visibility(blocker, layer.elements[0], antennas)
    used = np.asarray(seen.any(axis=0))
    weights = seen[:, used] * layer.areas[used]
    first, *rest = (
        _echo(scene, antennas, _select(elements, used), weights) for elements in layer.elements
    )
    for signal in rest:
        first += signal
    return first


def _echo(
    scene: EchoScene,
    antennas: AntennaBlocks,
    elements: SurfaceElements,
    weights: NDArray[np.floating | np.complexfloating],
) -> NDArray[np.complex64]:
    signal = physical_optics(
        elements,
        weights.astype(np.complex64),
        antennas,
        scene.waveform,
        walls=scene.walls,
        num_threads=scene.num_threads,
    )
    return signal.astype(np.complex64, copy=False)


def _select(elements: SurfaceElements, used: Bools) -> SurfaceElements:
    return SurfaceElements(
        points=elements.points[used],
        normals=None if elements.normals is None else elements.normals[used],
        edges=None if elements.edges is None else elements.edges[used],
        shape=elements.shape,
        reflector=elements.reflector,
        slab=elements.slab,
    )


def _visibility(
    blocker: MeshScene | None, elements: SurfaceElements, antennas: AntennaBlocks
) -> Bools:
    """Whether each block's centre sees each element, (n_blocks, n_points)."""
    n_blocks = antennas.offsets.shape[0] - 1
    seen = np.zeros((n_blocks, elements.points.shape[0]), dtype=np.bool_)
    centers = 0.5 * (antennas.tx + antennas.rx)
    normals = elements.normals
    starts = elements.points if normals is None else elements.points + _LIFT_M * normals
    for block in range(n_blocks):
        center = centers[antennas.offsets[block] : antennas.offsets[block + 1]].mean(axis=0)
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


def wall_layers(walls: Sequence[Wall], patch_m: float) -> tuple[Layer, ...]:
    """Both faces of every wall, as seen from outside and from inside its box.

    walls: the boxes.
    patch_m: largest side of a patch [m].
    """
    layers = []
    for wall in walls:
        for inside in (False, True):
            pair, areas = wall_elements(wall, patch_m, inside=inside)
            # The object lies within all boxes: it stands before their inner sides only.
            layers.append(Layer(elements=pair, areas=areas, can_be_hidden=inside))
    return tuple(layers)
