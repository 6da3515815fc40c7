"""Completion of a fitted field where nothing was measured, by networks that have seen objects.

The fit closes what no antenna saw by the flattest surface. Small networks correct that: for each
voxel they read what the fit and the glints around it say, at several scales, and return by how much
the signed distance has to change. They were trained on scenes of glints whose object is known
(`bench/python/train_completion.py`, docs/math/completion.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import as_file, files

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree

from geraf2._types import AnyPath, Array, Bools, Floats, Ints
from geraf2.fields import SdfGrid
from geraf2.freespace.silhouettes import Silhouettes
from geraf2.io.checkpoint import load_checkpoint
from geraf2.ops._threads import limit_blas_threads
from geraf2.scene.aperture import Aperture
from geraf2.surfaces.linear_sdf import CM, OrientedPoints, resample, trilinear_rows

WEIGHTS_NAME, WEIGHTS_KIND, WEIGHTS_VERSION = "completion.safetensors", "completion", 1
SPACING_M = 0.005
"""Voxels at which the network reads the field [m]."""
BAND_CM = 1.2
"""Half width of the band around the zero level that the network corrects [cm]. Farther out no voxel
changed its sign. Changes are interpolated over the diagonal of a voxel, 0.9 cm."""
_BLURS_CM = (0.5, 1.0, 2.0)
"""Widths of the Gaussians that smooth the field [cm]."""
_SCALES_CM = (0.5, 1.0, 2.0, 4.0)
"""Widths of the Gaussians around a voxel within which glints are averaged [cm]."""
_NEAREST = (4, 12, 32)
"""Numbers of nearest glints that are averaged."""
_SIGHT_CM = np.arange(0.6, 8.0, 0.4)
"""Points on the line of sight of a glint, from the surface towards the antennas [cm]."""
_TRUSTED_CM, _FREE_CM = 0.3, 0.8
"""Distance to the nearest glint up to which the fit stays, and from which the network's correction
counts in full [cm]. A glint errs by less than the first, and sees a patch of about the second."""
_RANKS = (4, 16)
"""Ranks of the nearest glints whose distance counts: how dense they lie."""
_SIGHT_WIDTHS_CM = (0.4, 1.0)
"""Widths of the Gaussians in which lines of sight are counted [cm]."""
_FAR_CM = 4.0
"""Largest distance that is told apart [cm]."""
_PART = 4096
"""Voxels whose nearest glints are looked up at once."""
_FEW, _NONE, _FLAT = 0.01, 1e-4, 1e-3
# Sums and slopes below which nothing is there; they keep logarithms and quotients finite.


@limit_blas_threads
def complete(
    sdf: SdfGrid,
    points: OrientedPoints,
    apertures: Sequence[Aperture],
    outlines: Silhouettes | None = None,
    network: "Network | None" = None,
) -> SdfGrid:
    """Correct a fitted field away from its glints.

    Parameters
    ----------
    sdf
        Signed distance of the fit.
    points
        Glints and tangent points of outlines, with weights relative to a strong glint.
    apertures
        Of all planes of the scan, with glints or without.
    outlines
        Of the content on far walls.
    network
        That of the package when None.

    Returns
    -------
    SdfGrid
        Signed distance on the same grid.
    """
    coarse = resample(sdf, SPACING_M)
    inputs, voxels, nearest_cm = features(coarse, points, apertures, outlines)
    trust = np.clip((nearest_cm - _TRUSTED_CM) / (_FREE_CM - _TRUSTED_CM), 0.0, 1.0)
    change = np.zeros(coarse.grid.shape, dtype=np.float32)
    network = trained_network() if network is None else network
    change.ravel()[voxels] = trust * network.change_cm(inputs) / CM
    fine = SdfGrid(grid=coarse.grid, values=change).sample(sdf.grid.points())
    values = sdf.values + fine.reshape(sdf.grid.shape).astype(np.float32)
    return SdfGrid(grid=sdf.grid, values=values)


def features(
    sdf: SdfGrid,
    points: OrientedPoints,
    apertures: Sequence[Aperture],
    outlines: Silhouettes | None = None,
    chosen: Ints | None = None,
) -> tuple[Array, Ints, Floats]:
    """Compute what the network reads of each voxel in the band.

    Parameters
    ----------
    sdf, points, apertures, outlines
        As those of `complete`; the voxels have `SPACING_M`.
    chosen
        Of the voxels that are returned otherwise, those that are wanted.

    Returns
    -------
    inputs : (n_voxels, n_inputs) float32
        Lengths are in centimetres.
    voxels : (n_voxels,)
        Number of each voxel in the flat grid.
    nearest_cm : (n_voxels,)
        Distance to the nearest glint.
    """
    step, field = sdf.grid.spacing_m * CM, sdf.values.astype(np.float64) * CM
    voxels = np.flatnonzero(np.abs(field) < BAND_CM)
    voxels = voxels if chosen is None else voxels[chosen]

    def at(values: Floats) -> Floats:
        return values.ravel()[voxels]

    slope = np.stack([at(np.asarray(part)) for part in np.gradient(field, step)], axis=1)
    steep = np.linalg.norm(slope, axis=1)
    place = _Place(sdf.grid.points()[voxels] * CM, slope / np.maximum(steep, _FLAT)[:, None])
    inputs = [at(field), steep, place.outwards[:, 2]]
    inputs += [at(gaussian_filter(field, width / step)) - at(field) for width in _BLURS_CM]

    normals, weights = points.normals, points.normal_weights
    origin, glints = np.asarray(sdf.grid.origin_m) * CM, points.positions * CM
    offsets = np.einsum("nk,nk->n", glints, normals)[:, None]
    values = weights[:, None] * np.hstack([np.ones_like(offsets), normals, offsets])
    moments = _spread(field.shape, (glints - origin) / step, values)
    for width in _SCALES_CM:
        weight, *mean, offset = (at(_blurred(of, width / step, 3)) for of in moments)
        inputs += place.against(np.stack(mean, axis=1), offset, weight)
    passed = np.zeros(field.shape)
    for away in _SIGHT_CM:
        sight = (glints + away * normals - origin) / step
        passed += _spread(field.shape, sight, weights[:, None])[0]
    for width in _SIGHT_WIDTHS_CM:
        inputs.append(np.log(at(_blurred(passed, width / step, 2)) + _FEW))
    near, nearest_cm = place.nearest(glints, normals)
    inputs += [*near, *place.reception(apertures), place.outside(outlines)]
    return np.stack(inputs, axis=1).astype(np.float32), voxels, nearest_cm


@dataclass(frozen=True, eq=False)
class _Place:
    """Voxels and the directions in which the field grows there."""

    points: Floats
    """(n_voxels, 3) [cm]."""
    outwards: Floats
    """(n_voxels, 3)."""

    def against(self, mean: Floats, offset: Floats, weight: Floats) -> list[Floats]:
        """Compare voxels with the sums of glints around them.

        mean, offset, weight: sums of normals, of their products with the positions, and of weights.
        """
        along = np.einsum("nk,nk->n", self.points, mean) - offset
        scale = 1.0 / (weight + _NONE)
        mean = mean * scale[:, None]
        return [
            np.log(weight + _FEW),
            np.clip(along * scale, -_FAR_CM, _FAR_CM),
            np.linalg.norm(mean, axis=1),
            np.einsum("nk,nk->n", mean, self.outwards),
            mean[:, 2],
        ]

    def nearest(self, glints: Floats, normals: Floats) -> tuple[list[Floats], Floats]:
        """Compare voxels with their nearest glints, and return the distance to the nearest one."""
        tree, n_parts = KDTree(glints), 1 + len(self.points) // _PART
        parts = zip(
            np.array_split(self.points, n_parts),
            np.array_split(self.outwards, n_parts),
            strict=True,
        )
        found = np.concatenate([_Place(*part)._near(tree, normals) for part in parts], axis=1)
        return list(found[1:]), found[0]

    def _near(self, tree: KDTree, normals: Floats) -> Floats:
        """Distance to the nearest glint, then the inputs, (n_inputs + 1, n_voxels)."""
        n_near = min(max(_NEAREST), len(normals))
        distance, which = tree.query(self.points, k=np.arange(1, n_near + 1))
        aside = np.einsum("nkc,nkc->nk", self.points[:, None] - tree.data[which], normals[which])
        found = [distance[:, 0]]
        found += [np.minimum(distance[:, min(k, n_near) - 1], _FAR_CM) for k in _RANKS]
        for n in _NEAREST:
            mean, some = normals[which[:, :n]].mean(axis=1), aside[:, :n]
            found += [
                np.clip(some.mean(axis=1), -_FAR_CM, _FAR_CM),
                np.clip(some.min(axis=1), -_FAR_CM, _FAR_CM),
                np.clip(some.max(axis=1), -_FAR_CM, _FAR_CM),
                np.linalg.norm(mean, axis=1),
                np.einsum("nk,nk->n", mean, self.outwards),
            ]
        return np.stack(found)

    def reception(self, apertures: Sequence[Aperture]) -> list[Floats]:
        """Margin of the aperture that best receives an echo from there, and its cosine."""
        points, margin = self.points / CM, np.full(len(self.points), -_FAR_CM)
        cosine = np.full(len(points), -1.0)
        for aperture in apertures:
            margins = aperture.mirror(points, self.outwards).margins_m
            margin = np.maximum(margin, np.minimum(margins * CM, _FAR_CM))
            towards = aperture.middle_m - points
            along = np.einsum("nk,nk->n", towards, self.outwards)
            cosine = np.maximum(cosine, along / np.linalg.norm(towards, axis=1))
        return [margin, cosine]

    def outside(self, outlines: Silhouettes | None) -> Floats:
        """Distance to what outlines leave to the content, negative where it may be."""
        if outlines is None:
            return np.full(len(self.points), -_FAR_CM)
        return np.clip(outlines.free_distance(self.points / CM) * CM, -_FAR_CM, _FAR_CM)


def _spread(shape: tuple[int, int, int], index: Floats, values: Floats) -> list[Floats]:
    """Sum values into the eight voxels around each point, (n, k) -> k arrays of a shape.

    index: of the points in voxels, (n, 3). What falls beside the grid is lost.
    """
    padded = shape[0] + 2, shape[1] + 2, shape[2] + 2
    near = ((index > -1.0) & (index < np.array(shape))).all(axis=1)
    rows = trilinear_rows(index[near] + 1.0, padded)
    sums = (rows.T @ values[near]).T.reshape(-1, *padded)
    return list(sums[:, 1:-1, 1:-1, 1:-1])


def _blurred(values: Floats, width: float, dimensions: int) -> Floats:
    """Sum what was spread, under a Gaussian of a width in voxels and of height 1 in 3 dimensions.

    dimensions: 2 gives what passes through an area instead of what lies in a volume.
    """
    scale = (np.sqrt(2.0 * np.pi) * width) ** dimensions
    return np.asarray(scale * gaussian_filter(values, width, mode="constant", truncate=3.0))


@dataclass(frozen=True, eq=False)
class Network:
    """Perceptrons with two hidden layers, each trained on half of the scenes.

    Where evidence is unlike what they learned from, they contradict each other. Only the least
    change on which all agree is made.
    """

    mean: Array
    """Of each input, (n_inputs,)."""
    scale: Array
    """Inverse standard deviation of each input, (n_inputs,)."""
    layers: tuple[tuple[Array, Array], ...]
    """Matrix (n_networks, n_out, n_in) and offset (n_networks, n_out) of each layer."""

    def change_cm(self, inputs: Array) -> Array:
        """Change of the signed distance, (n, n_inputs) -> (n,) [cm]."""
        scaled = (inputs - self.mean) * self.scale
        changes = np.stack([self._of_one(number, scaled) for number in range(self.n_networks)])
        least = np.abs(changes).min(axis=0)
        return np.asarray(np.where(_agree(changes), np.copysign(least, changes[0]), 0.0))

    @property
    def n_networks(self) -> int:
        """Number of networks."""
        return len(self.layers[0][0])

    def _of_one(self, number: int, values: Array) -> Array:
        """Change that one of the networks would make, (n, n_inputs) -> (n,) [cm]."""
        *hidden, (matrix, offset) = ((m[number], o[number]) for m, o in self.layers)
        for inner, shift in hidden:
            values = np.maximum(values @ inner.T + shift, 0.0)
        return np.asarray((values @ matrix.T + offset)[:, 0])


def _agree(changes: Array) -> Bools:
    """Whether all rows have the same sign, (n_networks, n) -> (n,)."""
    return np.asarray((changes > 0.0).all(axis=0) | (changes < 0.0).all(axis=0))


def load_network(path: AnyPath) -> Network:
    """Read the file that `bench/python/train_completion.py` writes."""
    stored = load_checkpoint(path, kind=WEIGHTS_KIND, version=WEIGHTS_VERSION).arrays
    layers = tuple((stored[f"matrix_{k}"], stored[f"offset_{k}"]) for k in range(3))
    return Network(stored["mean"], stored["scale"], layers)


@cache
def trained_network() -> Network:
    """Network of the package, read once."""
    with as_file(files(__package__) / WEIGHTS_NAME) as path:
        return load_network(path)
