"""Which model is which part: present, turned, moved, missing, or another part."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree

from geraf2._types import Floats
from geraf2.apps.inspection.bodies import Body
from geraf2.apps.inspection.deviation import pose_sigma
from geraf2.apps.inspection.expected_echoes import LEAST_EXPLAINED, ExpectedEchoes, Patches
from geraf2.apps.inspection.models import CadModel, diagonal_m
from geraf2.apps.inspection.registration import (
    Placement,
    echoes_of,
    register,
    surface_evidence_of,
)
from geraf2.echoes.glint_set import Glints
from geraf2.geometry.transforms import apply_rigid
from geraf2.surfaces.isosurface import face_components

LARGEST_MISFIT, LARGEST_ECHO_MISFIT = 1.9, 2.08
"""A part whose misfit is larger is another part: without glints, and where these are compared. Of
glints, right parts have 1.76 to 2.01, wrong ones 2.14 to 2.44 (`bench/python/inspection.py --parts
development`, preset fast)."""
_SIZE_RATIO = 2.0
"""Diagonals of a model and of a part that differ more are not compared: those of boxes along the
axes differ by up to 1.3 by a turn alone, and a filled surface adds as much."""
_TURNED_RAD, _MOVED_M = float(np.deg2rad(5.0)), 0.003
"""Smallest differences of a pose that are told [rad], [m]; smaller ones are setting, not fault."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Match:
    """A model and the part that it was found in."""

    model: int
    """Which model."""
    body: int | None
    """Which part; None: it is missing. -1: all of the content, for a model of several bodies."""
    placement: Placement | None
    """Where it lies; None: it is missing."""
    status: str
    """`present`, `turned`, `moved`, `wrong part` or `missing`."""
    score: float
    """1 - misfit / 3, 0 to 1; 0 where it is missing."""


def match_models(
    models: Sequence[CadModel],
    bodies: Sequence[Body],
    whole: Body,
    glints: Glints | None,
    *,
    any_of: bool = False,
    placed: bool = False,
    given: Mapping[int, tuple[int, Floats]] | None = None,
    seed: int = 0,
) -> list[Match]:
    """Find each model among the parts.

    models: in metres. bodies: parts, `whole`: all of them in one. glints: of the same run.
    any_of: the models are candidates, each part is the one that fits it best, and none must be
    there.
    placed: the models' own frame is the capture's, where they should lie: another pose is told.
    given: part and pose (4, 4) at which to begin, of models of which these are known.
    seed: of the points that are drawn.
    """
    misfits = np.full((len(models), len(bodies)), np.inf)
    found: dict[tuple[int, int], Placement] = {}

    def placed_in(body: Body, model: CadModel, start: Floats | None = None) -> Placement:
        evidence, surface = (surface_evidence_of(body, g) for g in (glints, None))
        echoes = echoes_of(body, glints)
        return register(
            evidence, model.mesh, surface=surface, echoes=echoes, start=start, seed=seed
        )

    matches: list[Match] = []
    for m, (b, start) in (given or {}).items():
        several = len(bodies) > 1 and face_components(models[m].mesh)[1] > 1
        body = whole if several else bodies[b]
        found_in = -1 if several else b
        matches.append(_match(m, found_in, placed_in(body, models[m], start), models[m], placed))
    known = {match.model for match in matches}
    free = set(range(len(bodies))) - {match.body for match in matches}
    for m, model in enumerate(models):
        if m in known:
            continue
        if len(bodies) > 1 and face_components(model.mesh)[1] > 1:
            matches.append(_match(m, -1, placed_in(whole, model), model, placed))
            continue
        for b, body in enumerate(bodies):
            if b not in free:
                continue
            ratio = diagonal_m(model.mesh.vertices) / diagonal_m(body.mesh.vertices)
            if max(ratio, 1.0 / ratio) <= _SIZE_RATIO:
                found[m, b] = placed_in(body, model)
                misfits[m, b] = found[m, b].misfit
    taken = {match.model for match in matches}
    if any_of:
        pairs = [(int(np.argmin(column)), b) for b, column in enumerate(misfits.T)]
    else:
        # A pair that was not compared costs more than any other, but an assignment exists.
        costs = np.where(np.isfinite(misfits), misfits, 10.0)
        pairs = [(int(m), int(b)) for m, b in zip(*linear_sum_assignment(costs), strict=True)]
    if len(models) == 1 and len(bodies) > 1 and not matches and not any_of:
        # What stands between may not have been seen: one part in pieces.
        found[0, -1] = placed_in(whole, models[0])
        if found[0, -1].misfit < misfits.min():
            pairs = [(0, -1)]
    for m, b in pairs:
        if (m, b) in found:
            matches.append(_match(m, b, found[m, b], models[m], placed))
            taken.add(m)
    if not any_of:
        matches += [
            Match(model=m, body=None, placement=None, status="missing", score=0.0)
            for m in range(len(models))
            if m not in taken
        ]
    return sorted(matches, key=lambda match: (match.model, match.body or 0))


