"""Material of each part, from the amplitude of its returns and from its back faces.

The amplitude of a return of metal follows from the curvature of the measured surface
(docs/math/echoes.md#reflectivity). What a return lacks is its reflectivity.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Floats, Ints
from geraf2.apps.inspection.bodies import Body
from geraf2.apps.inspection.material import UNKNOWN, Kind, Material, Measured
from geraf2.echoes import Glints
from geraf2.echoes.reflectivity import (
    Windows,
    crossing_loss,
    db,
    face_reflection,
    spreading,
    squarely,
    window_gain,
)
from geraf2.errors import UserError
from geraf2.geometry.curvature import shape_operators
from geraf2.geometry.triangles import vertex_normals
from geraf2.io.mesh import TriangleMesh
from geraf2.io.planes import ScannedPlanes
from geraf2.io.run_folder import BACK_NAME
from geraf2.pipeline.presets import BestPreset, FastPreset
from geraf2.pipeline.reconstruction import Reconstruction
from geraf2.scene.aperture import Aperture

_STRONG = 0.9
"""Quantile of the levels of a part that is its level: merged echoes only weaken returns."""
_METAL_DB, _SCENE_SIGMA_DB = -3.1, 2.0
"""Mean and standard deviation of that level of metal [dB], over 125 parts in the plausible world
(`bench/python/compare_pairs.py`, seeds 0 to 12). Rough patches and antenna patterns lower it."""
_PLASTIC_DB = 20.0 * float(np.log10(abs(face_reflection(2.9))))
"""Level of the front face of plastic, permittivity 2.9, against metal [dB]: -11.7."""
_FOCUS_DB = 4.3
"""Level of plastic above that of its front face [dB]: its back face focuses, and merges with the
front in bodies below 4 cm. Median of five parts only (`bench/python/bodies.py`, seeds 1 to 7)."""
_BACK_SHARE, _BACK_LOG_ODDS = 0.1, 4.0
"""Least share of glints seen through a part that is plastic, and the log odds that they give."""
_CERTAIN = 0.95
"""Least probability of a material that is named."""
_FEWEST = 20
"""Fewest returns from which a level is taken."""
_LARGEST_SIGMA_DB = 4.0
"""Levels with a larger uncertainty of the scale are of no use [dB]."""
_IMPOSSIBLE_DB = 6.0
"""No body reflects more than metal by so much: the scale is wrong [dB]."""
_CURVATURE_REACH_M = 0.009
"""Radius of the surface that gives the curvature at a return [m]."""
_GAP_M, _COSINE = 0.004, 0.94
"""Largest distance of a return from the surface [m], and least cosine of both normals."""
_MAP_REACH_M = 0.008
"""Distance to which a return shows the reflectivity of the surface [m]."""
_MOST_CONCAVE_PER_M = -5.0
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
    back: Floats
    """Positions of glints seen through a part, (n_back, 3) [m]."""
    back_normals: Floats
    """(n_back, 3)."""
    permittivity: Measured | None
    """Of what they were seen through."""
    thickness_m: tuple[float, float] | None = None
    """Of it, 10 % and 90 % quantile [m]."""


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
    apertures = [Aperture.of_corners(corners) for corners in planes.corners_m]
    ranges = _ranges(kept, apertures)
    distance, vertex = KDTree(mesh.vertices).query(kept.positions)
    normals = vertex_normals(mesh.vertices, mesh.faces)
    cosine = np.einsum("ij,ij->i", normals[vertex], kept.normals)
    kept_here = (distance < _GAP_M) & (cosine > _COSINE) & np.isfinite(ranges)
    kept, ranges, vertex = kept.select(kept_here), ranges[kept_here], vertex[kept_here]
    prior, size_m = result.prior, config.glints.subaperture.size_m
    centers = kept.positions + ranges[:, None] * kept.normals
    windows = Windows.of(apertures, kept.poses, centers, prior, size_m)
    bend = shape_operators(mesh.vertices, normals, vertex, _CURVATURE_REACH_M)
    good = np.isfinite(bend).all(axis=(1, 2)) & squarely(windows, kept.normals)
    bend[~good] = 0.0
    good &= np.linalg.eigvalsh(bend)[:, 0] > _MOST_CONCAVE_PER_M
    metal = spreading(ranges, bend) * window_gain(
        windows, ranges, bend, 2.0 * np.pi / planes.wavelength_m
    )
    scale = numbers.get("metal_strength_m", np.nan) * crossing_loss(prior.walls)
    levels = db(kept.strengths / (metal * scale))
    back = _back_glints(result.path)
    return Levels(
        positions=kept.positions[good],
        normals=kept.normals[good],
        levels_db=levels[good],
        scale_sigma_db=float(numbers.get("metal_strength_sigma_db", np.nan)),
        back=back.positions if back else np.zeros((0, 3)),
        back_normals=back.normals if back else np.zeros((0, 3)),
        permittivity=Measured(
            value=float(numbers["permittivity"]), sigma=float(numbers["permittivity_sigma"])
        )
        if "permittivity" in numbers
        else None,
        thickness_m=(numbers["thickness_m"][0], numbers["thickness_m"][1])
        if "thickness_m" in numbers
        else None,
    )


def materials_of(bodies: Sequence[Body], levels: Levels | None) -> list[Material]:
    """Material of each part."""
    if levels is None or not bodies:
        return [UNKNOWN] * len(bodies)
    trees = [KDTree(body.mesh.vertices) for body in bodies]
    owner = np.argmin([tree.query(levels.positions)[0] for tree in trees], axis=0)
    # A back face seems to lie behind its body: the front is towards the antenna.
    passed = _passed_first(levels, trees)
    n_back, n_front = (np.bincount(of, minlength=len(bodies)) for of in (passed, owner))
    share = n_back / np.maximum(n_back + n_front, 1)
    found = [
        _level(levels.levels_db[owner == b], levels.scale_sigma_db) for b in range(len(bodies))
    ]
    if any(level is not None and level.value > _IMPOSSIBLE_DB for level in found):
        found = [None] * len(bodies)
    return [
        _material(level, float(s), int(n), levels)
        for level, s, n in zip(found, share, n_front, strict=True)
    ]


def log_odds_of_metal(level: Measured | None, back_share: float) -> float:
    """Log odds of metal against plastic, before which both are as likely.

    The level is normal about that of metal or of plastic, with the variance between scenes and its
    own. Glints that were seen through a part speak for plastic.
    """
    odds = -_BACK_LOG_ODDS if back_share > _BACK_SHARE else 0.0
    if level is None:
        return odds
    variance = level.sigma**2 + _SCENE_SIGMA_DB**2
    off = level.value - _METAL_DB
    return odds + ((off - _PLASTIC_DB - _FOCUS_DB) ** 2 - off**2) / (2.0 * variance)


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


def with_reflectivity(mesh: TriangleMesh, levels: Levels | None) -> TriangleMesh:
    """Mesh with its map of reflectivity, where there is a scale."""
    if levels is None or not np.isfinite(levels.levels_db).any():
        return mesh
    normals = vertex_normals(mesh.vertices, mesh.faces)
    return replace(mesh, reflectivity_db=reflectivity_map(mesh.vertices, normals, levels))


def _level(levels_db: Floats, scale_sigma_db: float) -> Measured | None:
    """Level of the strong returns of a part; None of too few returns, or without a scale of use."""
    known = levels_db[np.isfinite(levels_db)]
    if len(known) < _FEWEST or not scale_sigma_db <= _LARGEST_SIGMA_DB:
        return None
    spread = 1.4826 * float(np.median(np.abs(known - np.median(known))))
    # A quantile of 90 % of n normal values has the error 1.71 spread / sqrt(n). Returns of
    # overlapping sub-apertures are alike: about one in four is independent.
    error = 1.71 * spread / (0.25 * len(known)) ** 0.5
    return Measured(
        value=float(np.quantile(known, _STRONG)), sigma=float(np.hypot(scale_sigma_db, error))
    )


def _material(
    level: Measured | None, back_share: float, n_returns: int, levels: Levels
) -> Material:
    metal = float(1.0 / (1.0 + np.exp(-log_odds_of_metal(level, back_share))))
    kind: Kind = "not determined"
    if max(metal, 1.0 - metal) >= _CERTAIN:
        kind = "metal" if metal > 0.5 else "plastic"
    seen_through = kind == "plastic" and back_share > _BACK_SHARE
    return Material(
        kind=kind,
        metal_probability=metal,
        reflectivity_db=level,
        permittivity=levels.permittivity if seen_through else None,
        thickness_m=levels.thickness_m if seen_through else None,
        n_returns=n_returns,
    )


def _ranges(glints: Glints, apertures: Sequence[Aperture]) -> Floats:
    """Distance of each glint from its plane along its normal, NaN behind it, (n,) [m]."""
    ranges = np.full(len(glints), np.nan)
    for plane in np.unique(glints.poses):
        own = np.flatnonzero(glints.poses == plane)
        met = apertures[plane].mirror(glints.positions[own], glints.normals[own])
        ranges[own[met.received]] = met.distances_m[met.received]
    return ranges


def _passed_first(levels: Levels, trees: Sequence[KDTree]) -> Ints:
    """Part through which each glint behind a front was seen, (n_back,): the nearest one ahead."""
    steps = np.linspace(0.0, 0.08, 17)
    line = levels.back[:, None] + steps[:, None] * levels.back_normals[:, None]
    gaps = np.stack([tree.query(line)[0].min(axis=1) for tree in trees])
    return np.asarray(gaps.argmin(axis=0))


def _back_glints(folder: Path) -> Glints | None:
    path = folder / BACK_NAME
    try:
        return Glints.load(path) if path.is_file() else None
    except UserError:
        return None
