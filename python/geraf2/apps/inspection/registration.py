"""Registration of a model: many starts, then robust weighted point-to-plane steps."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from geraf2._types import Floats, Ints
from geraf2.apps.inspection.bodies import PATCH_M, Body
from geraf2.echoes.glint_set import Glints
from geraf2.geometry.transforms import apply_rigid, rigid, triple
from geraf2.geometry.triangles import face_areas, unit_normals
from geraf2.io.mesh import TriangleMesh

MIN_ECHOES = 200
"""Least number of glints that refine a pose without the surface between them."""
N_STARTS = 480
"""Initial rotations: every rotation is within about 25 degrees of one of them."""
_N_COARSE, _N_FINE, _N_COMPARED, _N_CAD_POINTS = 120, 1200, 3000, 15_000
_N_REFINED = 6
"""Number of best starts that are refined with more points."""
_APART_RAD = 0.4
"""Rotations nearer to each other are one: those of the starts are so far apart [rad]."""
_DAMPING = 1e-5
"""Damping of Gauss-Newton steps, relative to the mean information on a motion."""
_COARSE_STEPS = ((0.02, 150), (0.02, 150), (0.012, 50), (0.012, 50), (0.008, 30), (0.005, 30))
"""Residual at which a point loses three quarters of its weight [m], and number of starts kept after
the step."""
_FINE_SCALES_M = (0.006, *(0.004,) * 11)
"""Residuals of the steps with more points [m]: among 2.5 to 8 mm the value with most of the four
development parts of `bench/python/inspection.py` within 1 mm and 1 degree."""
_ECHO_SCATTER_M = 0.001
"""Position error of overlapping echoes beyond the noise [m]: 0.7 to 1.1 mm on flats."""
_TABLE_CELLS = 40
FAR = 3.0
"""Largest normalised distance, in standard uncertainties, when poses are compared."""
_MIN_SIGMA_M = 0.002
"""Least uncertainty of a distance when poses are compared [m]: some glints are false."""
_SLIPPERY = 0.01
"""Least information of a model's surface on a motion relative to the others; below it the motion is
free: a polygon of 20 sides or more counts as round."""
ALIKE = 1.05
"""Least ratio of misfits that decides between two poses."""
_SAME_M = 0.002
"""Largest distance between the surfaces of equal poses [m]: below the resolution of a scan."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """Oriented points of a measured surface, each with its uncertainty."""

    points: Floats
    """(n, 3) [m]."""
    normals: Floats
    """Outward, (n, 3)."""
    sigma_m: Floats
    """Standard uncertainty along the normal, (n,) [m]."""
    share: Floats
    """Number of independent measurements that each point represents, (n,)."""

    def select(self, index: Ints) -> "Evidence":
        """Select points, each with its own share."""
        return Evidence(**{field.name: getattr(self, field.name)[index] for field in fields(self)})

    def take(self, index: Ints) -> "Evidence":
        """Select points, with shares scaled to the same sum."""
        some = self.select(index)
        return replace(some, share=some.share * (self.share.sum() / some.share.sum()))


@dataclass(frozen=True, kw_only=True, eq=False)
class Placement:
    """Pose of a model in the capture's frame."""

    pose: Floats
    """From the model's frame, (4, 4) [m]."""
    covariance: Floats
    """Of small motions x -> x + w x (x - m) + t about the model's middle m in the capture's frame:
    w [rad], then t [m], (6, 6)."""
    middle_m: Floats
    """That middle, (3,) [m]."""
    misfit: float
    """Root mean square distance between measurement and model, in both directions, in standard
    uncertainties (of 2 mm at least), each at most 3: 1 is a good fit, 3 is none."""
    free_axis: tuple[float, float, float] | None
    """Axis of symmetry, about which the rotation is undetermined; None without one."""
    rivals: "tuple[Placement, ...]" = ()
    """Other poses of the model's surface, the least misfit first."""
    by_echoes: bool = False
    """Whether glints alone were compared, without the fitted surface."""
    explained: float | None = None
    """Share of the measured power explained by the echoes of all models; None: not compared."""

    @property
    def rival_misfit(self) -> float | None:
        """Misfit of the best other pose of the model's surface; None without one."""
        return self.rivals[0].misfit if self.rivals else None

    def covariances_at(self, points: Floats) -> Floats:
        """Covariance of the model's position at points (n, 3) [m], (n, 3, 3) [m^2]."""
        x, y, z = (points - self.middle_m).T
        zero = np.zeros(len(points))
        # A small turn w moves a point by w x off.
        turn = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=1).reshape(-1, 3, 3)
        motion = np.concatenate([turn, np.broadcast_to(np.eye(3), turn.shape)], axis=2)
        return np.asarray(motion @ self.covariance @ np.swapaxes(motion, 1, 2))

    @property
    def position_sigma_m(self) -> Floats:
        """Standard uncertainty of the middle, per coordinate, (3,) [m]."""
        return np.sqrt(np.diag(self.covariance)[3:])

    @property
    def rotation_sigma_rad(self) -> Floats:
        """Standard uncertainty of the rotation about each axis of the frame, (3,) [rad]."""
        return np.sqrt(np.diag(self.covariance)[:3])


