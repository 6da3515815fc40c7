"""Parts that have grown together in the surface, told apart by the models that explain them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.spatial import KDTree

from geraf2._types import Floats
from geraf2.apps.inspection.bodies import Body, capped, part_of
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
"""Evidence farther from a model's middle than it reaches and this is not of it [m]."""
_EXPLAINED = 1.5
"""Standard uncertainties within which a placed model explains what was measured."""
_LEAST_GAIN = 1.0
"""Least of FAR^2 times what its own surface stands for that a model takes off: 1.5 to 2.0 where it
is there, at most 0.8 where it is not (boxes of three and of two parts)."""
_LEAST_POINTS = 50
"""Fewer oriented points are no part."""
_N_LOOKS = 2
"""Times that evidence is cut out around a model and the model moved to it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Candidate:
    """A model at a place."""

    placement: Placement
    measured: Floats
    """Squared pulls of what was measured, (n_points,)."""
    cost: float
    """Squared pulls of the model's own surface, times what it stands for, in all."""
    points: Floats
    """Of its surface, where it lies, (n_own, 3) [m]."""
    shares: Floats
    """What each stands for, (n_own,)."""
    solid: MeshScene
    """The model where it lies."""

    def inside(self, other: "_Candidate") -> float:
        """Tell how much of either surface lies in the other, where none can be."""
        both = ((self, other), (other, self))
        return sum(float(a.shares[b.solid.signed_distance(a.points) < 0.0].sum()) for a, b in both)


class _Search:
    """Models, and all that was measured."""

    def __init__(
        self, models: Sequence[TriangleMesh], whole: Body, glints: Glints | None, seed: int
    ) -> None:
        self.models, self.seed = models, seed
        self.evidence, self.echoes = surface_evidence_of(whole, glints), echoes_of(whole, glints)
        self.surface = surface_evidence_of(whole, None)
        self.compared = [Compared(self.evidence, model, seed=seed) for model in models]
        self.share = self.compared[0].measured.share
        self.reaches = [
            float(np.linalg.norm(m.vertices - m.vertices.mean(axis=0), axis=1).max())
            for m in models
        ]

    def candidate(self, m: int, middle: Floats) -> _Candidate | None:
        """Place a model in what lies around a place (3,) [m]."""
        placed: Placement | None = None
        for _ in range(_N_LOOKS):
            evidence, surface, echoes = (
                _around(e, middle, self.reaches[m] + _SPARE_M)
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

    def middles(self, left: Floats, n: int) -> Floats:
        """Middles of n clusters of what is not explained, (n, 3) [m]."""
        rest = self.compared[0].measured.points[left > _EXPLAINED**2]
        if len(rest) < _LEAST_POINTS:
            return np.zeros((0, 3))
        return np.asarray(kmeans2(rest, n, minit="++", seed=self.seed)[0])

    def left(self, chosen: Iterable[_Candidate]) -> Floats:
        """Squared pulls that models leave of what was measured, (n_points,)."""
        none = np.full(len(self.share), FAR**2)
        return np.asarray(np.minimum.reduce([none, *(c.measured for c in chosen)]))

    def gain(self, candidate: _Candidate, chosen: Sequence[_Candidate]) -> float:
        """Tell what a candidate explains of what is left, less what it says too much.

        0 where that is less than _LEAST_GAIN.
        """
        explained = np.maximum(self.left(chosen) - candidate.measured, 0.0)
        gain = float(self.share @ explained) - candidate.cost
        least = _LEAST_GAIN * FAR**2 * float(candidate.shares.sum())
        if gain >= least:
            gain -= FAR**2 * sum(candidate.inside(other) for other in chosen)
        return gain if gain >= least else 0.0


def arranged(
    models: Sequence[TriangleMesh], whole: Body, glints: Glints | None, *, seed: int = 0
) -> list[Placement | None]:
    """Place models in one content so that together they explain what was measured.

    models: each closed, in its own frame [m]. whole: all of the content. glints: of the same run.
    seed: of the points that are drawn.

    With d the distance of a place in standard uncertainties, at most FAR, it makes small

        sum over what was measured of min over models of d^2  +  sum over the models' surfaces d^2,

    where what lies inside another model counts FAR^2 more, in steps: of all models and places the
    one that takes most off, until none takes _LEAST_GAIN. Where a model is not there it takes
    nothing off, and is left out. Returns a placement for each model; None: it is missing.
    """
    search = _Search(models, whole, glints, seed)
    pool: list[list[_Candidate]] = [[] for _ in models]
    chosen: dict[int, _Candidate] = {}
    while len(chosen) < len(models):
        others = list(chosen.values())
        waiting = [m for m in range(len(models)) if m not in chosen]
        for n in {1, len(waiting)}:
            for middle in search.middles(search.left(others), n):
                for m in waiting:
                    found = search.candidate(m, middle)
                    pool[m] += [found] if found else []
        gains = [(search.gain(c, others), m, k) for m in waiting for k, c in enumerate(pool[m])]
        best, m, k = max(gains, default=(0.0, 0, 0))
        if best <= 0.0:
            break
        chosen[m] = pool[m][k]
    _improve(search, pool, chosen)
    return [chosen[m].placement if m in chosen else None for m in range(len(models))]


def _improve(search: _Search, pool: list[list[_Candidate]], chosen: dict[int, _Candidate]) -> None:
    """Exchange each model's place for a better one, given the others."""
    for _ in range(len(pool)):
        before = dict(chosen)
        for m, candidates in enumerate(pool):
            chosen.pop(m, None)
            gains = [search.gain(c, list(chosen.values())) for c in candidates]
            if gains and max(gains) > 0.0:
                chosen[m] = candidates[int(np.argmax(gains))]
        if before == chosen:
            return


def told_apart(
    bodies: Sequence[Body],
    models: Sequence[TriangleMesh],
    placements: Sequence[Placement | None],
) -> tuple[list[Body], dict[int, int]]:
    """Cut bodies that hold several models into one for each.

    bodies: connected pieces of the content. models, placements: as of `arranged`. Each face goes to
    the nearest model of its body, and cuts are closed with surface that nothing was seen of.

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
            found += [(capped(part_of(body, faces)), [m])] if len(faces) else []
    found.sort(key=lambda one: -float(one[0].areas_m2.sum()))
    return [body for body, _ in found], {m: b for b, (_, held) in enumerate(found) for m in held}


def _around(evidence: Evidence | None, middle: Floats, reach_m: float) -> Evidence | None:
    if evidence is None:
        return None
    near = np.flatnonzero(np.linalg.norm(evidence.points - middle, axis=1) < reach_m)
    return evidence.select(near) if len(near) >= _LEAST_POINTS else None
