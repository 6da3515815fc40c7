"""Layers of a live view of a run or a scene: surfaces, points and lines, in metres."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from geraf2._types import Array, Bytes, Floats, Ints
from geraf2.echoes.glint_set import Glints
from geraf2.errors import UserError
from geraf2.geometry.boxes import FACES, box_corners
from geraf2.geometry.transforms import triple
from geraf2.io.array_layouts import read_arrays
from geraf2.io.container import is_scene
from geraf2.io.mesh import TriangleMesh
from geraf2.io.mesh_colours import error_colours
from geraf2.io.run_folder import IMAGE_NAME, TRUTH_COPY
from geraf2.report.canvas import load_matplotlib
from geraf2.report.run_report import read_run, stored_truth
from geraf2.scene import Grid
from geraf2.scene.store import open_capture

Rgb = tuple[int, int, int]
_BOX, _TRUTH, _GLINT, _PLANE = (176, 141, 87), (0, 114, 178), (213, 94, 0), (86, 180, 233)
_NORMAL_M = 0.004
"""Length of the line along a glint's normal [m]."""
_MAX_ANTENNAS = 2000
"""Most antennas shown of a plane."""
_RANGE_DB = 40.0
"""Range of the colours of a matched-filter volume, below its maximum [dB]."""
_DISTANCE_M = 0.02
"""Range of the colours of a signed distance, on either side [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Layer:
    """A layer that can be hidden."""

    name: str
    """Name in the list."""
    kind: Literal["mesh", "points", "lines"]
    """Meaning of `points`: vertices, positions, or pairs of ends of lines."""
    points: Floats
    """(n, 3) [m]."""
    faces: Ints | None = None
    """Of a mesh, (n_faces, 3)."""
    colours: Bytes | None = None
    """Colour of each point, (n, 3); `colour` when None."""
    colour: Rgb = (190, 190, 190)
    """Common colour."""
    opacity: float = 1.0
    """1: solid."""
    visible: bool = True
    """Initial state."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Volume:
    """Values on a grid, shown as slices."""

    name: str
    """Name in the list."""
    grid: Grid
    """Positions of the values."""
    values: Array
    """At voxel centres, grid.shape."""
    colour_map: str
    """Name of a colour map of matplotlib."""
    limits: tuple[float, float]
    """Values at its ends."""

    def slice(self, axis: int, index: int) -> Layer:
        """Slice across an axis as a mesh with a colour for each voxel.

        axis: 0, 1 or 2. index: of the voxels along it.
        """
        mpl = load_matplotlib()
        first, second = (a for a in range(3) if a != axis)
        u, v = self.grid.axes_m[first], self.grid.axes_m[second]
        points = np.zeros((len(u), len(v), 3))
        points[..., axis] = self.grid.axes_m[axis][index]
        points[..., first], points[..., second] = u[:, None], v[None, :]
        low, high = self.limits
        level = (np.take(self.values, index, axis=axis) - low) / (high - low)
        colours = mpl.colormaps[self.colour_map](np.clip(level, 0.0, 1.0))[..., :3]
        corner = np.arange(len(u) * len(v)).reshape(len(u), len(v))
        a, b = corner[:-1, :-1].reshape(-1), corner[1:, :-1].reshape(-1)
        c, d = corner[1:, 1:].reshape(-1), corner[:-1, 1:].reshape(-1)
        return Layer(
            name=f"{self.name} across {'xyz'[axis]}",
            kind="mesh",
            points=points.reshape(-1, 3),
            faces=np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]),
            colours=np.rint(255.0 * colours).astype(np.uint8).reshape(-1, 3),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Source:
    """A run or a scene."""

    name: str
    """Name of its folder."""
    layers: tuple[Layer, ...]
    """Layers without slices and planes."""
    planes: tuple[Layer, ...] = ()
    """Planes of antennas in order, shown one by one."""
    volumes: tuple[Volume, ...] = ()
    """Volumes for slices."""

    @property
    def size_m(self) -> float:
        """Largest extent of the layers [m]."""
        spans = [np.ptp(layer.points, axis=0).max() for layer in self.layers if len(layer.points)]
        return float(max(spans, default=0.2))

    def shifted(self, by_m: Floats) -> "Source":
        """Return the source displaced by a vector (3,) [m]."""
        layers = [replace(layer, points=layer.points + by_m) for layer in self.layers]
        planes = [replace(plane, points=plane.points + by_m) for plane in self.planes]
        volumes = [
            replace(v, grid=replace(v.grid, origin_m=triple(np.add(v.grid.origin_m, by_m))))
            for v in self.volumes
        ]
        return replace(self, layers=tuple(layers), planes=tuple(planes), volumes=tuple(volumes))