def surface_evidence_of(body: Body, glints: Glints | None) -> Evidence:
    """Oriented points of a part: face centres with expected errors, and glints with their own."""
    from_mesh, echoes = _mesh_evidence(body), echoes_of(body, glints)
    return from_mesh if echoes is None else _join(from_mesh, echoes)


def echoes_of(body: Body, glints: Glints | None) -> Evidence | None:
    """Glints on a part; None without any."""
    if glints is None or not len(glints):
        return None
    distances, _ = KDTree(body.mesh.corners.mean(axis=1)).query(glints.positions)
    near = glints.select(distances < PATCH_M)
    if not len(near):
        return None
    tree = KDTree(near.positions)
    crowd = np.array([len(n) for n in tree.query_ball_point(near.positions, 0.5 * PATCH_M)])
    return Evidence(
        points=near.positions,
        normals=near.normals,
        sigma_m=np.hypot(near.position_sigma_m, _ECHO_SCATTER_M),
        share=1.0 / crowd,
    )


def register(
    evidence: Evidence,
    model: TriangleMesh,
    *,
    surface: Evidence | None = None,
    echoes: Evidence | None = None,
    start: Floats | None = None,
    seed: int = 0,
) -> Placement:
    """Pose of a model in a partly seen surface.

    evidence: of the measured surface. model: closed, in its own frame [m].
    surface: compared with the starts, since glints may be false; evidence when None.
    echoes: glints alone. MIN_ECHOES or more determine the last steps: the fitted surface is
    smooth, and filled where unseen, which biases a pose.
    start: initial pose, (4, 4); many rotations about the centre when None.
    seed: of the points that are drawn.

    The pose minimises sum w rho(n . (T x - y)) over both directions: from measured points to the
    nearest point of the model, and back, w = share / sigma^2 of the measured point and rho the
    function of Geman and McClure, whose scale falls.
    """
    rng = np.random.default_rng(seed)
    cad = _cad_evidence(model, rng)
    by_echoes = echoes is not None and len(echoes.points) >= MIN_ECHOES
    used = echoes if echoes is not None and by_echoes else evidence
    fine = _Problem(used, cad, (_tree(used.points), _tree(cad.points)), _N_FINE, rng)
    if start is None:
        turns, moves = _search_coarsely(surface or evidence, cad, rng)
    else:
        turns, moves = start[None, :3, :3], start[None, :3, 3]
    for scale in _FINE_SCALES_M:
        turns, moves = fine.step(turns, moves, scale)
    misfits = fine.misfits(turns, moves)
    order = np.argsort(misfits, kind="stable")
    poses = [rigid(turns[n], moves[n]) for n in order]
    tree = KDTree(apply_rigid(poses[0], cad.points))
    rivals = tuple(
        _placement(fine, pose, float(misfits[n]), by_echoes=by_echoes)
        for pose, n in zip(poses[1:], order[1:], strict=True)
        if tree.query(apply_rigid(pose, fine.few.points))[0].max() > _SAME_M
    )
    best = _placement(fine, poses[0], float(misfits[order[0]]), by_echoes=by_echoes)
    return replace(best, rivals=rivals)


