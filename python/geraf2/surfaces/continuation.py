"""The surface beyond what the aperture can see, where its curvature says how it goes on.

A horizontal scan sees a body round as a ball up to the normals that still point at an antenna, and
nothing beyond. Where the glints reach that limit on a surface of constant curvature, it is
continued along arcs of that curvature, and believed where arcs from different sides meet
(docs/math/surface-fit.md#continued-curvature). Where it has an edge, the glints end or bend before.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from geraf2._types import Bools, Floats, Ints
from geraf2.echoes.agreement import tangent_offset
from geraf2.echoes.glint_set import Glints
from geraf2.echoes.glints import GlintConfig
from geraf2.echoes.patches import fit_patches
from geraf2.freespace.specular import specular_visibility
from geraf2.geometry.components import connected_labels
from geraf2.scene.aperture import Aperture, own_mirror_points

# Glints seen from the outermost 3 cm that give echoes are at the limit: places of
# sub-apertures are 2 cm apart.
_LIMIT_WIDTH_M = 0.03
# One glint of each such cell starts an arc, and arcs have points at this distance.
_STEP_M = 0.004
# Flatter than a radius of 10 cm: an arc over a cap of some centimetres says nothing. Rounder than
# 8 mm: an edge.
_CURVATURES_PER_M = (10.0, 120.0)
# Arcs agree as glints do, but with normals within this angle: those of a ridge differ by more.
_ANGLE_RAD = 0.25
# Arcs are from different sides if they start this far apart, with normals 60 degrees apart.
_APART_M, _APART_COSINE = 0.015, 0.5
# Places where arcs meet, fewer than which, in one cluster, are chance: on simulated figures up to
# 18 were, the caps that were right had 35 and more.
_MIN_MEETING = 20


@dataclass(frozen=True, kw_only=True, eq=False)
class Continuation:
    """Places where a surface goes on unseen."""

    positions: Floats
    """(n, 3) [m]."""
    normals: Floats
    """Outward unit normals, (n, 3)."""

    def __len__(self) -> int:
        return int(self.positions.shape[0])

    @classmethod
    def nothing(cls) -> "Continuation":
        """No place."""
        return cls(positions=np.zeros((0, 3)), normals=np.zeros((0, 3)))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Arcs:
    """Points of all arcs, from each one's start outwards."""

    positions: Floats  # (n, 3) [m]
    normals: Floats  # (n, 3)
    arc: Ints  # which arc, rising (n,)
    starts: Floats  # (n_arcs, 3) [m]
    start_normals: Floats  # (n_arcs, 3)

    def select(self, keep: Bools) -> "_Arcs":
        return _Arcs(
            positions=self.positions[keep],
            normals=self.normals[keep],
            arc=self.arc[keep],
            starts=self.starts,
            start_normals=self.start_normals,
        )


def continue_surface(
    glints: Glints, apertures: Sequence[Aperture], margin_m: float, agreement: GlintConfig
) -> Continuation:
    """Oriented points of a surface continued over caps that no antenna sees, above and below.

    apertures: of the antennas.
    margin_m: rim of each aperture that receives no echo [m].
    agreement: settings with which the glints were found; arcs agree as glints do.
    """
    arcs = _arcs(glints, apertures, margin_m) if len(glints) else None
    if arcs is None or len(arcs.arc) < _MIN_MEETING:
        return Continuation.nothing()
    wrong = _contradicted(arcs, glints, apertures, margin_m, agreement)
    arcs = arcs.select(~_after_first(arcs.arc, wrong))
    meets = _meeting(arcs, agreement)
    # An arc is kept up to the last place where it meets others.
    until = np.full(len(arcs.starts), -1)
    np.maximum.at(until, arcs.arc[meets], np.nonzero(meets)[0])
    kept = arcs.select(np.arange(len(arcs.arc)) <= until[arcs.arc])
    return Continuation(positions=kept.positions, normals=kept.normals)


def _arcs(glints: Glints, apertures: Sequence[Aperture], margin_m: float) -> _Arcs:
    """Arcs of the curvature at the limit of what is seen, until they face up or down."""
    mirror = own_mirror_points(glints.positions, glints.normals, apertures, glints.poses)
    vertical = np.stack([aperture.axes[2] for aperture in apertures])[glints.poses]
    below, above = mirror.edges_m[:, 1], mirror.edges_m[:, 3]
    rim = margin_m + _LIMIT_WIDTH_M
    parts: list[_Arcs] = []
    n_arcs = 0
    for side, at_limit in ((1.0, above < rim), (-1.0, below < rim)):
        index = _thinned(glints, np.nonzero(mirror.received & at_limit)[0])
        pole = side * vertical[index]
        along = pole - _dot(pole, glints.normals[index])[:, None] * glints.normals[index]
        long = np.linalg.norm(along, axis=1)
        index, pole, along = index[long > 0.1], pole[long > 0.1], along[long > 0.1]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        patches, whose = fit_patches(glints, index, along)
        low_curvature, high_curvature = _CURVATURES_PER_M
        curvature = patches.curvatures_per_m
        round_ = (curvature > low_curvature) & (curvature < high_curvature)
        parts.append(
            _draw(
                patches.points[round_],
                patches.normals[round_],
                1.0 / curvature[round_],
                pole[whose[round_]],
                n_arcs,
            )
        )
        n_arcs += len(parts[-1].starts)
    joined = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in _Arcs.__dataclass_fields__
    }
    return _Arcs(**joined)


