"""Assignment of CAD models to parts: present, turned, moved, missing, or another part."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree

from geraf2._types import Floats, Progress
from geraf2.apps.inspection.bodies import Body, Content
from geraf2.apps.inspection.deviation import pose_sigma
from geraf2.apps.inspection.expected_echoes import MIN_EXPLAINED, ExpectedEchoes, Patches
from geraf2.apps.inspection.models import CadModel, diagonal_m
from geraf2.apps.inspection.registration import (
    Placement,
    echoes_of,
    register,
    surface_evidence_of,
)
from geraf2.echoes.glint_set import Glints
from geraf2.geometry.components import face_labels
from geraf2.geometry.transforms import apply_rigid

LARGEST_MISFIT, LARGEST_ECHO_MISFIT = 1.9, 2.08
"""Largest misfit of the right part, without glints and with them. With glints, right parts have
1.76 to 2.01, wrong ones 2.14 to 2.44 (`bench/python/inspection.py --parts development`, preset
fast)."""
_SIZE_RATIO = 2.0
"""Largest ratio of the diagonals of a model and a part that are compared. Rotation alone changes
the diagonal of a bounding box by up to 1.3, and a filled surface adds as much."""
_TURNED_RAD, _MOVED_M = float(np.deg2rad(5.0)), 0.003
"""Smallest reported differences of a pose [rad], [m]; smaller ones are placement tolerance."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Match:
    """A model and its part."""

    model: int
    """Index of the model."""
    body: int | None
    """Index of the part; None: missing; -1: all of the content, for a model of several bodies."""
    placement: Placement | None
    """Pose of the model; None: missing."""
    status: str
    """`present`, `turned`, `moved`, `wrong part` or `missing`."""
    rivals: tuple[tuple[int, float], ...] = ()
    """Other candidates for its part: index of the model, and misfit."""

    @property
    def largest_misfit(self) -> float:
        """Largest misfit of the right part."""
        by_echoes = self.placement is not None and self.placement.by_echoes
        return LARGEST_ECHO_MISFIT if by_echoes else LARGEST_MISFIT


