"""Silhouettes: the content's shadow in the specular return of the box's far walls.

An antenna on a wall's normal also receives the far wall's flash, unless the content blocks it. Over
the antennas of a plane, the flash is a hologram of the content's outline, projected along the
normal. In a horizontal scan it is the only evidence of tops and bottoms
(docs/math/free-space.md#silhouettes).
"""

from collections import defaultdict
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray
from scipy.ndimage import (
    binary_erosion,
    distance_transform_edt,
    gaussian_filter,
    label,
    laplace,
    map_coordinates,
)
from scipy.special import fresnel
from skimage.measure import find_contours

from geraf2._bounds import Bounded, CellM, OpenShare
from geraf2._types import AnyPath, Bools, Floats, Ints
from geraf2._validation import require_shape
from geraf2.echoes.echo_phases import response_at
from geraf2.freespace.holograms import Flash, covered, focal_lengths_m, hologram
from geraf2.freespace.wall_shape import path_shape
from geraf2.io.array_layouts import read_arrays
from geraf2.io.atomic import write_npz_atomic
from geraf2.scene import Capture, Pose, Wall

_FOCUSES = np.linspace(0.0, 1.0, 9)
"""Focal lengths that are tried, from one pass of the content to two."""
_TILTS = 17
"""Number of wall tilts that are tried along each side, in each of two rounds."""
_MIN_ANTENNAS = 100
_FLAT_M = 1e-4
"""A wall with a smaller RMS error of the two-way path counts as flat [m]."""
_REFINE = 4
"""Cells of the outline's distance map per cell of the hologram, along each axis."""
_FREE = 0.2
"""Largest deviation from 1 of a free line's transmission, and of a flash that the wall's edges
attenuate."""
_THIN, _BLUR_M = 0.7, 0.008
"""Largest transmission of a part too thin to block the flash; squared for two passes. Nearer than
the second value [m] to a blocked line of sight, it may be the blur of an edge."""
_EDGE = 0.5
"""Relative field at the edge of a half plane."""


@dataclass(frozen=True, kw_only=True)
class SilhouetteConfig(Bounded):
    """Settings of the detection of far walls' flashes and shadows."""

    spacing_m: CellM = 0.002
    """Cell size of the outline [m]."""
    aperture: Annotated[float, Interval(gt=0.0, le=100.0)] = 1.2
    """Standard deviation of the antennas' weight around a cell's foot point, in Fresnel zones."""
    max_tilt_deg: Annotated[float, Interval(gt=0.0, le=45.0)] = 2.0
    """Largest tilt of the box against its frame [degrees]."""
    min_free: OpenShare = 0.25
    """Least share of a plane's cells with an unshadowed flash; below it the plane is not used."""


OUTLINES_VERSION = 1
"""Increase when :func:`find_silhouettes` returns something else for the same capture."""

