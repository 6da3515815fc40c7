"""Reflectivity and power of a finished surface, fitted to the heat maps of its scan."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, nnls
from scipy.spatial import KDTree

from geraf2._types import Floats, Ints, Progress
from geraf2.echoes.wall_delay import box_delay_m
from geraf2.errors import UserError
from geraf2.geometry.triangles import split_triangles
from geraf2.imaging.volume import pose_image
from geraf2.io.mesh import TriangleMesh
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Grid, LosPrior, Pose, Waveform
from geraf2.surfaces.config import SurfaceFitConfig
from geraf2.surfaces.facets import N_WALL_PARTS, ExcessPath, Facets, SurfaceRenderer

_NEAREST_NODES = 3
"""Nodes between which a reflectivity is interpolated."""
_MAX_STEPS = 20
_ENOUGH = 1e-4
"""Relative decrease of the sum of squares below which the solver stops."""
_NUGGET = 0.05
"""Variance of a reflectivity that neighbours do not share, relative to the shared variance."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceEcho:
    """Reflectivity of a surface and of the box around it."""

    nodes: Floats
    """Points on the content, (n_nodes, 3) [m]."""
    reflectivity: Floats
    """Reflectivity of the content at the nodes, mean 1, (n_nodes,)."""
    power: float
    """Amplitude of one square metre of reflectivity 1 in the middle of the scene."""
    walls: NDArray[np.complex128]
    """Amplitude and phase of near and far walls, as in `SurfaceRenderer`, over power, (2,)."""

    def arrays(self) -> dict[str, Floats]:
        """Arrays by name, for a checkpoint."""
        power, walls = np.array([self.power]), np.stack([self.walls.real, self.walls.imag])
        return {**vars(self), "power": power, "walls": walls}

    @classmethod
    def of_arrays(cls, arrays: dict[str, Floats]) -> "SurfaceEcho":
        """Inverse of :meth:`arrays`."""
        power, walls = float(arrays["power"][0]), arrays["walls"][0] + 1j * arrays["walls"][1]
        return cls(
            nodes=arrays["nodes"], reflectivity=arrays["reflectivity"], power=power, walls=walls
        )

    def reflectivity_at(self, points: Floats) -> Floats:
        """Interpolate the reflectivity between the nodes, (n, 3) [m] -> (n,)."""
        return self.reflectivity @ node_shares(self.nodes, points)


def wall_excess_path(prior: LosPrior, *, num_threads: int | None = None) -> ExcessPath:
    """Excess path of the known walls of a box."""
    outside = MeshScene(prior.vertices, prior.faces, num_threads=num_threads)

    def excess_path(antennas: Floats, directions: Floats, ranges: Floats) -> Floats:
        return box_delay_m(outside, prior.walls, np.array(antennas), directions, ranges)

    return excess_path


def renderer_in_box(
    content: Facets,
    blocker: MeshScene,
    prior: LosPrior,
    waveform: Waveform,
    *,
    outside: Facets | None = None,
    num_threads: int | None = None,
) -> SurfaceRenderer:
    """Make the renderer of facets in a box, behind its walls.

    content: facets of the content. blocker: what blocks their lines of sight.
    outside: facets of the box; the prior's triangles when None.
    """
    if outside is None:
        outside = Facets.of_triangles(np.asarray(prior.vertices, dtype=np.float64)[prior.faces])
    return SurfaceRenderer(
        content,
        outside,
        blocker,
        waveform,
        prior.center_m,
        excess_path=wall_excess_path(prior, num_threads=num_threads),
        num_threads=num_threads,
    )


def make_surface_renderer(
    content: TriangleMesh,
    prior: LosPrior,
    waveform: Waveform,
    config: SurfaceFitConfig | None = None,
    *,
    num_threads: int | None = None,
) -> SurfaceRenderer:
    """Make the renderer of a content in its box; UserError for one without a surface."""
    config = config or SurfaceFitConfig()
    if content.faces.shape[0] == 0:
        raise UserError(what="the content has no surface to render")

    def facets(mesh: TriangleMesh | LosPrior, edge_m: float) -> Facets:
        return Facets.of_triangles(split_triangles(mesh.vertices[mesh.faces], edge_m))

    return renderer_in_box(
        facets(content, config.max_edge_m),
        MeshScene(content.vertices, content.faces, num_threads=num_threads),
        prior,
        waveform,
        outside=facets(prior, config.wall_edge_m),
        num_threads=num_threads,
    )