def match_models(
    models: Sequence[CadModel],
    content: Content,
    *,
    any_of: bool = False,
    placed: bool = False,
    given: Mapping[int, tuple[int, Floats]] | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> list[Match]:
    """Match of each model with a part.

    models: in metres. content: in which they are searched.
    any_of: the models are candidates: each part gets the best one, and none is required.
    placed: the models' own frame is the capture's, so that another pose is reported.
    given: known part and initial pose (4, 4) of some models.
    seed: of the points that are drawn. progress: called with the fraction of the models done.
    """
    bodies, whole, glints = content
    of_parts = _split_glints(bodies, glints)
    misfits = np.full((len(models), len(bodies)), np.inf)
    found: dict[tuple[int, int], Placement] = {}
    matches: list[Match] = []

    def register_in(b: int, m: int, start: Floats | None = None) -> Placement:
        body, own = (whole, glints) if b < 0 else (bodies[b], of_parts[b])
        evidence, surface = (surface_evidence_of(body, g) for g in (own, None))
        echoes = echoes_of(body, own)
        return register(
            evidence, models[m].mesh, surface=surface, echoes=echoes, start=start, seed=seed
        )

    def has_bodies(m: int) -> bool:
        return len(bodies) > 1 and face_labels(models[m].mesh.faces)[1] > 1

    known = given or {}
    free = set(range(len(bodies))) - {b for m, (b, _) in known.items() if not has_bodies(m)}
    for n, m in enumerate([*known, *(m for m in range(len(models)) if m not in known)], 1):
        b, start = known.get(m, (-1, None))
        if m in known or has_bodies(m):
            b = -1 if has_bodies(m) else b
            matches.append(_match(m, b, register_in(b, m, start), models[m], placed))
        else:
            for b in free:
                ratio = diagonal_m(models[m].mesh.vertices) / diagonal_m(bodies[b].mesh.vertices)
                if max(ratio, 1.0 / ratio) <= _SIZE_RATIO:
                    found[m, b] = register_in(b, m)
                    misfits[m, b] = found[m, b].misfit
        if progress is not None:
            progress(n / len(models))
    pairs = _assign(misfits, any_of=any_of)
    if len(models) == 1 and len(bodies) > 1 and not matches and not any_of:
        # An unseen stretch of surface may split one part into several.
        found[0, -1] = register_in(-1, 0)
        if found[0, -1].misfit < misfits.min():
            pairs = [(0, -1)]
    for m, b in pairs:
        if (m, b) in found:
            rivals = sorted((misfits[k, b], k) for k in range(len(models)) if (k, b) in found)
            others = tuple((k, float(misfit)) for misfit, k in rivals if any_of and k != m)
            one = _match(m, b, found[m, b], models[m], placed)
            matches.append(replace(one, rivals=others))
    if not any_of:
        matches += [
            Match(model=m, body=None, placement=None, status="missing")
            for m in set(range(len(models))) - {match.model for match in matches}
        ]
    return sorted(matches, key=lambda match: (match.model, match.body or 0))


def _split_glints(bodies: Sequence[Body], glints: Glints | None) -> list[Glints | None]:
    """Glints of each part: those to which no other part is nearer."""
    if glints is None or not len(glints):
        return [None] * len(bodies)
    trees = [KDTree(body.mesh.corners.mean(axis=1)) for body in bodies]
    nearest = np.argmin([tree.query(glints.positions)[0] for tree in trees], axis=0)
    return [glints.select(nearest == b) for b in range(len(bodies))]


def _assign(misfits: Floats, *, any_of: bool) -> list[tuple[int, int]]:
    """Pairs (model, part): the best model of each part, or the best assignment in all."""
    if any_of:
        return [(int(np.argmin(column)), b) for b, column in enumerate(misfits.T)]
    # Pairs that were not compared cost more than any other, so that an assignment exists.
    costs = np.where(np.isfinite(misfits), misfits, 10.0)
    return [(int(m), int(b)) for m, b in zip(*linear_sum_assignment(costs), strict=True)]


def refine_by_echoes(
    matches: Sequence[Match],
    models: Sequence[CadModel],
    expected: ExpectedEchoes,
    *,
    placed: bool = False,
) -> tuple[list[Match], dict[int, Patches]]:
    """Refine poses by expected echoes; returns matches, and patches by index of the match.

    A model is present where half of its echo was measured, and missing where certainly less was.
    The matches are unchanged, without patches, where the models explain less than half of the
    measured power.
    """
    found = [n for n, match in enumerate(matches) if match.placement is not None]
    meshes = [models[matches[n].model].mesh for n in found]
    starts = [p for n in found if (p := matches[n].placement) is not None]
    if not found:
        return list(matches), {}
    echoes = expected.match(meshes, starts)
    if echoes[0].explained < MIN_EXPLAINED:
        return list(matches), {}
    moved, patches = list(matches), dict[int, Patches]()
    for n, echo in zip(found, echoes, strict=True):
        match, placement = matches[n], replace(echo.placement, explained=echo.explained)
        if echo.patches.whole.is_absent:
            moved[n] = replace(match, body=None, placement=None, status="missing")
            continue
        status = match.status if echo.patches.whole.value < 0.5 else "present"
        if status == "present" and placed:
            status = _pose_status(placement, models[match.model])
        moved[n] = replace(match, placement=placement, status=status)
        patches[n] = echo.patches
    return moved, patches


def _match(m: int, b: int, placement: Placement, model: CadModel, placed: bool) -> Match:
    match = Match(model=m, body=b, placement=placement, status="present")
    if placement.misfit > match.largest_misfit:
        return replace(match, status="wrong part")
    return replace(match, status=_pose_status(placement, model)) if placed else match


def _pose_status(placement: Placement, model: CadModel) -> str:
    """Status of a part relative to its nominal pose, within the uncertainty of the scan."""
    vertices = model.mesh.vertices
    here = apply_rigid(placement.pose, vertices)
    middle = vertices.mean(axis=0)
    shift = float(np.linalg.norm(apply_rigid(placement.pose, middle) - middle))
    cosine = 0.5 * (float(np.trace(placement.pose[:3, :3])) - 1.0)
    angle = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
    # Symmetric parts may be rotated by their symmetry: compare surfaces, not matrices.
    gap = float(np.quantile(KDTree(vertices).query(here - (here - vertices).mean(axis=0))[0], 0.95))
    sigma = float(pose_sigma(placement, here).max())
    reach = float(np.linalg.norm(vertices - middle, axis=1).max())
    if angle > _TURNED_RAD and gap > max(3.0 * sigma, 0.5 * np.sin(_TURNED_RAD) * reach):
        return "turned"
    limit = max(_MOVED_M, 3.0 * float(np.linalg.norm(placement.position_sigma_m)))
    return "moved" if shift > limit else "present"