_LAYOUTS = {
    "axes": "int n",
    "origins_m": "float n 2",
    "spacing_m": "float",
    "transmission": "float n u v",
    "known": "bool n u v",
    "thresholds": "float n",
    "reason": "text",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Silhouettes:
    """Outlines of the content, each projected along an axis of the frame; possibly none."""

    axes: Ints
    """Axis of the lines of sight of each outline, (n,)."""
    origins_m: Floats
    """Position of the first cell along the two other axes, in their order, (n, 2) [m]."""
    spacing_m: Floats
    """Cell size, () [m]."""
    transmission: Floats
    """Flash of the wall relative to that without content, (n, n_u, n_v); 1 on a free line."""
    known: Bools
    """Cells that antennas cover, (n, n_u, n_v)."""
    thresholds: Floats
    """Least transmission of a free line of sight, (n,)."""
    reason: NDArray[np.str_]
    """Reason for no outline, (); empty if there is one."""

    def __post_init__(self) -> None:
        n = self.axes.shape[0]
        require_shape("axes", self.axes, (n,))
        require_shape("origins_m", self.origins_m, (n, 2))
        require_shape("transmission", self.transmission, (n, None, None))
        require_shape("known", self.known, self.transmission.shape)
        require_shape("thresholds", self.thresholds, (n,))
        for name in ("spacing_m", "reason"):
            require_shape(name, getattr(self, name), ())

    def __len__(self) -> int:
        return int(self.axes.shape[0])

    def save(self, path: AnyPath) -> None:
        """Write one array per field."""
        write_npz_atomic(path, {name: getattr(self, name) for name in self.__dataclass_fields__})

    @classmethod
    def load(cls, path: AnyPath) -> "Silhouettes":
        """Read a file written by `save`; UserError for any other file."""
        return cls(**read_arrays(path, _LAYOUTS))

    def numbers(self) -> dict[str, int | str]:
        """Count them, and state why there are none, for run.json."""
        reason = str(self.reason)
        return {"outlines": len(self)} | ({"no_outlines": reason} if reason else {})

    def select(self, keep: Bools | Ints) -> "Silhouettes":
        """Subset by mask or index."""
        per_outline = _LAYOUTS.keys() - {"spacing_m", "reason"}
        return replace(self, **{name: getattr(self, name)[keep] for name in per_outline})

    def free_distance(self, points: Floats) -> Floats:
        """Lower bound of the distance from points, (n_points, 3), to the content, (n_points,) [m].

        The maximum of `free_distances`; -inf where no outline is known.
        """
        return np.asarray(self.free_distances(points).max(axis=0, initial=-np.inf))

    def free_distances(self, points: Floats) -> Floats:
        """Lower bound of the distance to the content by each outline alone, (n, n_points) [m].

        It is the distance to the nearest line of sight along the outline's axis that is not free.
        On a blocked line it is the negative distance to the nearest free one, and -inf where the
        outline is unknown. A free region must touch the border of the known cells or contain the
        full flash. Other bright lines may be echoes of the content at the wall's range. A line with
        a reduced flash far from any edge is not free: a wire or a slat blocks only a part.
        """
        by_outline = [self._free_distance(number, points) for number in range(len(self))]
        return np.array(by_outline).reshape(len(self), len(points))

    def _free_distance(self, number: int, points: Floats) -> Floats:
        distance, known, spacing_m = self._distance_maps[number]
        across = [k for k in range(3) if k != self.axes[number]]
        cells = (points[:, across] - self.origins_m[number]).T / spacing_m
        found = map_coordinates(distance, cells, order=1, mode="nearest")
        inside = map_coordinates(known.astype(np.float64), cells, order=1, mode="constant") > 0.99
        return np.where(inside, found, -np.inf)

    @cached_property
    def _distance_maps(self) -> list[tuple[Floats, Bools, float]]:
        return [self._distance_map(number) for number in range(len(self))]

    def _distance_map(self, number: int) -> tuple[Floats, Bools, float]:
        """Signed distance to free lines of sight [m], mask of known cells, size of a cell [m].

        Positive on free lines. The cells are finer than those of the transmission.
        """
        known = self.known[number]
        n_fine = (np.array(known.shape) - 1) * _REFINE + 1
        fine = np.stack(np.meshgrid(*(np.arange(n) / _REFINE for n in n_fine), indexing="ij"))
        known = map_coordinates(known.astype(np.float64), fine, order=1) > 0.99
        seen = map_coordinates(self.transmission[number], fine, order=3)
        spacing_m = float(self.spacing_m) / _REFINE
        blocked = (seen <= self.thresholds[number]) & known
        edges_m = spacing_m * distance_transform_edt(~blocked) if blocked.any() else np.inf
        passes = np.log(self.thresholds[number]) / np.log(_EDGE)  # passes of the content, 1 or 2
        thin = (seen < _THIN**passes) & (edges_m > _BLUR_M)
        free = known & ~blocked & ~thin
        parts, _ = label(free)
        free &= np.isin(
            parts, np.unique(parts[free & (~binary_erosion(known) | (seen > 1 - _FREE))])
        )
        distance = np.asarray(distance_transform_edt(free)) - np.asarray(
            distance_transform_edt(~free)
        )
        return spacing_m * distance, known, spacing_m

    def edge(self, number: int) -> tuple[Floats, Floats]:
        """Edge between free and other lines of sight of one outline, one point per cell.

        Returns positions across the lines, (n, 2) [m], and unit normals towards free lines, (n, 2);
        smoothed over half a cell. There is no edge at the border of the known cells.
        """
        distance, known, spacing_m = self._distance_maps[number]
        distance = gaussian_filter(distance, 0.5 * _REFINE)
        lines = find_contours(distance, 0.0, mask=binary_erosion(known, iterations=_REFINE))
        points = [np.zeros((0, 2))]
        for line in lines:
            along = np.concatenate([[0.0], np.linalg.norm(np.diff(line, axis=0), axis=1).cumsum()])
            at = np.arange(0.5 * _REFINE, along[-1], _REFINE)
            points.append(np.stack([np.interp(at, along, line[:, k]) for k in range(2)], axis=1))
        cells = np.concatenate(points)
        slope = [map_coordinates(g, cells.T, order=1) for g in np.gradient(distance, spacing_m)]
        normals = np.stack(slope, axis=1)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        return self.origins_m[number] + spacing_m * cells, normals


class _Focused(NamedTuple):
    """Flash of a plane, and the distance of its cells from free and blocked, by focal length."""

    flash: Flash
    blurs: list[Floats]


_KEPT: WeakKeyDictionary[Pose, dict[Any, _Focused | None]] = WeakKeyDictionary()


class _Outline(NamedTuple):
    """Transmission and known cells, (n_u, n_v) each; least transmission of a free line."""

    transmission: Floats
    known: Bools
    threshold: float


def find_silhouettes(capture: Capture, config: SilhouetteConfig | None = None) -> Silhouettes:
    """Outlines of the content along the axes whose walls flash; possibly none.

    capture: with known walls, outermost first; in a nested box the outermost wall is the mirror.

    The shadow in the flash is an in-line hologram (Gabor 1948), focused at the distance with the
    sharpest outline: docs/math/free-space.md#silhouettes.
    """
    config = config or SilhouetteConfig()
    by_axis: dict[int, list[_Focused]] = defaultdict(list)
    for pose in capture.poses if capture.walls else ():
        for axis in range(3):
            focused = _focused(pose, axis, capture, config)
            if focused is not None:
                by_axis[axis].append(focused)
    outlines, free_shares = [], [0.0]
    for axis, flashes in by_axis.items():
        wall = capture.walls[0]
        cells = _cells(wall, axis, config)
        found, free_share = _focus_planes(
            flashes, cells, capture.waveform.center_wavelength_m, config
        )
        free_shares.append(free_share)
        if found is not None:
            first = [c[0] for c in cells] + np.asarray(wall.center_m)[_across(axis)]
            outlines.append((axis, first, found))
    reason = ""
    if not capture.walls:
        reason = "the walls of the box are not known"
    elif not by_axis:
        reason = "no plane of antennas faces a wall at a right angle"
    elif not outlines:
        reason = (
            f"at most {max(free_shares):.0%} of a plane's lines of sight show the far wall's flash "
            f"without a shadow, at least {config.min_free:.0%} are needed"
        )
    return replace(_joined(outlines, config.spacing_m), reason=np.array(reason))


def _joined(outlines: list[tuple[int, Floats, _Outline]], spacing_m: float) -> Silhouettes:
    """Join outlines, given with their axes and positions of their first cells [m]."""
    shape = tuple(max((o.known.shape[k] for *_, o in outlines), default=0) for k in range(2))
    found = Silhouettes(
        axes=np.array([o[0] for o in outlines], dtype=np.int64),
        origins_m=np.array([o[1] for o in outlines], dtype=np.float64).reshape(-1, 2),
        spacing_m=np.array(spacing_m),
        transmission=np.ones((len(outlines), *shape)),
        known=np.zeros((len(outlines), *shape), dtype=np.bool_),
        thresholds=np.array([o.threshold for *_, o in outlines]),
        reason=np.array(""),
    )
    for number, (*_, outline) in enumerate(outlines):
        n_u, n_v = outline.known.shape
        found.transmission[number, :n_u, :n_v] = outline.transmission
        found.known[number, :n_u, :n_v] = outline.known
    return found


def _across(axis: int) -> list[int]:
    return [k for k in range(3) if k != axis]


def _cells(wall: Wall, axis: int, config: SilhouetteConfig) -> list[Floats]:
    """Middles of the cells of an outline along both axes across [m]."""
    half_m = 0.5 * np.array(wall.inner_size_m)[_across(axis)]
    counts = (half_m / config.spacing_m).astype(int)
    return [config.spacing_m * np.arange(-n, n + 1) for n in counts]


def _focused(pose: Pose, axis: int, capture: Capture, config: SilhouetteConfig) -> _Focused | None:
    """Flash of the far wall along an axis, and its blur; None if too few antennas face it.

    It is kept as long as the plane: a growing scan asks for its shadows after each further one.
    """
    known, key = _KEPT.setdefault(pose, {}), (axis, capture.walls, capture.waveform, config)
    if key not in known:
        flash = _wall_flash(pose, axis, capture, config)
        coarse = [c[::2] for c in _cells(capture.walls[0], axis, config)]
        known[key] = None
        if flash is not None:
            blurs, wavelength_m = list[Floats](), capture.waveform.center_wavelength_m
            # With a tilted wall, the lines of sight of a narrow strip of antennas may miss the box.
            for focus in _FOCUSES if covered(flash, coarse).any() else ():
                image, seen = hologram(flash, coarse, focus, wavelength_m, config.aperture)
                blurs.append(np.minimum(np.abs(image[seen]), np.abs(image[seen] - 1.0)))
            known[key] = _Focused(flash, blurs)
    return known[key]


def _wall_flash(pose: Pose, axis: int, capture: Capture, config: SilhouetteConfig) -> Flash | None:
    """Flash of the far wall along an axis; None if too few antennas face it."""
    wall, waveform = capture.walls[0], capture.waveform
    inner, across = 0.5 * np.array(wall.inner_size_m), _across(axis)
    tx, rx, feet = (
        np.asarray(p) - np.asarray(wall.center_m)
        for p in (pose.tx_positions, pose.rx_positions, pose.phase_centers)
    )
    side = -1.0 if feet[:, axis].mean() > 0.0 else 1.0
    content_m = -side * feet[:, axis]
    wall_m = content_m + inner[axis]
    outside = content_m > inner[axis]
    # Only antennas in front of the wall receive the flash.
    before = (np.abs(feet) < inner)[:, across].all(axis=1)
    if (outside & before).sum() < _MIN_ANTENNAS:
        return None
    # The edges of the wall cut the Fresnel zone that the flash comes from.
    share = np.ones(len(feet), dtype=np.complex128)
    for k in across:
        scale = 2.0 / np.sqrt(waveform.center_wavelength_m * np.where(outside, wall_m, np.inf))
        low, high = (_fresnel((inner[k] + sign * feet[:, k]) * scale) for sign in (-1.0, 1.0))
        share *= (low + high) / (1.0 - 1.0j)
    used = outside & before & (np.abs(share) > 1.0 - _FREE)
    if used.sum() < _MIN_ANTENNAS or not feet[used][:, across].std(axis=0).min() > 0.0:
        return None
    image = rx[used]
    image[:, axis] = 2.0 * side * inner[axis] - image[:, axis]
    crossed_m = np.zeros(len(image))
    for layer in capture.walls:
        offset = feet[used] + np.asarray(wall.center_m) - np.asarray(layer.center_m)
        within = (np.abs(offset) < 0.5 * np.asarray(layer.size_m))[:, across].all(axis=1)
        # The path crosses two faces of the outermost box and four of an inner one.
        crossed_m += within * layer.one_way_delay_m * (2.0 if layer is wall else 4.0)
    path_m = np.linalg.norm(tx[used] - image, axis=1) + crossed_m + waveform.path_bias_m
    response = response_at(pose.signal[used], path_m, waveform)
    flash = Flash(
        feet=feet[used][:, across],
        response=response * wall_m[used] / share[used],
        content_m=content_m[used],
        wall_m=wall_m[used],
    )
    flash = _correct_tilt(flash, 2.0 * np.pi / waveform.center_wavelength_m, config)
    return _correct_bulge(flash, waveform.center_wavelength_m)


def _fresnel(v: Floats) -> NDArray[np.complex128]:
    sine, cosine = fresnel(v)
    return np.asarray(cosine - 1j * sine)


def _correct_tilt(flash: Flash, wavenumber: float, config: SilhouetteConfig) -> Flash:
    """Remove the phase ramp of a tilted wall: the one whose removal gives the largest sum.

    An antenna's ray is normal to the wall, so it passes the content beside the foot point.
    """
    slopes = np.zeros(2)
    reach = 2.0 * wavenumber * np.sin(np.radians(config.max_tilt_deg))
    for _ in range(2):
        tried = [slope + np.linspace(-reach, reach, _TILTS) for slope in slopes]
        u, v = (
            np.exp(-1j * slope[:, None] * flash.feet[None, :, k]) for k, slope in enumerate(tried)
        )
        total = np.abs((u * flash.response) @ v.T)
        best = np.unravel_index(int(np.argmax(total)), total.shape)
        slopes = np.array([slope[k] for slope, k in zip(tried, best, strict=True)])
        reach *= 2.0 / (_TILTS - 1)
    return flash._replace(
        response=flash.response * np.exp(-1j * flash.feet @ slopes),
        feet=flash.feet + 0.5 * flash.content_m[:, None] * slopes / wavenumber,
    )


def _correct_bulge(flash: Flash, wavelength_m: float) -> Flash:
    """Correct phase, amplitude and direction of the flash for a bulge of the wall."""
    shape = path_shape(flash.feet, flash.response, wavelength_m)
    if shape is None or shape.rms_m < _FLAT_M:
        return flash
    corrected = flash.response * np.exp(2j * np.pi / wavelength_m * shape.length_m)
    if np.abs(corrected.sum()) < np.abs(flash.response.sum()):
        return flash  # the phases of neighbouring antennas are independent
    return flash._replace(
        response=corrected / shape.gain(flash.wall_m),
        # An antenna's ray is normal to the bulged wall: this is where it passes the content.
        feet=flash.feet - 0.5 * flash.content_m[:, None] * shape.slope,
    )


def _focus_planes(
    focused: list[_Focused], cells: list[Floats], wavelength_m: float, config: SilhouetteConfig
) -> tuple[_Outline | None, float]:
    """Outline of all planes at the sharpest focus, None if too few are free; largest free share."""
    blurs = [blurs for _, blurs in focused if blurs]
    if not blurs:
        return None, 0.0
    flashes = [flash for flash, blurs in focused if blurs]
    blur = [np.concatenate(planes).mean() for planes in zip(*blurs, strict=True)]
    focus = _FOCUSES[int(np.argmin(blur))]
    shape = len(cells[0]), len(cells[1])
    total, count, free_shares = np.zeros(shape), np.zeros(shape), []
    for flash in flashes:
        image, known = hologram(flash, cells, focus, wavelength_m, config.aperture)
        free_shares.append(float((np.abs(image[known] - 1.0) < _FREE).mean()) if known.any() else 0)
        if free_shares[-1] >= config.min_free:
            total[known] += image.real[known]
            count[known] += 1.0
    # With waves on both passes the content attenuates twice.
    threshold, blur_m = _EDGE**2, 0.0
    if focus < 0.5:
        focal_m = np.median(np.concatenate([focal_lengths_m(flash, focus) for flash in flashes]))
        blur_m = np.sqrt(wavelength_m * focal_m) / (2.0 * np.pi * config.aperture)
        threshold = _EDGE
    mean = np.where(count > 0.0, total / np.maximum(count, 1.0), 1.0)
    outline = _Outline(sharpened(mean, blur_m / config.spacing_m), count > 0.0, threshold)
    return outline if count.any() else None, max(free_shares)


def sharpened(image: Floats, blur_cells: float) -> Floats:
    """Remove a Gaussian blur to first order, so that thin parts do not appear transparent.

    A blur of b gives T = S + b^2 / 2 laplacian(S) + ... of S, so S is about T - b^2 / 2
    laplacian(T). A straight edge does not move; a narrow strip becomes darker and gets its width.

    image: transmission, (n_u, n_v).
    blur_cells: standard deviation of the blur [cells].
    """
    return np.asarray(image - 0.5 * blur_cells**2 * laplace(image, mode="nearest"))
