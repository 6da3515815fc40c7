"""Separation of parts that are connected in the surface, by the models that explain them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.spatial import KDTree

from geraf2._types import Floats, Progress
from geraf2.apps.inspection.bodies import Body, close_holes, part_of
from geraf2.apps.inspection.registration import (
    FAR,
    Compared,
    Evidence,
    Placement,
    echoes_of,
    register,
    surface_evidence_of,
)
from geraf2.echoes.glint_set import Glints
from geraf2.geometry.transforms import apply_rigid
from geraf2.io.mesh import TriangleMesh
from geraf2.ops.visibility import MeshScene

_SPARE_M = 0.005
"""Margin around the bounding sphere of a model within which evidence may belong to it [m]."""
_EXPLAINED = 1.5
"""Standard uncertainties within which a placed model explains what was measured."""
_MIN_POINTS = 50
"""Least number of oriented points of a part."""
_N_ROUNDS = 2
"""Rounds of selecting the evidence around a model and registering it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Candidate:
    """A model at a pose."""

    placement: Placement
    measured: Floats
    """Squared normalised distances of the measured points, (n_points,)."""
    cost: float
    """Squared normalised distances of the model's own points, summed by share."""
    points: Floats
    """Points of the placed surface, (n_own, 3) [m]."""
    shares: Floats
    """Independent measurements of each point, (n_own,)."""
    solid: MeshScene
    """The placed model."""

    def overlap(self, other: "_Candidate") -> float:
        """Share of either surface that lies inside the other."""
        both = ((self, other), (other, self))
        return sum(float(a.shares[b.solid.signed_distance(a.points) < 0.0].sum()) for a, b in both)


class _Search:
    """Search for the poses of several models in one content."""

    def __init__(
        self, models: Sequence[TriangleMesh], whole: Body, glints: Glints | None, seed: int
    ) -> None:
        self.models, self.seed = models, seed
        self.evidence, self.echoes = surface_evidence_of(whole, glints), echoes_of(whole, glints)
        self.surface = surface_evidence_of(whole, None)
        self.compared = [Compared(self.evidence, model, seed=seed) for model in models]
        self.share = self.compared[0].measured.share
        self.pool: list[list[_Candidate]] = [[] for _ in models]
        """Candidates of each model."""
        self.searched: set[frozenset[int]] = set()
        """Identities of chosen candidates beside which others were searched."""
        self.reaches = [
            float(np.linalg.norm(m.vertices - m.vertices.mean(axis=0), axis=1).max())
            for m in models
        ]

    def candidate(
        self, m: int, middle: Floats, chosen: Sequence[_Candidate] = ()
    ) -> _Candidate | None:
        """Model registered to the evidence around a position (3,) [m]; None with too little.

        chosen: models whose evidence is theirs: else a part draws others onto its own.
        """
        placed: Placement | None = None
        for _ in range(_N_ROUNDS):
            evidence, surface, echoes = (
                _select_around(e, middle, self.reaches[m] + _SPARE_M, chosen)
                for e in (self.evidence, self.surface, self.echoes)
            )
            if evidence is None or surface is None:
                return None
            placed = register(
                evidence,
                self.models[m],
                surface=surface,
                echoes=echoes,
                start=None if placed is None else placed.pose,
                seed=self.seed,
            )
            middle = placed.middle_m
        assert placed is not None
        measured, own = self.compared[m].pulls(placed.pose)
        few, model = self.compared[m].own, self.models[m]
        return _Candidate(
            placement=placed,
            measured=measured**2,
            cost=float(own**2 @ few.share),
            points=apply_rigid(placed.pose, few.points),
            shares=few.share,
            solid=MeshScene(apply_rigid(placed.pose, model.vertices), model.faces, num_threads=1),
        )

    def middles(self, residual: Floats, n: int) -> Floats:
        """Centres of n clusters of the unexplained points, (n, 3) [m]."""
        rest = self.compared[0].measured.points[residual > _EXPLAINED**2]
        if len(rest) < _MIN_POINTS:
            return np.zeros((0, 3))
        return np.asarray(kmeans2(rest, n, minit="++", seed=self.seed)[0])

    def residual(self, chosen: Iterable[_Candidate]) -> Floats:
        """Squared normalised distances of the measured points to the models, (n_points,)."""
        none = np.full(len(self.share), FAR**2)
        return np.asarray(np.minimum.reduce([none, *(c.measured for c in chosen)]))

    def total(self, chosen: Iterable[_Candidate]) -> float:
        """Decrease of the cost by all candidates."""
        both = list(chosen)
        explained = float(self.share @ (FAR**2 - self.residual(both)))
        inside = sum(a.overlap(b) for a, b in combinations(both, 2))
        return explained - sum(c.cost for c in both) - FAR**2 * inside

    def gain(self, candidate: _Candidate, chosen: Sequence[_Candidate]) -> float:
        """Decrease of the cost by a candidate; not above zero where it does not decrease."""
        explained = np.maximum(self.residual(chosen) - candidate.measured, 0.0)
        gain = float(self.share @ explained) - candidate.cost
        if gain > 0.0:
            gain -= FAR**2 * sum(candidate.overlap(other) for other in chosen)
        return gain