def _placement(
    problem: "_Problem",
    pose: Floats,
    misfit: float,
    *,
    by_echoes: bool,
) -> Placement:
    """Pose with its covariance, the inverse of the sum of w n n^T over all measured points."""
    points = apply_rigid(pose, problem.cad.points)
    middle = points.mean(axis=0)
    reach = float(np.linalg.norm(points - middle, axis=1).max())
    scale = np.array([1.0 / reach] * 3 + [1.0] * 3)  # rotations as displacements at the rim
    matrix = scale[:, None] * problem.information(pose, middle) * scale
    normals = problem.cad.normals @ pose[:3, :3].T
    own = np.concatenate([np.cross(points - middle, normals), normals], axis=1) * scale
    shares, motions = np.linalg.eigh(own.T @ own)
    free = None
    if shares[0] < _SLIPPERY * np.median(shares):
        # Information of measured normals on this motion is noise.
        keep = np.eye(6) - np.outer(motions[:, 0], motions[:, 0])
        matrix = keep @ matrix @ keep
        free = triple(motions[:3, 0] / max(float(np.linalg.norm(motions[:3, 0])), 1e-12))
    values, vectors = np.linalg.eigh(matrix)
    # Undetermined motions have the size of the part as standard deviation.
    variances = np.minimum(1.0 / np.maximum(values, 1e-30), reach**2)
    return Placement(
        pose=pose,
        covariance=scale[:, None] * ((vectors * variances) @ vectors.T) * scale,
        middle_m=middle,
        misfit=misfit,
        free_axis=free,
        by_echoes=by_echoes,
    )