def _thinned(glints: Glints, index: Ints) -> Ints:
    """Keep the strongest of each cell."""
    ordered = index[np.argsort(-glints.strengths[index], kind="stable")]
    cells = np.floor(glints.positions[ordered] / _STEP_M).astype(np.int64)
    first = np.unique(cells, axis=0, return_index=True)[1]
    return np.sort(ordered[first])


def _draw(points: Floats, normals: Floats, radii_m: Floats, poles: Floats, first_arc: int) -> _Arcs:
    """Arcs from points in the plane of normal and pole, until the normal is the pole."""
    rise = _dot(poles, normals)
    along = poles - rise[:, None] * normals
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    n_steps = (radii_m * np.arccos(np.clip(rise, -1.0, 1.0)) / _STEP_M).astype(np.int64)
    arc = np.repeat(np.arange(len(points)), n_steps)
    step = np.arange(len(arc)) - np.repeat(np.cumsum(n_steps) - n_steps, n_steps) + 1
    angle = (step * _STEP_M / radii_m[arc])[:, None]
    turned = np.cos(angle) * normals[arc] + np.sin(angle) * along[arc]
    return _Arcs(
        positions=points[arc] + radii_m[arc, None] * (turned - normals[arc]),
        normals=turned,
        arc=first_arc + arc,
        starts=points,
        start_normals=normals,
    )


def _contradicted(
    arcs: _Arcs,
    glints: Glints,
    apertures: Sequence[Aperture],
    margin_m: float,
    agreement: GlintConfig,
) -> Bools:
    """Points beside glints of another surface, or that face an antenna and have no glint, (n,)."""
    tree = KDTree(glints.positions)
    around = tree.query_ball_point(arcs.positions, agreement.cluster_link_m)
    n_around = np.array([len(near) for near in around], dtype=np.int64)
    point = np.repeat(np.arange(len(around)), n_around)
    glint = np.array([g for near in around for g in near], dtype=np.int64)
    agree = _agree(
        arcs.positions[point],
        arcs.normals[point],
        glints.positions[glint],
        glints.normals[glint],
        agreement.neighbor_angle_rad,
        agreement.neighbor_offset_m,
    )
    n_agree = np.bincount(point, weights=agree, minlength=len(around))
    other_surface = n_agree < 0.5 * n_around
    margins = specular_visibility(arcs.positions, arcs.normals, apertures)
    expected = (margins >= margin_m).any(axis=1)
    return np.asarray(other_surface | (expected & (n_around == 0)))


def _after_first(arc: Ints, wrong: Bools) -> Bools:
    """Points at and behind the first wrong one of their arc."""
    n_before = np.cumsum(wrong)
    _, first, which = np.unique(arc, return_index=True, return_inverse=True)
    before_arc: Ints = (n_before - wrong)[first]
    return np.asarray(n_before > before_arc[which])


def _meeting(arcs: _Arcs, agreement: GlintConfig) -> Bools:
    """Points that two others of arcs from another side agree with, in groups, (n,)."""
    pairs = KDTree(arcs.positions).query_pairs(agreement.neighbor_radius_m, output_type="ndarray")
    start, start_normal = arcs.starts[arcs.arc], arcs.start_normals[arcs.arc]
    i, j = pairs.T
    apart = np.linalg.norm(start[i] - start[j], axis=1) > _APART_M
    apart &= _dot(start_normal[i], start_normal[j]) < _APART_COSINE
    i, j = i[apart], j[apart]
    n_agree = np.zeros(len(arcs.arc), dtype=np.int64)
    p, n = arcs.positions, arcs.normals
    for a, b in ((i, j), (j, i)):
        agree = _agree(p[a], n[a], p[b], n[b], _ANGLE_RAD, agreement.neighbor_offset_m)
        n_agree += np.bincount(a[agree], minlength=len(n_agree))
    meets = n_agree >= 2
    index = np.nonzero(meets)[0]
    if len(index) == 0:
        return meets
    links = KDTree(p[index]).query_pairs(agreement.cluster_link_m, output_type="ndarray")
    group = connected_labels(links[:, 0], links[:, 1], len(index))
    meets[index] = np.bincount(group)[group] >= _MIN_MEETING
    return meets


def _agree(
    positions: Floats,
    normals: Floats,
    other_positions: Floats,
    other_normals: Floats,
    angle_rad: float,
    offset_m: float,
) -> Bools:
    """Whether others lie on the tangent planes of points and face the same way."""
    offset = np.abs(tangent_offset(positions, other_positions, normals))
    return np.asarray(
        (offset < offset_m) & (_dot(normals, other_normals) > np.cos(angle_rad)),
        dtype=bool,
    )


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("ij,ij->i", a, b))