def arrange_models(
    models: Sequence[TriangleMesh],
    whole: Body,
    glints: Glints | None,
    *,
    seed: int = 0,
    progress: Progress = lambda _: None,
) -> list[Placement | None]:
    """Poses of models in one content that together explain the measurement.

    models: each closed, in its own frame [m]. whole: all of the content. glints: of the same run.
    seed: of the points that are drawn.
    progress: called with the largest fraction of the search that can be done, after each model.

    With d the distance of a point in standard uncertainties, at most FAR, it minimises

        sum over measured points of min over models of d^2  +  sum over the models' surfaces d^2,

    where surface inside another model counts FAR^2 more. Greedy: the model and pose with the
    largest gain are added while there is one. A second time it is those with the largest gain for
    the size of the model; the smaller sum counts. Returns a placement for each model; None:
    missing.
    """
    search = _Search(models, whole, glints, seed)
    found: dict[int, _Candidate] = {}
    for by_share in (False, True):
        chosen = _choose_greedily(search, by_share=by_share, progress=progress)
        _improve(search, chosen)
        if search.total(chosen.values()) > search.total(found.values()):
            found = chosen
    return [found[m].placement if m in found else None for m in range(len(models))]


def _choose_greedily(
    search: _Search, *, by_share: bool, progress: Progress
) -> dict[int, _Candidate]:
    """Models at poses that gain most, one after the other."""
    # by_share: gains are relative to the measurements of a model's surface, so that a small part
    # precedes a large one elsewhere.
    chosen: dict[int, _Candidate] = {}
    pool, n = search.pool, len(search.pool)
    while len(chosen) < n:
        others = list(chosen.values())
        remaining = [m for m in range(n) if m not in chosen]
        if (given := frozenset(map(id, others))) not in search.searched:
            search.searched.add(given)
            residual = search.residual(others)
            middles = [point for k in {1, len(remaining)} for point in search.middles(residual, k)]
            for k, (middle, m) in enumerate(product(middles, remaining), 1):
                candidate = search.candidate(m, middle, others)
                pool[m] += [candidate] if candidate else []
                progress((len(chosen) + k / (len(middles) * len(remaining))) / n)
        gains = [
            (search.gain(c, others) / (float(c.shares.sum()) if by_share else 1.0), m, k)
            for m in remaining
            for k, c in enumerate(pool[m])
        ]
        best, m, k = max(gains, default=(0.0, 0, 0))
        if best <= 0.0:
            break
        chosen[m] = pool[m][k]
    return chosen


def _improve(search: _Search, chosen: dict[int, _Candidate]) -> None:
    """Replace the pose of each model by a better one, given the others."""
    for _ in range(len(search.pool)):
        before = dict(chosen)
        for m, candidates in enumerate(search.pool):
            chosen.pop(m, None)
            gains = [search.gain(c, list(chosen.values())) for c in candidates]
            if gains and max(gains) > 0.0:
                chosen[m] = candidates[int(np.argmax(gains))]
        if before == chosen:
            return


def cut_apart(
    bodies: Sequence[Body],
    models: Sequence[TriangleMesh],
    placements: Sequence[Placement | None],
) -> tuple[list[Body], dict[int, int]]:
    """Cut bodies that hold several models into one for each.

    bodies: connected pieces of the content. models, placements: as of `arrange_models`. Each face
    goes to the nearest model of its body; cuts are closed with unseen surface.

    Returns the bodies, the largest first, and the body of each model that was placed.
    """
    trees = [KDTree(body.mesh.corners.mean(axis=1)) for body in bodies]
    inside: list[dict[int, Floats]] = [{} for _ in bodies]
    for m, (model, placement) in enumerate(zip(models, placements, strict=True)):
        if placement is not None:
            points = apply_rigid(placement.pose, model.corners.mean(axis=1))
            gaps = [float(np.median(tree.query(points)[0])) for tree in trees]
            inside[int(np.argmin(gaps))][m] = points
    found: list[tuple[Body, list[int]]] = []
    for body, tree, held in zip(bodies, trees, inside, strict=True):
        if len(held) < 2:
            found.append((body, list(held)))
            continue
        nearest = np.argmin(
            [KDTree(points).query(tree.data)[0] for points in held.values()], axis=0
        )
        for k, m in enumerate(held):
            faces = body.mesh.faces[nearest == k]
            found += [(close_holes(part_of(body, faces)), [m])] if len(faces) else []
    found.sort(key=lambda one: -float(one[0].areas_m2.sum()))
    return [body for body, _ in found], {m: b for b, (_, held) in enumerate(found) for m in held}


def _select_around(
    evidence: Evidence | None, middle: Floats, reach_m: float, others: Sequence[_Candidate]
) -> Evidence | None:
    """Evidence around a position that is not of other models; None with too little."""
    if evidence is None:
        return None
    near = np.linalg.norm(evidence.points - middle, axis=1) < reach_m
    for other in others:
        near &= other.solid.signed_distance(evidence.points) > _SPARE_M
    at = np.flatnonzero(near)
    return evidence.select(at) if len(at) >= _MIN_POINTS else None