def source_of(path: Path | str) -> Source:
    """Layers, planes and volumes of a run folder or a scene; UserError for anything else."""
    folder = Path(path)
    source = _of_scene(folder) if is_scene(folder) else _of_run(folder)
    if not source.layers and not source.volumes and not source.planes:
        raise UserError(what="holds nothing to show yet", where=folder)
    return source


def _of_run(folder: Path) -> Source:
    run = read_run(folder)
    layers: list[Layer] = []
    if run.surface is not None:
        errors = run.surface.expected_error_m
        colours = error_colours(errors, len(run.surface.vertices))
        layers.append(_mesh("content", run.surface, colours=colours))
    if run.box is not None and len(run.box.faces):
        layers.append(_mesh("box", run.box, colour=_BOX, opacity=0.2))
    truth = folder / TRUTH_COPY
    if truth.is_file() and "scores" in run.metrics:
        mesh, _ = stored_truth(truth)
        layers.append(_mesh("truth", mesh, colour=_TRUTH, opacity=0.5, visible=False))
    if run.glints is not None and len(run.glints):
        layers += _glints(run.glints)
    planes = () if run.planes_m is None else tuple(run.planes_m)
    volumes = []
    if run.sdf is not None:
        grid, values, limits = run.sdf.grid, run.sdf.values, (-_DISTANCE_M, _DISTANCE_M)
        volumes.append(
            Volume(name="distance", grid=grid, values=values, colour_map="RdBu", limits=limits)
        )
    if (folder / IMAGE_NAME).is_file():
        volumes.append(_image(folder / IMAGE_NAME))
    return Source(
        name=folder.resolve().name,
        layers=tuple(layers),
        planes=tuple(_outline(f"plane {n}", corners) for n, corners in enumerate(planes)),
        volumes=tuple(volumes),
    )


def _of_scene(folder: Path) -> Source:
    capture = open_capture(folder)
    layers = [
        Layer(
            name="box" if len(capture.walls) == 1 else f"box {n}",
            kind="mesh",
            points=box_corners(wall.center_m, wall.size_m),
            faces=FACES,
            colour=_BOX,
            opacity=0.2,
        )
        for n, wall in enumerate(capture.walls, 1)
    ]
    planes = []
    for n, pose in enumerate(capture.poses):
        step = max(1, len(pose.tx_positions) // _MAX_ANTENNAS)
        points = np.asarray(pose.phase_centers[::step], dtype=np.float64)
        planes.append(Layer(name=f"plane {n}", kind="points", points=points, colour=_PLANE))
    return Source(name=folder.resolve().name, layers=tuple(layers), planes=tuple(planes))


def _image(path: Path) -> Volume:
    """Matched-filter volume in decibels below its largest value."""
    layouts = {"volume": "float x y z", "origin_m": "float 3", "spacing_m": "float"}
    stored = read_arrays(path, layouts)
    nx, ny, nz = stored["volume"].shape
    origin_m = triple(stored["origin_m"])
    try:
        grid = Grid(origin_m=origin_m, spacing_m=float(stored["spacing_m"]), shape=(nx, ny, nz))
    except ValueError as error:
        raise UserError(what=f"no volume on a grid: {error}", where=path) from None
    relative = np.abs(stored["volume"]) / max(float(np.abs(stored["volume"]).max()), 1e-30)
    decibels = 20.0 * np.log10(np.maximum(relative, 1e-6))
    limits = (-_RANGE_DB, 0.0)
    return Volume(
        name="matched filter", grid=grid, values=decibels, colour_map="magma", limits=limits
    )


def _mesh(name: str, mesh: TriangleMesh, **style: Any) -> Layer:
    return Layer(name=name, kind="mesh", points=mesh.vertices, faces=mesh.faces, **style)


def _glints(glints: Glints) -> list[Layer]:
    ends = np.stack([glints.positions, glints.positions + _NORMAL_M * glints.normals], axis=1)
    points, lines = glints.positions, ends.reshape(-1, 3)
    style: dict[str, Any] = {"colour": _GLINT, "visible": False}
    return [
        Layer(name="glints", kind="points", points=points, **style),
        Layer(name="normals of glints", kind="lines", points=lines, **style),
    ]


def _outline(name: str, corners: Floats) -> Layer:
    """Rectangle as four lines, (4, 3) [m]."""
    ends = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1).reshape(-1, 3)
    return Layer(name=name, kind="lines", points=ends, colour=_PLANE)
