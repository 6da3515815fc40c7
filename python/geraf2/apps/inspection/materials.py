"""Material of each part, from returns that passed through it and the amplitude of its returns.

Metal stops a line of sight at its first surface. A return whose line of sight crosses a surface
from inside came through plastic: its back face lies beyond the front that another plane sees. The
amplitude of metal follows from the curvature of the surface (docs/math/echoes.md#reflectivity).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree
from scipy.special import expit

from geraf2._types import Bools, Floats
from geraf2.apps.inspection.bodies import Body
from geraf2.apps.inspection.crossings import BEHIND_M, find_crossings, odds_of_metal
from geraf2.apps.inspection.material import CERTAIN, Kind, Material, Measured
from geraf2.echoes import Glints
from geraf2.echoes.labels import Label
from geraf2.echoes.reflectivity import (
    Windows,
    crossing_loss,
    db,
    spreading,
    squarely,
    window_gain,
)
from geraf2.geometry.curvature import shape_operators
from geraf2.geometry.triangles import vertex_normals
from geraf2.io.mesh import TriangleMesh
from geraf2.io.planes import ScannedPlanes
from geraf2.io.points import read_cloud
from geraf2.io.run_folder import PEAKS_NAME
from geraf2.pipeline.presets import BestPreset, FastPreset
from geraf2.pipeline.reconstruction import Reconstruction
from geraf2.scene.aperture import Aperture, apertures_at

_STRONG = 0.9
"""Quantile of the levels of a part that is its level: merged echoes only weaken returns."""
_METAL_DB, _METAL_SIGMA_DB = -2.5, 2.8
_PLASTIC_DB, _PLASTIC_SIGMA_DB = -6.9, 4.1
"""Means and standard deviations of that level [dB]. Rough patches and antenna patterns lower it, a
surface that bridges bodies raises it."""
_LIKELY = 0.15
"""Least probability of a return that may have passed through a part."""
_MIN_GLINTS = 20
"""Fewest returns from which a level is taken."""
_LARGEST_SIGMA_DB = 4.0
"""Levels with a larger uncertainty of the scale are of no use [dB]."""
_IMPOSSIBLE_DB = 6.0
"""No body reflects more than metal by so much: the scale is wrong [dB]."""
_CURVATURE_REACH_M = 0.009
"""Radius of the surface that gives the curvature at a return [m]."""
_GAP_M, _COSINE = 0.004, 0.94
"""Largest distance of a return from the surface [m], and least cosine of both normals."""
_ALONG_M, _OWN_M = np.linspace(0.0, 0.08, 17), 0.02
"""Points of a line of sight ahead of a return [m], and largest distance of its part from them
[m]."""
_MAP_REACH_M = 0.008
"""Distance to which a return shows the reflectivity of the surface [m]."""
_MAX_CONCAVE_PER_M = -5.0
"""Concave surface focuses, and its returns merge: they are left out [1/m]."""


class Levels(NamedTuple):
    """Returns of a run against metal."""

    positions: Floats
    """(n, 3) [m]."""
    normals: Floats
    """(n, 3)."""
    levels_db: Floats
    """Amplitude over that of metal of the same curvature, (n,) [dB]."""
    scale_sigma_db: float
    """Standard uncertainty that all levels share [dB]."""
    permittivity: Measured | None
    """Of a content that is seen through."""
    thickness_m: tuple[float, float] | None = None
    """Of it, 10 % and 90 % quantile [m]."""
    is_hollow: bool = False
    """Whether it is a shell that is filled with air."""


class Returns(NamedTuple):
    """Returns in the box, and on which side of them the far side of their part lies."""

    positions: Floats
    """(n, 3) [m]."""
    normals: Floats
    """(n, 3)."""
    probability: Floats
    """That each is a return, (n,)."""
    behind: Bools
    """Whether each was found behind a dielectric front face, (n,)."""
    passed: Bools
    """Whether a surface that faces away, or a front face, lies on its line of sight, (n,)."""
    opposed: Bools
    """Whether a surface that faces away lies before or behind it, or `passed`, (n,)."""

    @classmethod
    def of(
        cls, positions: Floats, normals: Floats, probability: Floats, behind: Bools
    ) -> "Returns":
        """Find surfaces that face away on the line of sight of each return, and behind it.

        The sum of their probabilities exceeds one. Those before it are the far side of a part,
        seen by another plane: the return passed through it.
        """

        def sum_met(direction: Floats) -> Floats:
            found = find_crossings(positions, direction)
            own = ~found.is_front & (found.depth_m > BEHIND_M) & (found.depth_m < _ALONG_M[-1])
            weight = probability[found.surfaces[own]]
            return np.asarray(np.bincount(found.lines[own], weight, len(positions)), dtype=float)

        before, after = sum_met(normals), sum_met(-normals)
        passed = behind | (before > 1.0)
        return cls(positions, normals, probability, behind, passed, passed | (before + after > 1.0))


def returns_of(result: Reconstruction) -> Returns | None:
    """Read the returns of a run; None of a run without them."""
    path = result.run.find_file(PEAKS_NAME)
    cloud = None if path is None else read_cloud(path)
    if cloud is None or not {"label", "probability"} <= set(cloud.columns):
        return None
    label, probability = cloud.columns["label"], cloud.columns["probability"]
    behind = label == Label.SEEN_THROUGH
    own = np.isin(label, (Label.CLUTTER, Label.DIRECT)) & (probability > _LIKELY) | behind
    if not own.any():
        return None
    return Returns.of(
        cloud.positions[own],
        cloud.normals[own],
        np.where(behind, 1.0, probability)[own],
        behind[own],
    )


def levels_of(result: Reconstruction, planes: ScannedPlanes) -> Levels | None:
    """Levels of the returns of a run; None without glints, planes, or a surface.

    The scale is NaN where no wall shows it: levels are then NaN, too.
    """
    glints, mesh, numbers = result.glints, result.content_mesh, result.numbers.get("glints", {})
    config = result.record.config if glints is not None else None
    if glints is None or planes.wavelength_m is None or not len(planes.corners_m):
        return None
    if not isinstance(config, FastPreset | BestPreset):
        return None
    kept = glints.select(glints.poses < len(planes.corners_m))
    apertures = apertures_at(planes.corners_m)
    ranges = _ranges(kept, apertures)
    distance, vertex = KDTree(mesh.vertices).query(kept.positions)
    normals = vertex_normals(mesh.vertices, mesh.faces)
    cosine = np.einsum("ij,ij->i", normals[vertex], kept.normals)
    kept_here = (distance < _GAP_M) & (cosine > _COSINE) & np.isfinite(ranges)
    kept, ranges, vertex = kept.select(kept_here), ranges[kept_here], vertex[kept_here]
    prior, size_m = result.prior, config.glints.for_planes(apertures).subaperture.size_m
    centers = kept.positions + ranges[:, None] * kept.normals
    windows = Windows.of(apertures, kept.poses, centers, prior, size_m)
    bend = shape_operators(mesh.vertices, normals, vertex, _CURVATURE_REACH_M)
    good = np.isfinite(bend).all(axis=(1, 2)) & squarely(windows, kept.normals)
    bend[~good] = 0.0
    good &= np.linalg.eigvalsh(bend)[:, 0] > _MAX_CONCAVE_PER_M
    metal = spreading(ranges, bend) * window_gain(
        windows, ranges, bend, 2.0 * np.pi / planes.wavelength_m
    )
    scale = numbers.get("metal_strength_m", np.nan) * crossing_loss(prior.walls)
    levels = db(kept.strengths / (metal * scale))
    return Levels(
        positions=kept.positions[good],
        normals=kept.normals[good],
        levels_db=levels[good],
        scale_sigma_db=float(numbers.get("metal_strength_sigma_db", np.nan)),
        permittivity=Measured(
            value=float(numbers["permittivity"]), sigma=float(numbers["permittivity_sigma"])
        )
        if "permittivity" in numbers
        else None,
        thickness_m=(numbers["thickness_m"][0], numbers["thickness_m"][1])
        if "thickness_m" in numbers
        else None,
        is_hollow=bool(numbers.get("is_hollow", False)),
    )


def materials_of(
    bodies: Sequence[Body], levels: Levels | None, returns: Returns | None
) -> list[Material]:
    """Material of each part."""
    if not bodies:
        return []
    trees = [KDTree(body.mesh.vertices) for body in bodies]
    shares = passed_shares(trees, returns)
    if levels is None:
        return [_material(None, float(share), 0, None) for share in shares]
    owner = np.argmin([tree.query(levels.positions)[0] for tree in trees], axis=0)
    found = [
        _level(levels.levels_db[owner == b], levels.scale_sigma_db) for b in range(len(bodies))
    ]
    if any(level is not None and level.value > _IMPOSSIBLE_DB for level in found):
        found = [None] * len(bodies)
    counts = np.bincount(owner, minlength=len(bodies))
    return [
        _material(level, float(s), int(n), levels)
        for level, s, n in zip(found, shares, counts, strict=True)
    ]


def passed_shares(trees: Sequence[KDTree], returns: Returns | None) -> Floats:
    """Share of the opposed returns of each part that passed through it, (n_parts,), by probability.

    NaN of too few returns. trees: vertices of each part. A return is of the nearest part; one
    behind a front face of the part that its line of sight comes nearest to.
    """
    shares = np.full(len(trees), np.nan)
    if returns is None:
        return shares
    positions, normals, probability, behind, passed = (of[returns.opposed] for of in returns[:5])
    if not len(positions):
        return shares
    line = positions[:, None] + (behind[:, None] * _ALONG_M)[:, :, None] * normals[:, None]
    gaps = np.stack([tree.query(line)[0].min(axis=1) for tree in trees])
    for n in range(len(trees)):
        own = (gaps.argmin(axis=0) == n) & (gaps[n] < _OWN_M)
        if own.sum() >= _MIN_GLINTS:
            shares[n] = probability[own & passed].sum() / probability[own].sum()
    return shares


def log_odds_of_metal(level: Measured | None, passed_share: float) -> float:
    """Log odds of metal against plastic, before which both are as likely.

    The level is normal about that of metal or of plastic, with the variance between parts and its
    own. The share of returns that passed is exponential of metal, uniform of plastic. NaN adds
    nothing.
    """
    odds = odds_of_metal(passed_share) if np.isfinite(passed_share) else 0.0
    if level is None or level.sigma is None:
        return odds
    metal_sigma, plastic_sigma = np.hypot([_METAL_SIGMA_DB, _PLASTIC_SIGMA_DB], level.sigma)
    metal_off = (level.value - _METAL_DB) / metal_sigma
    plastic_off = (level.value - _PLASTIC_DB) / plastic_sigma
    odds += float(np.log(plastic_sigma / metal_sigma) + 0.5 * (plastic_off**2 - metal_off**2))
    return odds


def reflectivity_map(vertices: Floats, normals: Floats, levels: Levels) -> Floats:
    """Reflectivity against metal at vertices with returns around, else NaN, (n_vertices,) [dB].

    Mean of the levels within reach whose normals agree, weighted by their distance.
    """
    pairs = KDTree(vertices).sparse_distance_matrix(
        KDTree(levels.positions), _MAP_REACH_M, output_type="ndarray"
    )
    i, j = pairs["i"], pairs["j"]
    facing = np.einsum("ij,ij->i", normals[i], levels.normals[j]) > _COSINE
    known = facing & np.isfinite(levels.levels_db[j])
    i, j, gap = i[known], j[known], pairs["v"][known]
    weight = 1.0 - gap / _MAP_REACH_M
    total = np.bincount(i, weight, minlength=len(vertices))
    sums = np.bincount(i, weight * levels.levels_db[j], minlength=len(vertices))
    return np.asarray(np.divide(sums, total, out=np.full(len(total), np.nan), where=total > 0.0))


def add_reflectivity(mesh: TriangleMesh, levels: Levels | None) -> TriangleMesh:
    """Mesh with its map of reflectivity, where there is a scale."""
    if levels is None or not np.isfinite(levels.levels_db).any():
        return mesh
    normals = vertex_normals(mesh.vertices, mesh.faces)
    return replace(mesh, reflectivity_db=reflectivity_map(mesh.vertices, normals, levels))


def _level(levels_db: Floats, scale_sigma_db: float) -> Measured | None:
    """Level of the strong returns of a part; None of too few returns, or without a scale of use."""
    known = levels_db[np.isfinite(levels_db)]
    if len(known) < _MIN_GLINTS or not scale_sigma_db <= _LARGEST_SIGMA_DB:
        return None
    spread = 1.4826 * float(np.median(np.abs(known - np.median(known))))
    # A quantile of 90 % of n normal values has the error 1.71 spread / sqrt(n). Returns of
    # overlapping sub-apertures are alike: about one in four is independent.
    error = 1.71 * spread / (0.25 * len(known)) ** 0.5
    return Measured(
        value=float(np.quantile(known, _STRONG)), sigma=float(np.hypot(scale_sigma_db, error))
    )


def _material(
    level: Measured | None, passed_share: float, n_returns: int, levels: Levels | None
) -> Material:
    metal = float(expit(log_odds_of_metal(level, passed_share)))
    kind: Kind = "not determined"
    if max(metal, 1.0 - metal) >= CERTAIN:
        kind = "metal" if metal > 0.5 else "plastic"
    inside = levels if kind == "plastic" else None
    return Material(
        kind=kind,
        metal_probability=metal,
        reflectivity_db=level,
        permittivity=inside.permittivity if inside else None,
        thickness_m=inside.thickness_m if inside else None,
        n_returns=n_returns,
        is_hollow=inside is not None and inside.is_hollow,
    )


def _ranges(glints: Glints, apertures: Sequence[Aperture]) -> Floats:
    """Distance of each glint from its plane along its normal, NaN behind it, (n,) [m]."""
    ranges = np.full(len(glints), np.nan)
    for plane in np.unique(glints.poses):
        own = np.flatnonzero(glints.poses == plane)
        met = apertures[plane].mirror(glints.positions[own], glints.normals[own])
        ranges[own[met.received]] = met.distances_m[met.received]
    return ranges