def by_echoes(
    matches: Sequence[Match],
    models: Sequence[CadModel],
    expected: ExpectedEchoes,
    *,
    placed: bool = False,
) -> tuple[list[Match], dict[int, Patches]]:
    """Poses by expected echoes, of all models at once, and how much of their echoes came.

    A model is present where half of its echo came, and missing where it did not for certain.
    Returns the matches, and patches by their index; as they were, and none, where the models
    together explain less than half of what was measured.
    """
    found = [n for n, match in enumerate(matches) if match.placement is not None]
    meshes = [models[matches[n].model].mesh for n in found]
    starts = [p for n in found if (p := matches[n].placement) is not None]
    if not found:
        return list(matches), {}
    echoes = expected.match(meshes, starts)
    if echoes[0].explained < LEAST_EXPLAINED:
        return list(matches), {}
    moved, patches = list(matches), dict[int, Patches]()
    for n, echo in zip(found, echoes, strict=True):
        match, placement = matches[n], replace(echo.placement, explained=echo.explained)
        if echo.patches.whole.is_absent:
            moved[n] = replace(match, body=None, placement=None, status="missing", score=0.0)
            continue
        status = match.status if echo.patches.whole.value < 0.5 else "present"
        if status == "present" and placed:
            status = _against_nominal(placement, models[match.model])
        moved[n] = replace(match, placement=placement, status=status)
        patches[n] = echo.patches
    return moved, patches


def _match(m: int, b: int, placement: Placement, model: CadModel, placed: bool) -> Match:
    score = 1.0 - placement.misfit / 3.0
    largest = LARGEST_ECHO_MISFIT if placement.by_echoes else LARGEST_MISFIT
    status = "present" if placement.misfit <= largest else "wrong part"
    if status == "present" and placed:
        status = _against_nominal(placement, model)
    return Match(model=m, body=b, placement=placement, status=status, score=score)


def _against_nominal(placement: Placement, model: CadModel) -> str:
    """Whether a part lies where its model says, but for what the scan cannot tell."""
    vertices = model.mesh.vertices
    here = apply_rigid(placement.pose, vertices)
    middle = vertices.mean(axis=0)
    shift = float(np.linalg.norm(apply_rigid(placement.pose, middle) - middle))
    cosine = 0.5 * (float(np.trace(placement.pose[:3, :3])) - 1.0)
    angle = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
    # A turn of a symmetric part by its symmetry is none: compare surfaces, not matrices.
    gap = float(np.quantile(KDTree(vertices).query(here - (here - vertices).mean(axis=0))[0], 0.95))
    sigma = float(pose_sigma(placement, here).max())
    reach = float(np.linalg.norm(vertices - middle, axis=1).max())
    if angle > _TURNED_RAD and gap > max(3.0 * sigma, 0.5 * np.sin(_TURNED_RAD) * reach):
        return "turned"
    limit = max(_MOVED_M, 3.0 * float(np.linalg.norm(placement.position_sigma_m)))
    return "moved" if shift > limit else "present"
