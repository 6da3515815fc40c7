"""Reflectivity and power of a finished surface, from the heat maps of the planes it was made of."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, nnls
from scipy.spatial import KDTree

from geraf2._types import Floats, Ints, Progress
from geraf2.errors import UserError
from geraf2.geometry.triangles import split_triangles
from geraf2.glints.wall_delay import box_delay_m
from geraf2.imaging.volume import pose_image
from geraf2.io.mesh import TriangleMesh
from geraf2.ops.visibility import MeshScene
from geraf2.rendering.surface import N_WALL_PARTS, ExcessPath, Facets, SurfaceRenderer
from geraf2.scene import Grid, LosPrior, Pose, Waveform
from geraf2.surfaces.config import SurfaceFitConfig

_NEAREST_NODES = 3
_MAX_STEPS = 20
_FOLDS = 4


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
    of part k and P the measured one, all planes alike; reflectivities are not negative. The start
    is the non-negative solution of abs(P)^2 = sum c_k^2 abs(P_k)^2, in which the content is one.
    Of several stiffnesses the one is taken with the least error of planes left out, a quarter at a
    time (one of them in turn where there are fewer).

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
    choices = config.stiffness
    if len(planes) > 1 and len(choices) > 1:
        choices = (min(choices, key=lambda stiffness: _left_out_error(planes, nodes, stiffness)),)
    return _solve(planes, nodes, choices[0])


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


def _left_out_error(planes: list[_PlaneImages], nodes: Floats, stiffness: float) -> float:
    """Sum of squared errors of planes, each by a fit to planes of other folds."""
    total, n_folds = 0.0, min(_FOLDS, len(planes))
    for fold in range(n_folds):
        kept = [plane for number, plane in enumerate(planes) if number % n_folds != fold]
        echo = _solve(kept, nodes, stiffness)
        factors = echo.power * np.concatenate([echo.reflectivity, echo.walls])
        for parts, measured in planes[fold::n_folds]:
            total += float(np.square(np.abs(factors @ parts) - measured).sum())
    return total


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


def _solve(planes: list[_PlaneImages], nodes: Floats, stiffness: float) -> SurfaceEcho:
    """Coefficients of the parts' images whose sum has the measured magnitudes."""
    n_nodes = len(nodes)
    images = np.concatenate([plane.parts for plane in planes], axis=1).astype(np.complex128)
    magnitudes = np.concatenate([plane.measured for plane in planes]).astype(np.float64)
    together = np.concatenate([images[:n_nodes].sum(axis=0)[None], images[n_nodes:]])
    start = np.sqrt(nnls(np.abs(together.T) ** 2, magnitudes**2)[0])
    if not start[0] > 0.0:
        raise UserError(
            what="the surface echoes nowhere where the scan does",
            hint="is the run of this scene? Reconstruct it again",
        )
    # In units of the content's start: reflectivities, then real and imaginary parts of the walls.
    images = images * start[0]
    basis = np.concatenate([images, 1j * images[n_nodes:]])
    stiff = stiffness * np.linalg.norm(magnitudes) / np.sqrt(n_nodes)

    def rendered(x: Floats) -> NDArray[np.complex128]:
        return np.asarray(x @ basis)

    def residual(x: Floats) -> Floats:
        spread = stiff * (x[:n_nodes] - x[:n_nodes].mean())
        return np.concatenate([np.abs(rendered(x)) - magnitudes, spread])

    def jacobian(x: Floats) -> Floats:
        image = rendered(x)
        turned = np.conj(image) / np.maximum(np.abs(image), 1e-12 * magnitudes.max())
        rows = np.zeros((n_nodes, x.size))
        rows[:, :n_nodes] = stiff * (np.eye(n_nodes) - 1.0 / n_nodes)
        return np.concatenate([(turned * basis).real.T, rows])

    walls = start[1:] / start[0]
    first = np.concatenate([np.ones(n_nodes), walls, np.zeros(N_WALL_PARTS)])
    low = np.concatenate([np.zeros(n_nodes), np.full(2 * N_WALL_PARTS, -np.inf)])
    found = least_squares(residual, first, jac=jacobian, bounds=(low, np.inf), max_nfev=_MAX_STEPS)
    reflectivity = found.x[:n_nodes]
    real, imaginary = found.x[n_nodes:].reshape(2, N_WALL_PARTS)
    mean = float(reflectivity.mean()) or 1.0
    return SurfaceEcho(
        nodes=nodes,
        reflectivity=reflectivity / mean,
        power=float(start[0]) * mean,
        walls=(real + 1j * imaginary) / mean,
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