def _search_coarsely(
    evidence: Evidence, cad: Evidence, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Rotations (n, 3, 3) and translations (n, 3) of the best of many starts."""
    tables = (_Table(evidence.points), _Table(cad.points))
    problem = _Problem(evidence, cad, tables, _N_COARSE, rng)
    turns = np.concatenate([_spread_rotations(N_STARTS), _axis_rotations(evidence, cad)])
    # Centres of area: unseen surface is filled, so that its centre is near the part's.
    moves = _middle(evidence) - turns @ _middle(cad)
    for scale, n_kept in _COARSE_STEPS:
        turns, moves = problem.step(turns, moves, scale)
        order = np.argsort(problem.misfits(turns, moves), kind="stable")[:n_kept]
        turns, moves = turns[order], moves[order]
    kept: list[int] = []
    for index in range(len(turns)):
        trace = np.einsum("kij,ij->k", turns[kept], turns[index])
        if not (trace > 1.0 + 2.0 * np.cos(_APART_RAD)).any():
            kept.append(index)
        if len(kept) == _N_REFINED:
            break
    return turns[kept], moves[kept]


@dataclass(frozen=True, kw_only=True)
class _Terms:
    """Pairs of points at several poses, in the capture's frame: (n_poses, n_pairs, ...)."""

    positions: Floats
    normals: Floats
    residuals: Floats
    """Along the normals [m]."""
    weights: Floats
    """Zero where normals are opposite [1/m^2]."""
    sigma: Floats
    """Standard uncertainties of the residuals [m]."""
    pulls: Floats
    """Normalised distances, at most FAR; FAR where normals are opposite."""
    share: Floats
    """Relative number of independent measurements; each direction sums to one half."""


class _Problem:
    """Comparison of a measured surface and a model at several poses."""

    def __init__(
        self,
        measured: Evidence,
        cad: Evidence,
        nearest: "tuple[_Nearest, _Nearest]",
        n_points: int,
        rng: np.random.Generator,
    ) -> None:
        self.measured, self.cad = measured, cad
        self.some = measured.take(_draw_points(measured, n_points, rng))
        self.few = cad.take(np.arange(n_points))  # in random order
        self._to_measured, self._to_cad = nearest

    def terms(self, turns: Floats, moves: Floats) -> _Terms:
        some, few, shift = self.some, self.few, moves[:, None]
        hit = self._to_cad((some.points - shift) @ turns)
        turned = np.swapaxes(turns, 1, 2)
        n_model, off = self.cad.normals[hit] @ turned, self.cad.points[hit] @ turned + shift
        off = some.points - off
        moved = few.points @ turned + shift
        near = self._to_measured(moved)
        n_measured, gap = self.measured.normals[near], self.measured.points[near] - moved
        facing = np.concatenate(
            [
                np.einsum("nik,ik->ni", n_model, some.normals),
                np.einsum("nik,nik->ni", n_measured, few.normals @ turned),
            ],
            axis=1,
        )
        sigmas = np.broadcast_to(some.sigma_m, off.shape[:2]), self.measured.sigma_m[near]
        sigma = np.concatenate(sigmas, axis=1)
        share = np.concatenate([some.share, few.share])
        normals = np.concatenate([n_model, n_measured], axis=1)
        apart = np.concatenate([off, gap], axis=1)
        pulls = np.linalg.norm(apart, axis=2) / np.hypot(sigma, _MIN_SIGMA_M)
        halves = [0.5 * one.share / one.share.sum() for one in (some, few)]
        return _Terms(
            positions=np.concatenate([np.broadcast_to(some.points, off.shape), moved], axis=1),
            normals=normals,
            residuals=np.einsum("nik,nik->ni", normals, apart),
            weights=np.where(facing > 0, 0.5 * share / sigma**2, 0.0),
            sigma=sigma,
            pulls=np.where(facing > 0, np.minimum(pulls, FAR), FAR),
            share=np.concatenate(halves),
        )

    def step(self, turns: Floats, moves: Floats, scale_m: float) -> tuple[Floats, Floats]:
        """Poses after one Gauss-Newton step on n . (T x - y)."""
        terms = self.terms(turns, moves)
        middle = terms.positions.mean(axis=1, keepdims=True)
        rows = np.concatenate([np.cross(terms.positions - middle, terms.normals), terms.normals], 2)
        weighted = rows * (terms.weights * _robust_weights(terms.residuals, scale_m))[:, :, None]
        matrix = np.swapaxes(weighted, 1, 2) @ rows
        # Damping suppresses undetermined motions; rotations count as those of a part of 3 cm.
        size = np.trace(matrix[:, 3:, 3:], axis1=1, axis2=2) / 3.0
        matrix += (_DAMPING * size + 1e-12)[:, None, None] * np.diag([1e-3] * 3 + [1.0] * 3)
        right = np.einsum("nia,ni->na", weighted, terms.residuals)
        step = np.linalg.solve(matrix, right[:, :, None])[:, :, 0]
        more = Rotation.from_rotvec(np.clip(step[:, :3], -0.3, 0.3)).as_matrix()
        about = middle[:, 0]
        shifted = about + np.clip(step[:, 3:], -0.02, 0.02)
        return more @ turns, (more @ (moves - about)[:, :, None])[:, :, 0] + shifted

    def misfits(self, turns: Floats, moves: Floats) -> Floats:
        """Root mean square of the pulls at each pose, (n_poses,); see :class:`Placement`."""
        terms = self.terms(turns, moves)
        return np.asarray(np.sqrt(terms.pulls**2 @ terms.share))

    def information(self, pose: Floats, middle: Floats) -> Floats:
        """Inverse covariance of small motions about the middle: w [rad], t [m], (6, 6)."""
        terms = self.terms(pose[None, :3, :3], pose[None, :3, 3])
        normals = terms.normals[0]
        weights = terms.weights[0] * _robust_weights(terms.residuals[0], _FINE_SCALES_M[-1])
        rows = np.concatenate([np.cross(terms.positions[0] - middle, normals), normals], axis=1)
        # Uncertainties are scaled up where the residuals exceed them.
        n_measured = float(weights @ terms.sigma[0] ** 2)
        excess = max(1.0, float(weights @ terms.residuals[0] ** 2) / max(n_measured, 1e-30))
        return np.asarray((rows * weights[:, None]).T @ rows) / excess


class Compared:
    """Comparison of a measured surface with a model at any pose.

    evidence: of the measured surface. model: closed, in its own frame [m]. seed: of the points that
    are drawn; the same seed draws the same measured points for each model.
    """

    def __init__(self, evidence: Evidence, model: TriangleMesh, *, seed: int = 0) -> None:
        cad = _cad_evidence(model, np.random.default_rng(seed))
        nearest = _tree(evidence.points), _tree(cad.points)
        rng = np.random.default_rng(seed)
        self._problem = _Problem(evidence, cad, nearest, _N_COMPARED, rng)
        self.measured, self.own = self._problem.some, self._problem.few
        """Compared points of the measurement, and of the model in its own frame."""

    def pulls(self, pose: Floats) -> tuple[Floats, Floats]:
        """Normalised distances of the measured points, and of the model's points.

        pose: of the model, (4, 4) [m]. At most FAR; FAR where normals are opposite.
        """
        pulls = self._problem.terms(pose[None, :3, :3], pose[None, :3, 3]).pulls[0]
        n = len(self.measured.points)
        return pulls[:n], pulls[n:]


def _robust_weights(residuals: Floats, scale_m: float) -> Floats:
    """Weight of Geman and McClure, (1 + (r / s)^2)^-2."""
    return np.asarray((1.0 + (residuals / scale_m) ** 2) ** -2)


_Nearest = Callable[[Floats], Ints]
"""Index of the nearest of some points, for positions (..., 3) [m]."""


def _tree(points: Floats) -> _Nearest:
    tree = KDTree(points)
    return lambda positions: np.asarray(tree.query(positions)[1])


class _Table:
    """Index of the nearest of many points, from a table of cells around them."""

    def __init__(self, points: Floats) -> None:
        low, high = points.min(axis=0), points.max(axis=0)
        pad = 0.25 * (high - low).max()
        self._low = low - pad
        self._cell = ((high - low).max() + 2.0 * pad) / (_TABLE_CELLS - 1)
        self._shape = np.maximum(np.ceil((high + pad - self._low) / self._cell).astype(int) + 1, 1)
        grid = np.indices(self._shape).reshape(3, -1).T * self._cell + self._low
        self._nearest = KDTree(points).query(grid)[1].reshape(self._shape)

    def __call__(self, positions: Floats) -> Ints:
        cells = np.rint((positions - self._low) / self._cell).astype(np.int64)
        x, y, z = np.moveaxis(np.clip(cells, 0, self._shape - 1), -1, 0)
        return np.asarray(self._nearest[x, y, z])


def _spread_rotations(n: int) -> Floats:
    """Evenly distributed rotations, (n, 3, 3): the spirals of Alexa, Super-Fibonacci, 2022."""
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(n) + 0.5
    r, big_r = np.sqrt(s / n), np.sqrt(1.0 - s / n)
    alpha, beta = 2.0 * np.pi * s / phi, 2.0 * np.pi * s / psi
    quaternions = np.stack(
        [r * np.sin(alpha), r * np.cos(alpha), big_r * np.sin(beta), big_r * np.cos(beta)], axis=1
    )
    return np.asarray(Rotation.from_quat(quaternions).as_matrix())


def _axis_rotations(evidence: Evidence, cad: Evidence) -> Floats:
    """All 24 rotations that align the principal axes, (24, 3, 3)."""
    here, there = (_principal_axes(e) for e in (evidence, cad))
    cube = Rotation.create_group("O").as_matrix()
    return np.asarray(here[None] @ cube @ there.T[None])


def _principal_axes(evidence: Evidence) -> Floats:
    off = evidence.points - _middle(evidence)
    _, vectors = np.linalg.eigh((off * evidence.share[:, None]).T @ off)
    vectors[:, 0] *= np.sign(np.linalg.det(vectors))
    return np.asarray(vectors)


def _middle(evidence: Evidence) -> Floats:
    return np.asarray(evidence.share @ evidence.points / evidence.share.sum())


def _mesh_evidence(body: Body) -> Evidence:
    corners = body.mesh.corners
    areas = face_areas(corners)
    kept = areas > 0
    return Evidence(
        points=corners.mean(axis=1)[kept],
        normals=unit_normals(corners)[kept],
        sigma_m=np.sqrt((body.sigma_m[body.mesh.faces] ** 2).mean(axis=1))[kept],
        share=areas[kept] / PATCH_M**2,
    )


def _cad_evidence(model: TriangleMesh, rng: np.random.Generator) -> Evidence:
    """Points drawn from a model by area, in random order, with the normals of its faces."""
    areas = face_areas(model.corners)
    cumulative = np.cumsum(areas)
    face = np.searchsorted(cumulative, rng.random(_N_CAD_POINTS) * cumulative[-1], side="right")
    face = np.minimum(face, len(areas) - 1)
    root, v = np.sqrt(rng.random(_N_CAD_POINTS)), rng.random(_N_CAD_POINTS)
    weights = np.stack([1.0 - root, root * (1.0 - v), root * v], axis=1)
    return Evidence(
        points=np.einsum("nk,nkd->nd", weights, model.corners[face]),
        normals=unit_normals(model.corners)[face],
        sigma_m=np.ones(_N_CAD_POINTS),
        share=np.full(_N_CAD_POINTS, areas.sum() / PATCH_M**2 / _N_CAD_POINTS),
    )


def _draw_points(evidence: Evidence, n: int, rng: np.random.Generator) -> Ints:
    """Draw indices of at most n points, evenly by share."""
    if len(evidence.points) <= n:
        return np.arange(len(evidence.points))
    order = rng.permutation(len(evidence.points))
    cumulative = np.cumsum(evidence.share[order])
    at = (np.arange(n) + 0.5) / n * cumulative[-1]
    return np.asarray(np.unique(order[np.searchsorted(cumulative, at)]))


def _join(a: Evidence, b: Evidence) -> Evidence:
    names = [field.name for field in fields(a)]
    return Evidence(**{n: np.concatenate([getattr(a, n), getattr(b, n)]) for n in names})
