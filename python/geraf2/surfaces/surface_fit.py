"""Reflectivity and power of a finished surface, from the heat maps of the planes it was made of."""

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
_MAX_STEPS = 20
_ENOUGH = 1e-4
"""A step that lowers the sum of squares by a smaller share is the last."""
_NUGGET = 0.05
"""Variance of a reflectivity that its neighbours do not share, relative to what they share."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceEcho:
    """How strongly a surface and the box around it echo."""

    nodes: Floats
    """Places on the content, (n_nodes, 3) [m]."""
    reflectivity: Floats
    """Of the content at the nodes, mean 1, (n_nodes,)."""
    power: float
    """Amplitude of a square metre of reflectivity 1 in the middle of the scene."""
    walls: NDArray[np.complex128]
    """Amplitude and phase of the walls, relative to power: from without, from within, (2,)."""

    def arrays(self) -> dict[str, Floats]:
        """By name, for a checkpoint."""
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
        """Interpolated between the nodes, (n, 3) [m] -> (n,)."""
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

    content: facets of what is in the box. blocker: what stands in their way.
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

    Minimises sum (abs(sum_k c_k P_k) - abs(P))^2 + stiffness term over the targets, P_k the image
    of part k and P the measured one, all planes alike; reflectivities are not negative. The
    stiffness term is that of :func:`departure_rows`. The start is the non-negative solution of
    abs(P)^2 = sum c_k^2 abs(P_k)^2, in which the content is one. Of several stiffnesses the one is
    taken with the least error of planes left out, one at a time.

    renderer: of the surface.
    poses: planes that may be fitted to.
    grid: where heat maps are compared, over the box.
    config: what is fitted.
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
        places = pose.tx_positions, pose.rx_positions, grid.points()[targets]
        parts = point_images(signals, signals[:0], *places, waveform, num_threads=num_threads)
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
    """At most so many planes, evenly spread over the scan."""
    chosen = np.unique(np.linspace(0, len(poses) - 1, min(n_most, len(poses))).round())
    return [poses[plane] for plane in chosen.astype(int)]


class _PlaneImages(NamedTuple):
    """What a plane's heat map is at its targets."""

    parts: NDArray[np.complex64]
    """Images of nodes and walls, (n_parts, n_targets)."""
    measured: NDArray[np.float32]
    """Magnitudes, (n_targets,)."""


def departure_rows(nodes: Floats, correlation_m: float) -> Floats:
    r"""Matrix W, (n_nodes, n_nodes): how unlikely reflectivities x at nodes (n_nodes, 3) [m] are.

    .. math:: |W x|^2 = (x - \bar x)^T C^{-1} (x - \bar x), \qquad
        C_{kl} = e^{-d_{kl}^2 / 2 \ell^2} + 0.05 \, \delta_{kl}

    with d the distances of nodes and l the correlation length: the covariance of a Gaussian
    process, as in kriging (Rasmussen and Williams 2006, section 2.2).
    """
    distance = np.linalg.norm(nodes[:, None] - nodes, axis=2)
    covariance = np.exp(-0.5 * (distance / correlation_m) ** 2) + _NUGGET * np.eye(len(nodes))
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    return np.asarray(root - root.mean(axis=1, keepdims=True))


def choose_targets(
    image: NDArray[np.inexact], n_targets: int, rng: np.random.Generator, name: str
) -> Ints:
    """Voxels of a heat map, or magnitudes, (n,): half drawn by power, half anywhere; ascending.

    UserError, which says `name`, if it is zero or not finite.
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
    """Coefficients that are least squares of something."""

    x: Floats
    """Reflectivities, then real and imaginary parts of the walls; in units of the start."""
    stiff: Floats
    """Times x they are residuals, beside those of magnitudes, (n_nodes, n_x)."""
    is_free: NDArray[np.bool_]
    """What is not held at its bound, (n_x,)."""


class _MagnitudeFit:
    """Coefficients of the parts' images whose sums have the measured magnitudes.

    planes: images and magnitudes. n_nodes: parts that are not walls; those come first.
    """

    def __init__(self, planes: list[_PlaneImages], n_nodes: int) -> None:
        images = np.concatenate([plane.parts for plane in planes], axis=1).astype(np.complex128)
        magnitudes = np.concatenate([plane.measured for plane in planes]).astype(np.float64)
        together = np.concatenate([images[:n_nodes].sum(axis=0)[None], images[n_nodes:]])
        start = np.sqrt(nnls(np.abs(together.T) ** 2, magnitudes**2)[0])
        if not start[0] > 0.0:
            raise UserError(
                what="the surface echoes nowhere where the scan does",
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
        """Least squares of magnitudes and of `rows` times the reflectivities.

        rows: (n_nodes, n_nodes), relative to the root mean square of the magnitudes.
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
        turned = np.conj(image) / np.maximum(np.abs(image), 1e-12 * self._magnitudes.max())
        return np.asarray((turned * self._basis).real.T)

    def left_out_error(self, fitted: _Fitted) -> float:
        """Sum of squared errors of planes, each by a fit that did not know of it.

        A fit without a plane is one Gauss-Newton step from that with all of them: with J the
        Jacobian, r the misfit, b the plane and e its share of the squared magnitudes, with which
        stiffness goes, too, (J^T J - J_b^T J_b + (1 - e) S^T S)^-1 (J_b^T r_b + e S^T S x).
        Beirami et al. 2017, "On optimal generalizability in parametric learning".
        """
        x, stiff, free = fitted
        jacobian, stiff = self._jacobian(x)[:, free], stiff[:, free]
        data, pull, total = jacobian.T @ jacobian, stiff.T @ stiff, 0.0
        energy = np.square(self._magnitudes).sum()
        for plane in self._planes:
            own, without = jacobian[plane], x.copy()
            share = np.square(self._magnitudes[plane]).sum() / energy
            normal = data - own.T @ own + (1.0 - share) * pull
            pushed = own.T @ self._misfit(x, plane) + share * (pull @ x[free])
            without[free] += np.linalg.lstsq(normal, pushed, rcond=None)[0]
            without[: self._n_nodes] = np.maximum(without[: self._n_nodes], 0.0)
            total += float(np.square(self._misfit(without, plane)).sum())
        return total

    def echo(self, fitted: _Fitted, nodes: Floats) -> SurfaceEcho:
        """Write coefficients as reflectivities of mean 1, power and walls."""
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
    """Points that stand far apart, each the farthest from those before, (n_nodes, 3) at most."""
    chosen = [0]
    distance = np.linalg.norm(points - points[0], axis=1)
    while len(chosen) < n_nodes and distance.max() > 0.0:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return points[chosen]


def node_shares(nodes: Floats, points: Floats) -> Floats:
    """Weights of nodes at points, (n_nodes, n_points); those of a point sum to 1.

    Inverse squares of the distances to the nearest three.
    """
    n_near = min(_NEAREST_NODES, len(nodes))
    distance, nearest = KDTree(nodes).query(points, k=[*range(1, n_near + 1)])
    weights = 1.0 / np.maximum(distance, 1e-6) ** 2
    weights /= weights.sum(axis=1, keepdims=True)
    shares = np.zeros((len(nodes), len(points)))
    shares[nearest, np.arange(len(points))[:, None]] = weights
    return shares