def fit_surface_echo(
    renderer: SurfaceRenderer,
    poses: Sequence[Pose],
    grid: Grid,
    config: SurfaceFitConfig | None = None,
    *,
    seed: int = 0,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> SurfaceEcho:
    """Reflectivity, power and walls of a surface, by least squares of its heat maps.

    Minimises sum (abs(sum_k c_k P_k) - abs(P))^2 + stiffness term over the targets of all planes.
    P_k is the image of part k, P the measured image, and reflectivities are not negative. The
    stiffness term is that of :func:`departure_rows`. The solver starts at the non-negative solution
    of abs(P)^2 = sum c_k^2 abs(P_k)^2 with the content as one part. Of several stiffnesses, the one
    with the least leave-one-out error over the planes is used.

    renderer: of the surface.
    poses: planes available for the fit.
    grid: voxels of the heat maps, over the box.
    config: settings of the fit.
    seed: of the targets.
    """
    import torch  # noqa: PLC0415 - torch takes a second

    from geraf2.ops.point_images import point_images  # noqa: PLC0415 - needs torch

    config = config or SurfaceFitConfig()
    nodes = spread_nodes(renderer.content.points, config.n_nodes)
    shares = node_shares(nodes, renderer.content.points)
    rng = np.random.default_rng(seed)
    planes: list[_PlaneImages] = []
    chosen = spread_evenly(poses, config.n_planes)
    for number, pose in enumerate(chosen, start=1):
        waveform = renderer.waveform
        image = np.abs(pose_image(pose, grid, waveform, num_threads=num_threads)).ravel()
        targets = choose_targets(image, config.n_targets, rng, "a plane's heat map")
        signals = torch.from_numpy(renderer.render(pose, shares))
        geometry = pose.tx_positions, pose.rx_positions, grid.points()[targets]
        parts = point_images(signals, signals[:0], *geometry, waveform, num_threads=num_threads)
        planes.append(_PlaneImages(parts.of_signals.numpy(), image[targets]))
        if progress is not None:
            progress(number / len(chosen))
    problem = _MagnitudeFit(planes, len(nodes))
    rows = departure_rows(nodes, config.correlation_m)
    fits = [problem.solve(stiffness * rows) for stiffness in config.stiffness]
    if len(planes) > 1 and len(fits) > 1:
        fits.sort(key=problem.left_out_error)
    return problem.echo(fits[0], nodes)


def spread_evenly(poses: Sequence[Pose], n_most: int) -> list[Pose]:
    """Select at most n_most planes, evenly spread over the scan."""
    chosen = np.unique(np.linspace(0, len(poses) - 1, min(n_most, len(poses))).round())
    return [poses[plane] for plane in chosen.astype(int)]


class _PlaneImages(NamedTuple):
    """Images of one plane at its targets."""

    parts: NDArray[np.complex64]
    """Rendered images of nodes and walls, (n_parts, n_targets)."""
    measured: NDArray[np.float32]
    """Magnitudes of the measured image, (n_targets,)."""


def departure_rows(nodes: Floats, correlation_m: float) -> Floats:
    r"""Whitening matrix W of a prior for reflectivities x at nodes (n_nodes, 3) [m].

    .. math:: |W x|^2 = (x - \bar x)^T C^{-1} (x - \bar x), \qquad
        C_{kl} = e^{-d_{kl}^2 / 2 \ell^2} + 0.05 \, \delta_{kl}

    d are the distances of nodes and l is the correlation length. C is the covariance of a Gaussian
    process (Rasmussen and Williams 2006, section 2.2). Returns (n_nodes, n_nodes).
    """
    distance = np.linalg.norm(nodes[:, None] - nodes, axis=2)
    covariance = np.exp(-0.5 * (distance / correlation_m) ** 2) + _NUGGET * np.eye(len(nodes))
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    return np.asarray(root - root.mean(axis=1, keepdims=True))


def choose_targets(
    image: NDArray[np.inexact], n_targets: int, rng: np.random.Generator, name: str
) -> Ints:
    """Draw indices of samples of a heat map, half by power, half uniformly; ascending, unique.

    name: of the image, for the UserError if it is zero or not finite.
    """
    power = np.abs(image).astype(np.float64) ** 2
    if not (np.isfinite(power).all() and power.sum() > 0.0):
        raise UserError(
            what=f"{name} is zero or not finite",
            expected="finite samples with an echo",
            hint="geraf2 info SCENE; leave the plane out with --hold-out or import it again",
        )
    n_bright = n_targets // 2
    bright = rng.choice(power.size, n_bright, p=power / power.sum())
    return np.unique(np.concatenate([bright, rng.integers(power.size, size=n_targets - n_bright)]))


class _Fitted(NamedTuple):
    """Result of one least-squares fit."""

    x: Floats
    """Reflectivities, then real and imaginary parts of the walls, relative to the start."""
    stiff: Floats
    """Matrix S of the stiffness term |S x|^2, (n_nodes, n_x)."""
    is_free: NDArray[np.bool_]
    """Coefficients that are not at a bound, (n_x,)."""


class _MagnitudeFit:
    """Fit of coefficients to the parts' images, so that their sum has the measured magnitudes.

    planes: images and magnitudes. n_nodes: number of nodes, the parts before the walls.
    """

    def __init__(self, planes: list[_PlaneImages], n_nodes: int) -> None:
        images = np.concatenate([plane.parts for plane in planes], axis=1).astype(np.complex128)
        magnitudes = np.concatenate([plane.measured for plane in planes]).astype(np.float64)
        parts = np.concatenate([images[:n_nodes].sum(axis=0)[None], images[n_nodes:]])
        start = np.sqrt(nnls(np.abs(parts.T) ** 2, magnitudes**2)[0])
        if not start[0] > 0.0:
            raise UserError(
                what="the surface has no echo at the positions of the scan's echoes",
                hint="is the run of this scene? Reconstruct it again",
            )
        images = images * start[0]
        self._basis = np.concatenate([images, 1j * images[n_nodes:]])
        self._magnitudes, self._n_nodes, self._scale = magnitudes, n_nodes, float(start[0])
        walls = start[1:] / start[0]
        self._start = np.concatenate([np.ones(n_nodes), walls, np.zeros(N_WALL_PARTS)])
        ends = np.cumsum([len(plane.measured) for plane in planes])
        self._planes = [
            slice(end - len(p.measured), end) for p, end in zip(planes, ends, strict=True)
        ]

    def solve(self, rows: Floats) -> _Fitted:
        """Minimise the squared errors of magnitudes plus the stiffness term.

        rows: stiffness matrix, (n_nodes, n_nodes), relative to the RMS of the magnitudes.
        """
        stiff = np.zeros((len(rows), len(self._basis)))
        stiff[:, : self._n_nodes] = rows
        stiff *= np.linalg.norm(self._magnitudes) / np.sqrt(self._n_nodes)

        def residual(x: Floats) -> Floats:
            return np.concatenate([self._misfit(x), stiff @ x])

        def jacobian(x: Floats) -> Floats:
            return np.concatenate([self._jacobian(x), stiff])

        low = np.full(len(self._start), -np.inf)
        low[: self._n_nodes] = 0.0
        found = least_squares(
            *(residual, self._start, jacobian),
            bounds=(low, np.inf),
            ftol=_ENOUGH,
            max_nfev=_MAX_STEPS,
        )
        return _Fitted(found.x, stiff, found.active_mask == 0)

    def _misfit(self, x: Floats, targets: slice = slice(None)) -> Floats:
        rendered = np.abs(x @ self._basis[:, targets])
        return np.asarray(rendered - self._magnitudes[targets])

    def _jacobian(self, x: Floats) -> Floats:
        image = x @ self._basis
        phasor = np.conj(image) / np.maximum(np.abs(image), 1e-12 * self._magnitudes.max())
        return np.asarray((phasor * self._basis).real.T)

    def left_out_error(self, fitted: _Fitted) -> float:
        """Leave-one-out error: sum of squared errors of planes, each with a fit without it.

        A fit without plane b is approximated by one Gauss-Newton step from the fit with all planes,

            (J^T J - J_b^T J_b + (1 - e) S^T S)^-1 (J_b^T r_b + e S^T S x)

        J is the Jacobian, r the residual, e the plane's share of the squared magnitudes.
        Source: Beirami et al. 2017, "On optimal generalizability in parametric learning".
        """
        x, stiff, free = fitted
        jacobian, stiff = self._jacobian(x)[:, free], stiff[:, free]
        data, pull, total = jacobian.T @ jacobian, stiff.T @ stiff, 0.0
        energy = np.square(self._magnitudes).sum()
        for plane in self._planes:
            own, without = jacobian[plane], x.copy()
            share = np.square(self._magnitudes[plane]).sum() / energy
            normal = data - own.T @ own + (1.0 - share) * pull
            right = own.T @ self._misfit(x, plane) + share * (pull @ x[free])
            without[free] += np.linalg.lstsq(normal, right, rcond=None)[0]
            without[: self._n_nodes] = np.maximum(without[: self._n_nodes], 0.0)
            total += float(np.square(self._misfit(without, plane)).sum())
        return total

    def echo(self, fitted: _Fitted, nodes: Floats) -> SurfaceEcho:
        """Convert coefficients to reflectivities of mean 1, power and walls."""
        reflectivity = fitted.x[: self._n_nodes]
        real, imaginary = fitted.x[self._n_nodes :].reshape(2, N_WALL_PARTS)
        mean = float(reflectivity.mean()) or 1.0
        return SurfaceEcho(
            nodes=nodes,
            reflectivity=reflectivity / mean,
            power=self._scale * mean,
            walls=np.asarray(real + 1j * imaginary, dtype=np.complex128) / mean,
        )


def spread_nodes(points: Floats, n_nodes: int) -> Floats:
    """Farthest-point samples: each is farthest from those before, at most (n_nodes, 3)."""
    chosen = [0]
    distance = np.linalg.norm(points - points[0], axis=1)
    while len(chosen) < n_nodes and distance.max() > 0.0:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return points[chosen]


def node_shares(nodes: Floats, points: Floats) -> Floats:
    """Interpolation weights of nodes at points, (n_nodes, n_points); columns sum to 1.

    They are inverse squares of the distances to the nearest three nodes.
    """
    n_near = min(_NEAREST_NODES, len(nodes))
    distance, nearest = KDTree(nodes).query(points, k=[*range(1, n_near + 1)])
    weights = 1.0 / np.maximum(distance, 1e-6) ** 2
    weights /= weights.sum(axis=1, keepdims=True)
    shares = np.zeros((len(nodes), len(points)))
    shares[nearest, np.arange(len(points))[:, None]] = weights
    return shares
