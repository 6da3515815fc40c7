"""Comparison of measured echoes with those expected of placed models: poses and absent surface.

Overlapping glints of a flat are biased, and poses from them err by a degree. Heat maps of a placed
model have the same bias as the measured ones, so that comparing heat maps removes it
(docs/math/heat-maps.md#expected-echoes).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from geraf2._types import Array, Floats, Ints
from geraf2.apps.inspection.echo_shares import PatchEchoes, Share, power_of, share_of
from geraf2.apps.inspection.measured_windows import MeasuredWindow, lobe, measure_windows
from geraf2.apps.inspection.registration import ALIKE, Placement
from geraf2.apps.inspection.workers import Workers
from geraf2.geometry.components import connected_labels
from geraf2.geometry.transforms import apply_rigid
from geraf2.geometry.triangles import face_areas, split_triangles, unit_normals, with_area
from geraf2.io.mesh import TriangleMesh
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Capture, LosPrior
from geraf2.surfaces.facets import Facets
from geraf2.surfaces.surface_fit import renderer_in_box

MIN_EXPLAINED = 0.5
"""Least share of the measured power that models at correct poses explain."""
_MAX_PLANES = 72
"""Largest number of planes used, evenly chosen; more do not improve a pose."""
_PIECE_M = 0.0016
"""Side of the pieces of a model [m]: below half a wavelength, without grating lobes."""
_STEP_M = 5e-5
"""Step of the finite differences [m]: 0.16 rad of phase."""
_LARGEST_M, _SMALL_M = 1e-3, 2e-5
"""Largest step, and the step at which the iteration stops [m]."""
_N_STEPS = {"window": 6, "plane": 4}
"""Steps with a free phase for each model and window, whose phases may differ by half a cycle, then
for each plane."""
_TURN_RAD = 0.05
"""Step of the rotations tried before, with such phases [rad]: the lobe of a flat of 4 cm."""
_DAMPING = 1e-3
_MIN_IMAGE = 1e-3
"""Part of the largest heat map below which those of other models have no gain of their own."""
_FLOOR_M = 5e-5
"""Error common to all planes, of the rim and of the centre [m]: shadows and lobes are those of the
centre of a window; the rotations of four development parts err by 0.01 to 0.08 degrees."""
_N_GROUPS = 12
"""Number of independent groups of neighbouring planes, whose errors are correlated."""
_PATCH_M, _TURN_M, _N_PATCHES = 0.006, 0.008, 400
"""Radius of a patch [m]; distance of a change of the normal by one radian [m]; most patches."""
_TOUCHING_M = 0.003
"""Largest distance between pieces of neighbouring patches [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Patches:
    """A model's surface in patches of about a centimetre, with their echo shares."""

    pieces: Facets
    """Small pieces of the surface, in the model's frame."""
    patch: Ints
    """Patch of each piece, (n_pieces,)."""
    shares: Floats
    """Measured echo over the expected one, and its standard uncertainty, (n_patches, 2)."""
    whole: Share
    """All of the model's echo."""
    silent: tuple[tuple[Ints, Share], ...]
    """Groups of neighbouring patches whose expected echo is absent."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EchoMatch:
    """A model matched with the measured echoes."""

    placement: Placement
    """Pose by the echoes."""
    explained: float
    """Share of the power of the measured heat maps explained by all models; median over planes."""
    patches: Patches


def pieces_of(model: TriangleMesh) -> Facets:
    """Pieces of about _PIECE_M of a model, whatever the size of its triangles."""
    corners = with_area(split_triangles(model.corners, _PIECE_M))
    points, normals, areas = corners.mean(axis=1), unit_normals(corners), face_areas(corners)
    # Flats often lie on multiples of a millimetre, where rounding would cut them at random.
    cells = np.floor(points / _PIECE_M + 0.37).astype(np.int64)
    facing = np.rint(1.5 * normals).astype(np.int64)
    _, which = np.unique(np.c_[cells, facing], axis=0, return_inverse=True)
    which, total = which.reshape(-1), np.bincount(which.reshape(-1), areas)
    at, pointing = (
        np.stack([np.bincount(which, areas * column) for column in values.T], axis=1)
        for values in (points, normals)
    )
    length = np.linalg.norm(pointing, axis=1)
    kept = length > 0.0
    return Facets(
        points=(at[kept] / total[kept, None]),
        normals=(pointing[kept] / length[kept, None]),
        areas=length[kept],
    )


def patches_of(pieces: Facets) -> Ints:
    """Patch of each piece: the nearest of centres farther apart than _PATCH_M."""
    features = np.c_[pieces.points, _TURN_M * pieces.normals]
    gap = np.linalg.norm(features - features[0], axis=1)
    patch = np.zeros(len(features), dtype=np.int64)
    for number in range(1, _N_PATCHES):
        far = int(gap.argmax())
        if gap[far] < _PATCH_M:
            break
        new = np.linalg.norm(features - features[far], axis=1)
        patch[new < gap] = number
        gap = np.minimum(gap, new)
    return patch


@dataclass(frozen=True, kw_only=True, eq=False)
class WindowView:
    """Visible pieces of the models from one window of antennas."""

    window: MeasuredWindow
    lit: Ints
    """Pieces of all models in view, (n_lit,)."""
    points: Floats
    """Their apparent positions, (n_lit, 3) [m]."""
    amplitudes: Floats
    """(n_lit,) [m^2]."""
    motions: Floats
    """Displacement of each piece by rotations of its model, in metres at its rim, and by
    translations, (n_lit, 6, 3)."""
    model: Ints
    """Model of each piece, (n_lit,)."""


class ExpectedEchoes:
    """Measured heat maps of a scan, for comparison with those of placed models.

    capture: the scan. prior: the box, with its known walls. seed: of the drawn antennas and
    targets.
    """

    def __init__(
        self, capture: Capture, prior: LosPrior, *, seed: int = 0, num_threads: int | None = None
    ) -> None:
        self._waveform, self._prior, self._threads = capture.waveform, prior, num_threads
        every = -(-len(capture.poses) // _MAX_PLANES)
        some = replace(capture, poses=capture.poses[::every])
        with Workers(num_threads) as workers:
            rng = np.random.default_rng(seed)
            self._windows = measure_windows(some, prior, rng, workers)

    def match(
        self, models: Sequence[TriangleMesh], placements: Sequence[Placement]
    ) -> list[EchoMatch]:
        """Refine the poses of all models by comparison with the measured heat maps.

        models: each in its own frame [m]. placements: initial poses, correct to two
        millimetres and ten degrees, or one of their rivals is.

        Minimises the sum over planes p of log(sum |m_p - c_p sum_i h_ip|^2), h_ip the heat maps of
        model i and c_p a complex number for each plane, by Gauss-Newton steps. Before, rotations
        are found with a number for each window and model. The covariance is estimated from the
        scores of groups of planes.
        """
        pieces = [pieces_of(model) for model in models]
        placements = self._choose_placements(models, pieces, placements)
        poses = [placement.pose for placement in placements]
        best: tuple[float, list[Floats]] | None = None

        def equations(
            poses: list[Floats], by: str
        ) -> tuple[list[WindowView], list[Array], NormalEquations]:
            views = self.views(models, pieces, poses)
            images = self.images(views, len(models))
            return views, images, normal_equations(views, images, by)

        for by, n_steps in _N_STEPS.items():
            for _ in range(n_steps):
                _, _, found = equations(poses, by)
                steps = found.step(placements)
                if by == "plane" and (best is None or found.residual < best[0]):
                    best = found.residual, poses
                poses = [
                    _move_pose(pose, step, parts)
                    for pose, step, parts in zip(poses, steps, pieces, strict=True)
                ]
                if np.abs(steps).max() < _SMALL_M:
                    break
        views, images, found = equations(poses, "plane")
        if best is not None and best[0] < found.residual:
            poses = best[1]
            views, images, found = equations(poses, "plane")
        patches = [patches_of(one) for one in pieces]
        shares = self._shares(views, images, found.gains, pieces, patches)
        covariance = found.covariance(placements)
        return [
            EchoMatch(
                placement=_placement(start, pose, parts, covariance[6 * m : 6 * m + 6, 6 * m :]),
                explained=found.explained,
                patches=one,
            )
            for m, (start, pose, parts, one) in enumerate(
                zip(placements, poses, pieces, shares, strict=True)
            )
        ]

    def _choose_placements(
        self,
        models: Sequence[TriangleMesh],
        pieces: Sequence[Facets],
        placements: Sequence[Placement],
    ) -> list[Placement]:
        """Rotate each placement and its rivals that fit alike in steps; returns the best of each.

        Steps are _TURN_RAD, then half of it.
        """
        chosen = list(placements)

        def residual(m: int, other: Placement) -> float:
            poses = [one.pose for one in (*chosen[:m], other, *chosen[m + 1 :])]
            views = self.views(models, pieces, poses)
            images = self.images(views, len(models), n_motions=0)
            return normal_equations(views, images, "window").residual

        def rotate(m: int, start: Placement) -> tuple[float, Placement]:
            best, own = (residual(m, start), start), pieces[m]
            _, sizes, axes = np.linalg.svd(_project_on_determined([start])[:3])
            rims = _TURN_RAD * _reach(own) * axes[:3][sizes > 0.5]
            for size in (1.0, 0.5):
                turned = True
                while turned:
                    turned = False
                    for rim in (*rims, *-rims):
                        other = replace(start, pose=_move_pose(best[1].pose, size * rim, own))
                        if (found := residual(m, other)) < best[0]:
                            best, turned = (found, other), True
            return best

        for m, first in enumerate(placements):
            alike = [
                replace(one, rivals=(first, *(other for other in first.rivals if other is not one)))
                for one in first.rivals
                if one.misfit < ALIKE * first.misfit
            ]
            both = [rotate(m, one) for one in (first, *alike)]
            chosen[m] = min(both, key=lambda one: one[0])[1]
        return chosen

    def views(
        self, models: Sequence[TriangleMesh], pieces: Sequence[Facets], poses: Sequence[Floats]
    ) -> list[WindowView]:
        """Visible pieces of models at these poses, (4, 4) each, from each window."""
        all_of = TriangleMesh.joined([m.moved(p) for p, m in zip(poses, models, strict=True)])
        both = list(zip(poses, pieces, strict=True))
        content = Facets(
            points=np.concatenate([apply_rigid(t, p.points) for t, p in both]),
            normals=np.concatenate([p.normals @ t[:3, :3].T for t, p in both]),
            areas=np.concatenate([p.areas for p in pieces]),
        )
        model = np.repeat(np.arange(len(pieces)), [len(p.points) for p in pieces])
        middles = np.stack([apply_rigid(t, _middle(p)[None])[0] for t, p in both])
        reaches = np.array([_reach(p) for p in pieces])
        blocker = MeshScene(all_of.vertices, all_of.faces, num_threads=1)
        renderer = renderer_in_box(content, blocker, self._prior, self._waveform, num_threads=1)

        def view_from(window: MeasuredWindow) -> WindowView:
            lit = renderer.lit_content(window.middle)
            own = model[lit.index]
            arms = (content.points[lit.index] - middles[own]) / reaches[own, None]
            turns = np.cross(np.eye(3), arms[:, None])
            shifts = np.broadcast_to(np.eye(3), turns.shape)
            return WindowView(
                window=window,
                lit=lit.index,
                points=lit.points,
                amplitudes=lit.amplitudes * lobe(lit, window.middle),
                motions=np.concatenate([turns, shifts], axis=1),
                model=own,
            )

        with Workers(self._threads) as workers:
            return workers.each(view_from, self._windows)

    def images(self, views: list[WindowView], n_models: int, *, n_motions: int = 6) -> list[Array]:
        """Heat map of each model in each view, and its derivatives by its motions.

        Each (n_targets, n_models, 1 + n_motions).
        """

        def image(view: WindowView) -> Array:
            shape = len(view.window.measured), n_models, 1 + n_motions
            out, of = np.zeros(shape, dtype=np.complex128), view.window.image
            for m in np.unique(view.model):
                own = view.model == m
                amplitudes, points = view.amplitudes[own], view.points[own]
                out[:, m, 0] = of(amplitudes, points)
                for k in range(n_motions):
                    step = _STEP_M * view.motions[own, k]
                    ahead, back = (of(amplitudes, points + shift) for shift in (step, -step))
                    out[:, m, 1 + k] = (ahead - back) / (2.0 * _STEP_M)
            return out

        with Workers(self._threads) as workers:
            return workers.each(image, views)

    def _shares(
        self,
        views: list[WindowView],
        images: list[Array],
        gains: dict[int, complex],
        pieces: Sequence[Facets],
        patches: Sequence[Ints],
    ) -> list[Patches]:
        """Measured share of the expected echo of each model's patches."""
        counts = [int(patch.max()) + 1 for patch in patches]
        starts = np.cumsum([0, *counts])
        which = np.concatenate([p + s for p, s in zip(patches, starts[:-1], strict=True)])
        n_planes = 1 + max(gains)

        def parts(view: WindowView, image: Array) -> PatchEchoes:
            gain, own = gains[view.window.plane], which[view.lit]
            echoes = {
                int(q): gain * view.window.image(view.amplitudes[at], view.points[at])
                for q in np.unique(own)
                if (at := own == q).any()
            }
            rest = view.window.measured - gain * image[:, :, 0].sum(axis=1)
            return PatchEchoes(view.window.plane * _N_GROUPS // n_planes, rest, echoes)

        with Workers(self._threads) as workers:
            echoes = workers.each(parts, views, images)
        found = []
        for one, patch, start, n in zip(pieces, patches, starts[:-1], counts, strict=True):
            shares = np.array([share_of(echoes, [start + q]) for q in range(n)])
            silent = []
            for group in _groups(one, patch, shares[:, 0] < 0.5):
                share = share_of(echoes, list(start + group))
                if share.is_absent:
                    silent.append((group, share))
            whole = share_of(echoes, range(start, start + n))
            found.append(
                Patches(pieces=one, patch=patch, shares=shares, whole=whole, silent=tuple(silent))
            )
        return found


class NormalEquations(NamedTuple):
    """Normal equations of small motions of all models."""

    matrix: Floats
    scores: Floats
    """Score of each group, (n_groups, n_motions)."""
    residual: float
    """Sum of the logarithms of the residual power shares of the groups."""
    explained: float
    gains: dict[int, complex]
    """Complex gain of each plane."""
    planes: Ints

    def step(self, placements: Sequence[Placement]) -> Floats:
        """Gauss-Newton step of each model, (n_models, 6) [m]."""
        keep = _project_on_determined(placements)
        matrix = keep @ self.matrix @ keep
        matrix += (_DAMPING * np.trace(matrix) / len(matrix) + 1e-30) * np.eye(len(matrix))
        step = np.linalg.solve(matrix, keep @ self.scores.sum(axis=0))
        return np.clip(step, -_LARGEST_M, _LARGEST_M).reshape(-1, 6)

    def covariance(self, placements: Sequence[Placement]) -> Floats:
        """Covariance of the motions, (n_motions, n_motions) [m^2]."""
        keep = _project_on_determined(placements)
        inverse = np.linalg.pinv(keep @ self.matrix @ keep, hermitian=True)
        n_planes = int(self.planes.max()) + 1
        if n_planes < _N_GROUPS:  # too few groups: residuals of planes are independent
            return np.asarray(inverse + _FLOOR_M**2 * np.eye(len(inverse)))
        scores = np.zeros((_N_GROUPS, len(self.matrix)))
        np.add.at(scores, self.planes * _N_GROUPS // n_planes, self.scores)
        scores = (scores - scores.mean(axis=0)) @ keep
        found = inverse @ (scores.T @ scores) @ inverse * (_N_GROUPS / (_N_GROUPS - 6))
        return np.asarray(found + _FLOOR_M**2 * np.eye(len(found)))


def normal_equations(views: list[WindowView], images: list[Array], by: str) -> NormalEquations:
    """Linearised residuals of heat maps with a free complex gain for each plane, or more.

    by: plane; window: a gain for each window and model, so that distances between models are free.
    """
    groups: dict[int, list[int]] = {}
    for number, view in enumerate(views):
        groups.setdefault(number if by == "window" else view.window.plane, []).append(number)
    n = images[0].shape[1] * (images[0].shape[2] - 1)
    matrix, scores, shares = np.zeros((n, n)), np.zeros((len(groups), n)), []
    gains: dict[int, complex] = {}
    for row, members in enumerate(groups.values()):
        plane = views[members[0]].window.plane
        measured = np.concatenate([views[m].window.measured for m in members])
        image = np.concatenate([images[m] for m in members])
        seen = image[:, :, 0] if by == "window" else image[:, :, 0].sum(axis=1, keepdims=True)
        inverse = np.linalg.pinv(seen, rcond=_MIN_IMAGE)
        gain = inverse @ measured
        rest = measured - seen @ gain
        gains[plane] = complex(gain[0])
        shares.append(power_of(rest) / power_of(measured))
        slopes = (gain[:, None] * image[:, :, 1:]).reshape(len(measured), n)
        slopes -= seen @ (inverse @ slopes)
        matrix += (slopes.conj().T @ slopes).real / power_of(rest)
        scores[row] = (slopes.conj().T @ rest).real / power_of(rest)
    return NormalEquations(
        matrix=matrix,
        scores=scores,
        residual=float(np.log(shares).sum()),
        explained=1.0 - float(np.median(shares)),
        gains=gains,
        planes=np.array([views[members[0]].window.plane for members in groups.values()]),
    )


def _project_on_determined(placements: Sequence[Placement]) -> Floats:
    """Projection on the determined motions: without rotations about axes of symmetry."""
    keep = np.eye(6 * len(placements))
    for m, placement in enumerate(placements):
        if placement.free_axis is not None:
            axis = np.asarray(placement.free_axis)
            keep[6 * m : 6 * m + 3, 6 * m : 6 * m + 3] -= np.outer(axis, axis)
    return keep


def _placement(start: Placement, pose: Floats, pieces: Facets, covariance: Floats) -> Placement:
    """Placement with another pose and covariance; free rotations keep their variance."""
    scale = np.array([1.0 / _reach(pieces)] * 3 + [1.0] * 3)
    scaled = scale[:, None] * covariance[:, :6] * scale
    if start.free_axis is not None:
        axis = np.r_[np.asarray(start.free_axis), 0.0, 0.0, 0.0]
        scaled = scaled + float(axis @ start.covariance @ axis) * np.outer(axis, axis)
    middle = apply_rigid(pose, _middle(pieces)[None])[0]
    return replace(start, pose=pose, covariance=scaled, middle_m=middle)


def _move_pose(pose: Floats, step: Floats, pieces: Facets) -> Floats:
    """Pose after rotations [m at the rim] about the model's centre, and translations [m]."""
    middle = apply_rigid(pose, _middle(pieces)[None])[0]
    turn = Rotation.from_rotvec(step[:3] / _reach(pieces)).as_matrix()
    moved = pose.copy()
    moved[:3, :3] = turn @ pose[:3, :3]
    moved[:3, 3] = turn @ (pose[:3, 3] - middle) + middle + step[3:]
    return moved


def _middle(pieces: Facets) -> Floats:
    return np.asarray(pieces.areas @ pieces.points / pieces.areas.sum())


def _reach(pieces: Facets) -> float:
    return float(np.linalg.norm(pieces.points - _middle(pieces), axis=1).max())


def _groups(pieces: Facets, patch: Ints, chosen: Array) -> list[Ints]:
    """Index arrays of connected groups of chosen patches."""
    pairs = KDTree(pieces.points).query_pairs(_TOUCHING_M, output_type="ndarray")
    i, j = patch[pairs[:, 0]], patch[pairs[:, 1]]
    both = chosen[i] & chosen[j]
    labels = connected_labels(i[both], j[both], len(chosen))
    return [np.flatnonzero(labels == label) for label in np.unique(labels[chosen])]
