"""What changed between two scans of the same packed box: appeared, vanished, moved."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from geraf2 import __version__
from geraf2._types import Floats
from geraf2.apps.inspection.bodies import PATCH_M, Body
from geraf2.apps.inspection.deviation import regions_of
from geraf2.geometry.transforms import apply_rigid, rigid, triple
from geraf2.geometry.triangles import vertex_normals
from geraf2.ops.visibility import MeshScene

_N_POINTS, _N_STEPS = 4000, 20
"""Points of the surface that are registered, and steps of the iteration."""
_REACH_M, _ALIKE = 0.012, 0.7
"""Largest distance of a pair of points [m], and least cosine of their normals."""
_BOX_SHIFT_M, _BOX_TURN_RAD = 0.005, float(np.deg2rad(3.0))
"""Standard deviations of a pose by the walls alone: content slides in its box [m], [rad]."""
_LEAST_SCALE_M = 5e-4
"""Least scale of the robust weights [m]: a change below it is none."""
_SAME_BODY_M = 0.03
"""Largest shift of a body that is still the same one [m]."""
_SAME_SIZE = 2.0
"""Largest ratio of the volumes of a body in both scans."""
_SAME_CHANGE_M = 0.01
"""Distance within which the changes against two references are the same [m]."""
_CERTAIN = 0.975
"""Least probability of a change that is reported."""

What = Literal["appeared", "vanished", "moved"]


@dataclass(frozen=True, kw_only=True)
class Change:
    """Something that is not as it was."""

    what: What
    """`appeared`, `vanished` or `moved`."""
    is_body: bool
    """A whole part; else surface of a part that stayed."""
    center_m: tuple[float, float, float]
    """Its middle, in the frame of the run [m]."""
    size_m: float
    """How far it moved, or the distance of both surfaces [m]."""
    sigma_m: float
    """Standard uncertainty of that [m]."""
    probability: float
    """That it changed by more than the tolerance, 0 to 1."""

    def __str__(self) -> str:
        """Return the change in words."""
        at = ", ".join(f"{1e3 * x:.0f}" for x in self.center_m)
        kind = "a part" if self.is_body else "surface"
        return (
            f"{kind} {self.what}, {1e3 * self.size_m:.1f} ± {1.96e3 * self.sigma_m:.1f} mm, "
            f"at ({at}) mm, {100 * self.probability:.1f} %"
        )


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Differences of a run from reference runs of the same packed box."""

    changes: tuple[Change, ...]
    """Found against every reference, the likeliest first."""
    n_parts: tuple[int, ...]
    """Number of parts of the run, and of each reference."""
    shift_m: tuple[float, float, float]
    """By how much the content lies elsewhere than in the first reference, both in their frames, at
    the middle of the content [m]."""
    turn_deg: float
    """And by how much it is turned [degrees]."""
    compared_fraction: float
    """Least share of the run's area that was also seen in a reference, 0 to 1."""
    tolerance_m: float
    """Largest change that is none [m]."""

    @property
    def changed(self) -> bool:
        """Whether anything changed."""
        return bool(self.changes)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, SI units."""
        return {
            "format": "geraf2-comparison",
            "format_version": 1,
            "generator": f"geraf2 {__version__}",
            "changed": self.changed,
            **asdict(self),
        }


class Scanned(NamedTuple):
    """Content of one scan."""

    whole: Body
    bodies: Sequence[Body]


def registered(here: Body, there: Body, start: Floats) -> Floats:
    """Pose that moves the seen surface of one scan onto that of another, (4, 4).

    Minimises sum_i rho(n_i . (T x_i - y_i)) + |t|^2 / s_t^2 + |w|^2 / s_w^2 by Gauss-Newton, rho a
    Cauchy loss: what moved by itself does not count. t and w are the shift and the turn beside the
    pose by the walls, with which the content stays in the box.

    start: pose by the walls.
    """
    x, normals = _oriented(here)
    y, facing = _oriented(there)
    if len(x) < 6 or len(y) < 6:
        return start
    tree, middle = KDTree(y), apply_rigid(start, x).mean(axis=0)
    beside = np.zeros(6)  # of turn and shift, about the middle
    prior = 1.0 / np.array([_BOX_TURN_RAD] * 3 + [_BOX_SHIFT_M] * 3) ** 2
    pose = start
    for _ in range(_N_STEPS):
        moved, turned = apply_rigid(pose, x), normals @ pose[:3, :3].T
        gap, at = tree.query(moved)
        good = (gap < _REACH_M) & (np.einsum("ij,ij->i", turned, facing[at]) > _ALIKE)
        if int(good.sum()) < 6:
            return start
        p, q, n = moved[good], y[at[good]], facing[at[good]]
        off = np.einsum("ij,ij->i", n, q - p)
        scale = max(_LEAST_SCALE_M, 1.4826 * float(np.median(np.abs(off))))
        weight = 1.0 / (1.0 + (off / scale) ** 2) / scale**2
        weight *= min(1.0, _patches(here) / len(off))  # neighbours share their errors
        slope = np.concatenate([np.cross(p - middle, n), n], axis=1)
        matrix = slope.T @ (weight[:, None] * slope) + np.diag(prior)
        step = np.linalg.solve(matrix, slope.T @ (weight * off) - prior * beside)
        beside = beside + step
        turn = Rotation.from_rotvec(beside[:3]).as_matrix()
        pose = rigid(turn, middle + beside[3:] - turn @ middle) @ start
        if np.abs(step).max() < 1e-6:
            break
    return pose


def compared(
    here: Scanned, there: Scanned, pose: Floats, tolerance_m: float, num_threads: int | None = None
) -> tuple[list[Change], float]:
    """Find what changed from an earlier scan, and the share of the area that both saw.

    pose: moves the run into the frame of the earlier scan, (4, 4). tolerance_m: least change [m].
    """
    back = rigid(pose[:3, :3].T, -pose[:3, :3].T @ pose[:3, 3])
    there = Scanned(_moved(there.whole, back), [_moved(body, back) for body in there.bodies])
    changes, explained = _body_changes(here.bodies, there.bodies, tolerance_m)
    shares = []
    for one, other, what in ((here, there, "appeared"), (there, here, "vanished")):
        found, share = _surface_changes(one.whole, other.whole, tolerance_m, num_threads)
        shares.append(share)
        for more, region in found:
            kind: What = "appeared" if (what == "appeared") == more else "vanished"
            change = replace(region, what=kind)
            near = [*explained, *(_of(c) for c in changes if not c.is_body and c.what == kind)]
            if not any(KDTree(points).query(change.center_m)[0] < PATCH_M for points in near):
                changes.append(change)
    return changes, shares[0]


def common_changes(found: Sequence[Sequence[Change]]) -> tuple[Change, ...]:
    """Return the changes against every reference, with the least of their probabilities."""
    kept = []
    for change in found[0]:
        alike = [
            [c for c in others if c.what == change.what and _distance(c, change) < _SAME_CHANGE_M]
            for others in found[1:]
        ]
        if all(alike):
            likely = [max(c.probability for c in some) for some in alike]
            kept.append(replace(change, probability=min([change.probability, *likely])))
    return tuple(sorted(kept, key=lambda change: -change.probability))


def _body_changes(
    here: Sequence[Body], there: Sequence[Body], tolerance_m: float
) -> tuple[list[Change], list[Floats]]:
    """Parts that appeared, vanished or moved, and the vertices that this explains."""
    changes, explained = list[Change](), list[Floats]()
    gaps = np.full((len(here), len(there)), 1.0)
    for i, one in enumerate(here):
        for j, other in enumerate(there):
            ratio = _size(one) / _size(other)
            if max(ratio, 1.0 / ratio) < _SAME_SIZE**0.5:
                gaps[i, j] = np.linalg.norm(_middle(one) - _middle(other))
    rows, columns = linear_sum_assignment(gaps)
    pairs = [(i, j) for i, j in zip(rows, columns, strict=True) if gaps[i, j] < _SAME_BODY_M]
    for i, j in pairs:
        shift, covariance = body_shift(here[i], there[j])
        size = float(np.linalg.norm(shift))
        along = shift / size if size else np.eye(3)[0]
        sigma = float(np.sqrt(along @ covariance @ along))
        probability = float(norm.cdf((size - tolerance_m) / sigma))
        if probability > _CERTAIN:
            changes.append(_change("moved", here[i], size, sigma, probability))
            explained += [here[i].mesh.vertices, there[j].mesh.vertices]
    both: tuple[tuple[What, Sequence[Body], Sequence[Body], int], ...] = (
        ("appeared", here, there, 0),
        ("vanished", there, here, 1),
    )
    for what, bodies, others, side in both:
        known = {pair[side] for pair in pairs}
        for k, body in enumerate(bodies):
            if k in known or _is_within(body, others):
                continue
            sigma = float(np.median(body.sigma_m))
            changes.append(_change(what, body, _size(body), sigma, body.probability))
            explained.append(body.mesh.vertices)
    return changes, explained


def body_shift(here: Body, there: Body) -> tuple[Floats, Floats]:
    """Shift of a part from there to here, (3,) [m], and its covariance, (3, 3) [m^2].

    Least squares of n . (x - y - shift) over the surface that both saw, by its errors. Neighbours
    within a patch count once. Directions that no normal shows have no shift, and the variance of
    a shift of the size of a body.
    """
    x, _ = _oriented(here)
    y, facing = _oriented(there)
    if len(x) < 3 or len(y) < 3:
        return np.zeros(3), np.eye(3) * _SAME_BODY_M**2
    sigma = np.hypot(np.median(here.sigma_m[here.seen]), np.median(there.sigma_m[there.seen]))
    tree, shift = KDTree(y), np.zeros(3)
    matrix = np.eye(3) / _SAME_BODY_M**2
    for _ in range(_N_STEPS):
        gap, at = tree.query(x - shift)
        good = gap < _REACH_M
        n = facing[at[good]]
        off = np.einsum("ij,ij->i", n, x[good] - y[at[good]])
        rest = off - n @ shift
        weight = 1.0 / (1.0 + (rest / (2.0 * sigma)) ** 2) / sigma**2
        weight *= min(1.0, _patches(here) / max(int(good.sum()), 1))
        matrix = np.eye(3) / _SAME_BODY_M**2 + n.T @ (weight[:, None] * n)
        shift = np.linalg.solve(matrix, n.T @ (weight * off))
    return np.asarray(shift), np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def _surface_changes(
    one: Body, other: Body, tolerance_m: float, num_threads: int | None
) -> tuple[list[tuple[bool, Change]], float]:
    """Surface of one scan off that of another, each with whether it lies outside of the other."""
    scene = MeshScene(other.mesh.vertices, other.mesh.faces, num_threads=num_threads)
    values = scene.signed_distance(one.mesh.vertices)
    gap, hit = KDTree(other.mesh.corners.mean(axis=1)).query(one.mesh.vertices)
    sigma = np.hypot(one.sigma_m, other.sigma_m[other.mesh.faces].max(axis=1)[hit])
    seen = one.seen & np.asarray(other.seen[other.mesh.faces].all(axis=1))[hit]
    alone = one.seen & (gap > 2.0 * PATCH_M)  # far from all of the other: it is new
    found = []
    for region in regions_of(one.mesh, values, sigma, seen | alone, tolerance_m):
        size = abs(region.deviation_m)
        probability = float(norm.cdf((size - tolerance_m) / region.sigma_m))
        change = Change(
            what="moved",
            is_body=False,
            center_m=region.center_m,
            size_m=size,
            sigma_m=region.sigma_m,
            probability=probability,
        )
        found.append((region.deviation_m > 0, change))
    areas = one.areas_m2
    return found, float(areas[seen].sum() / max(areas.sum(), 1e-30))


def _oriented(body: Body) -> tuple[Floats, Floats]:
    """Seen vertices, at most `_N_POINTS` of them, with their normals, (n, 3) each."""
    normals = vertex_normals(body.mesh.vertices, body.mesh.faces)
    seen = np.flatnonzero(body.seen)
    some = seen[:: max(1, -(-len(seen) // _N_POINTS))]
    return body.mesh.vertices[some], normals[some]


def _patches(body: Body) -> float:
    return max(1.0, float(body.areas_m2[body.seen].sum()) / PATCH_M**2)


def _moved(body: Body, pose: Floats) -> Body:
    return replace(body, mesh=body.mesh.moved(pose))


def _middle(body: Body) -> Floats:
    return np.asarray(0.5 * (body.mesh.vertices.min(axis=0) + body.mesh.vertices.max(axis=0)))


def _size(body: Body) -> float:
    """Length of the diagonal of its box [m]."""
    return float(np.linalg.norm(np.ptp(body.mesh.vertices, axis=0)))


def _is_within(body: Body, others: Sequence[Body]) -> bool:
    """Whether most of a part is where the other scan has surface: it is connected there."""
    if not others:
        return False
    points = np.concatenate([other.mesh.vertices for other in others])
    return bool(np.median(KDTree(points).query(body.mesh.vertices)[0]) < 0.5 * PATCH_M)


def _change(what: What, body: Body, size: float, sigma: float, probability: float) -> Change:
    return Change(
        what=what,
        is_body=True,
        center_m=triple(_middle(body)),
        size_m=size,
        sigma_m=sigma,
        probability=probability,
    )


def _of(change: Change) -> Floats:
    return np.array([change.center_m])


def _distance(one: Change, other: Change) -> float:
    return float(np.linalg.norm(np.subtract(one.center_m, other.center_m)))
