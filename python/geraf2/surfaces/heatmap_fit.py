"""A surface is moved to where its heat maps are the measured ones, phase and all.

The surface is the lensless model where its sharpness has no limit (`geraf2.surfaces.facets`);
what is learned is a field of displacements along its normals. The start has to be right to a
quarter of a wavelength in most places, as one drawn through glints is
(docs/math/heat-maps.md#heat-map-fit).
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.ndimage import map_coordinates

from geraf2._types import Array, Floats, Ints, Progress
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.geometry.triangles import split_triangles, vertex_normals, with_area
from geraf2.io.mesh import TriangleMesh
from geraf2.ops import matched_filter, sdf_grid
from geraf2.ops.facet_echo import FacetEcho
from geraf2.ops.sdf_grid import sdf_grid_adjoint
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Capture, Grid, LosPrior
from geraf2.surfaces.adam import Adam
from geraf2.surfaces.clusters import antenna_clusters
from geraf2.surfaces.config import HeatmapFitConfig
from geraf2.surfaces.facets import Facets, LitFacets
from geraf2.surfaces.surface_fit import choose_targets, renderer_in_box
from geraf2.surfaces.workers import Workers

_DOMAIN_MARGIN_VOXELS = 4
_SCALE_RATE = 0.01
"""Learning rate of the logarithm of the amplitude's scale."""
_N_DRAWING = 100
"""Antennas of a window whose heat map says where targets are drawn."""


class HeatmapFit(NamedTuple):
    """Outcome of `fit_heatmaps`."""

    surface: TriangleMesh
    """The start in small facets, moved; not moved if no round made it better."""
    residuals: tuple[float, ...]
    """RMS of the withheld heat maps that is not explained, relative, before and after each
    round."""
    best: int
    """Number of rounds after which the surface was taken; 0 is the start."""


@dataclass(eq=False)
class _Window:
    """Neighbouring antennas of a plane, what they measured, and what they see."""

    plane: int
    middle: Floats
    echo: FacetEcho
    """From facets to the targets, of which the withheld are the last."""
    fitted: FacetEcho
    """From facets to the others."""
    measured: Array
    """Complex heat map at the targets, (n_targets,)."""
    n_fitted: int
    vertices: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    """Those of the facets in view, (n_used,)."""
    corners: Ints = field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))
    """Which of them each facet in view has, (n_lit, 3)."""
    shift: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    """Where facets seem to be less where they are, (n_lit, 3) [m]."""
    amplitudes: Floats = field(default_factory=lambda: np.zeros(0))
    """Area times spreading times lobe, (n_lit,) [m^2]."""
    phase: complex = 1.0 + 0.0j

    def facets(self, moved: Floats) -> Floats:
        """Where facets seem to be (n_lit, 3) when the vertices are moved [m]."""
        a, b, c = self.corners.T
        return np.asarray((moved[a] + moved[b] + moved[c]) / 3.0 + self.shift)


def split_surface(surface: TriangleMesh, max_edge_m: float) -> TriangleMesh:
    """Split a surface until no edge is longer, [m]; corners of neighbours stay one vertex."""
    pieces = with_area(split_triangles(surface.corners, max_edge_m))
    # Halves of an edge are the same numbers from both sides, so that equal corners are equal.
    vertices, index = np.unique(pieces.reshape(-1, 3), axis=0, return_inverse=True)
    return TriangleMesh(vertices=vertices, faces=index.reshape(-1, 3).astype(np.int64))


def fit_heatmaps(
    surface: TriangleMesh,
    capture: Capture,
    prior: LosPrior,
    config: HeatmapFitConfig | None = None,
    *,
    seed: int = 0,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> HeatmapFit:
    """Move a surface along its normals until its heat maps are the measured ones.

    Minimises, over displacements h on a grid, the mean over windows w of
    sum |g e^{j phi} P_w(h) - M_w|^2 / sum |M_w|^2, and `bending` and `anchor` terms, by Adam on a
    few windows a step. P_w is the matched filter of what the window's antennas would receive from
    the surface, M_w the measured one, g one scale, phi a phase for each plane: that of a reflection
    is not known, nor a delay that is not calibrated. Facets' areas, normals and places depend on h;
    which of them are in view is found anew in each round.

    surface: start, wound counter-clockwise from outside [m].
    prior: the box, with its known walls; their own echoes are not rendered.
    config: how long, and how finely.
    seed: of targets and of the order of windows.
    num_threads: threads; torch's number when None. Bit-identical for a given seed and number.

    Raises UserError: the surface has no faces, samples or loss are not finite, or nothing was
        measured.

    Notes
    -----
    The idea of fitting a surface through a differentiable renderer by gradients that are smoothed
    is that of Nicolet et al. 2021.
    """
    config = config or HeatmapFitConfig()
    if surface.faces.shape[0] == 0:
        raise UserError(what="the content has no surface to move")
    rng = np.random.default_rng(seed)
    with Workers(num_threads) as workers:
        windows = measured_windows(capture, prior, config, rng, workers)
        found, residuals = [split_surface(surface, config.max_edge_m)], []
        for number in range(config.n_rounds):
            fit = HeatmapRound(found[-1], capture, prior, windows, config, workers)
            residuals.append(fit.residual)
            for step in range(config.n_steps):
                share = (number + step / config.n_steps) / config.n_rounds
                fit.step(share, rng)
                if progress is not None and step % 10 == 0:
                    progress(share)
            found.append(fit.moved())
        last = HeatmapRound(found[-1], capture, prior, windows, config, workers)
    residuals.append(last.residual)
    best = int(np.argmin(residuals))
    return HeatmapFit(found[best], tuple(residuals), best)


def moved_field(sdf: SdfGrid, surface: TriangleMesh, *, num_threads: int | None = None) -> SdfGrid:
    """Signed distance to a closed surface on the grid of another field [m].

    Farther from it than four voxels it is interpolated between every second voxel.
    """
    grid = sdf.grid
    points = grid.points().reshape(*grid.shape, 3)
    scene = MeshScene(surface.vertices, surface.faces, num_threads=num_threads)
    every = points[::2, ::2, ::2]
    coarse = scene.signed_distance(every.reshape(-1, 3)).reshape(every.shape[:3])
    index = 0.5 * np.indices(grid.shape)
    values = map_coordinates(coarse, index, order=1, mode="nearest")
    near = np.abs(values) < 4.0 * grid.spacing_m
    values[near] = scene.signed_distance(points[near])
    return SdfGrid(grid=grid, values=values.astype(np.float32))


def measured_windows(
    capture: Capture,
    prior: LosPrior,
    config: HeatmapFitConfig,
    rng: np.random.Generator,
    workers: Workers,
) -> list[_Window]:
    """Windows of all planes with their measured heat maps."""
    low, high = (np.asarray(bound) for bound in prior.bounds)
    spacing_m = config.target_spacing_m
    inner = np.maximum(high - low - 2.0 * config.wall_margin_m, spacing_m)
    nx, ny, nz = (int(n) + 1 for n in inner / spacing_m)
    grid = Grid.centered(prior.center_m, spacing_m, (nx, ny, nz))
    points = grid.points()

    def measure(plane: int, group: Ints, rng: np.random.Generator) -> _Window:
        pose, waveform = capture.poses[plane], capture.waveform
        middle = pose.phase_centers[group].mean(axis=0)
        group = rng.permutation(group)[: config.n_antennas]
        # Where the map is bright a few antennas tell.
        few, used = np.sort(group[:_N_DRAWING]), np.sort(group)
        drawing = np.ascontiguousarray(pose.signal[few])
        places = pose.tx_positions[few], pose.rx_positions[few]
        image = matched_filter(drawing, *places, grid, waveform, num_threads=1)
        name = f"the heat map of plane {plane} ({pose.name})"
        drawn = rng.permutation(
            choose_targets(np.asarray(image).ravel(), config.n_targets, rng, name)
        )
        echo = FacetEcho(
            pose.tx_positions[used], pose.rx_positions[used], points[drawn], waveform, num_threads=1
        )
        n_fitted = len(drawn) - max(1, round(config.withheld * len(drawn)))
        fitted = FacetEcho(*echo.antennas, points[drawn[:n_fitted]], waveform, num_threads=1)
        measured = echo.matched(np.ascontiguousarray(pose.signal[used]))
        return _Window(plane, middle, echo, fitted, measured, n_fitted)

    jobs = [
        (plane, group)
        for plane, pose in enumerate(capture.poses)
        for group in antenna_clusters(pose.phase_centers, min(config.parts, pose.n_antennas))
    ]
    return workers.each(measure, *zip(*jobs, strict=True), rng.spawn(len(jobs)))


class HeatmapRound:
    """One linearisation: which facets are in view, along which normals they move."""

    def __init__(
        self,
        surface: TriangleMesh,
        capture: Capture,
        prior: LosPrior,
        windows: list[_Window],
        config: HeatmapFitConfig,
        workers: Workers,
    ) -> None:
        self._surface, self._config, self._workers = surface, config, workers
        self._wavenumber = 2.0 * np.pi / capture.waveform.center_wavelength_m
        self._vertices = np.asarray(surface.vertices, dtype=np.float64)
        self._normals = vertex_normals(surface.vertices, surface.faces)
        self._grid = self._domain()
        self._stiff = _stiffness_matrix(self._grid.shape, config)
        self.values = np.zeros(self._grid.shape)
        self.log_scale = np.zeros(1)
        self._order: list[int] = []
        self._optimiser = Adam((self.values, config.rate_m), (self.log_scale, _SCALE_RATE))
        self.windows = self._look(capture, prior, windows)
        self.residual = self._calibrate()

    def _domain(self) -> Grid:
        vertices, spacing_m = self._surface.vertices, self._config.node_spacing_m
        low = vertices.min(axis=0) - _DOMAIN_MARGIN_VOXELS * spacing_m
        high = vertices.max(axis=0) + _DOMAIN_MARGIN_VOXELS * spacing_m
        x, y, z = (float(v) for v in low)
        nx, ny, nz = (int(np.ceil(n)) + 1 for n in (high - low) / spacing_m)
        return Grid(origin_m=(x, y, z), spacing_m=spacing_m, shape=(nx, ny, nz))

    def _look(self, capture: Capture, prior: LosPrior, windows: list[_Window]) -> list[_Window]:
        """Find what each window sees; one that sees nothing is left out."""
        faces = np.asarray(self._surface.faces)
        facets = Facets.of_triangles(self._vertices[faces])
        blocker = MeshScene(self._surface.vertices, self._surface.faces, num_threads=1)
        renderer = renderer_in_box(facets, blocker, prior, capture.waveform, num_threads=1)

        def look(window: _Window) -> bool:
            lit = renderer.lit_content(window.middle)
            used = np.zeros(len(self._vertices), dtype=bool)
            used[faces[lit.index]] = True
            window.vertices = np.nonzero(used)[0]
            window.corners = (np.cumsum(used) - 1)[faces[lit.index]]
            window.shift = lit.points - facets.points[lit.index]
            window.amplitudes = lit.amplitudes * lobe(lit, window.middle)
            return lit.index.size > 0

        seen = self._workers.each(look, windows)
        if not any(seen):
            raise UserError(
                what="no antenna sees any of the content",
                hint="is the box where the scene says? `geraf2 info SCENE`",
            )
        return [window for window, sees in zip(windows, seen, strict=True) if sees]

    def places(self, vertices: Ints | slice = slice(None)) -> Floats:
        """Vertices, moved (n_vertices, 3) [m]."""
        at = self._vertices[vertices]
        shift = sdf_grid(self.values, self._grid, at, interpolation="cubic", num_threads=1).value
        return at + np.asarray(shift)[:, None] * self._normals[vertices]

    def image(self, window: _Window) -> Array:
        """Heat map of a window at its targets, less scale and phase."""
        return window.echo.image(window.amplitudes, window.facets(self.places(window.vertices)))

    def loss(self, window: _Window) -> tuple[float, Floats, float]:
        """Share of a window's heat map, as power, that is not explained; without the withheld.

        Returns it and its gradients to the displacement at the nodes, grid.shape, and to the
        logarithm of the scale. The path to a facet changes as to the middle of the window.
        """
        turn, n = float(np.exp(self.log_scale[0])) * window.phase, window.n_fitted
        facets = window.facets(self.places(window.vertices))
        image = turn * window.fitted.image(window.amplitudes, facets)
        rest = image - window.measured[:n]
        power = _power(window.measured[:n])
        back = 2.0 / power * np.conj(turn) * rest
        # An echo turns by -k for each metre of path.
        slope = -self._wavenumber * window.amplitudes * window.fitted.adjoint(back, facets).imag
        force = slope[:, None] * window.fitted.path_gradient(facets)
        normals, force_at = self._normals[window.vertices], np.zeros(len(window.vertices))
        for corner in window.corners.T:
            along = np.einsum("ij,ij->i", normals[corner], force) / 3.0
            force_at += np.bincount(corner, weights=along, minlength=len(force_at))
        gradient = sdf_grid_adjoint(
            force_at,
            self._grid,
            self._vertices[window.vertices],
            interpolation="cubic",
            num_threads=1,
        )
        by_scale = 2.0 / power * float(np.vdot(rest, image).real)
        return _power(rest) / power, gradient, by_scale

    def _calibrate(self) -> float:
        """Scale by magnitudes, phases of the planes by correlation; what the withheld leave.

        That is the root mean square over windows of what is not explained of the withheld targets.
        """
        images = self._workers.each(self.image, self.windows)
        both = rendered = 0.0
        turns: dict[int, complex] = {}
        for window, whole in zip(self.windows, images, strict=True):
            image, seen = whole[: window.n_fitted], window.measured[: window.n_fitted]
            both += float((np.abs(image) * np.abs(seen)).sum())
            rendered += _power(image)
            size = np.sqrt(_power(image) * _power(seen))
            turn = complex(np.vdot(image, seen)) / max(float(size), 1e-300)
            turns[window.plane] = turns.get(window.plane, 0.0j) + turn
        scale = both / rendered if both > 0.0 and rendered > 0.0 else 1.0
        self.log_scale[0] = np.log(scale)
        losses = []
        for window, whole in zip(self.windows, images, strict=True):
            turn = turns[window.plane]
            window.phase = turn / abs(turn) if abs(turn) > 0.0 else 1.0 + 0.0j
            rest, seen = whole[window.n_fitted :], window.measured[window.n_fitted :]
            losses.append(_power(rest * (scale * window.phase) - seen) / _power(seen))
        return float(np.sqrt(np.mean(losses)))

    def step(self, share: float, rng: np.random.Generator) -> None:
        """One step; `share` of all of them are done."""
        config = self._config
        chosen = []
        for _ in range(min(config.n_windows, len(self.windows))):
            if not self._order:
                self._order = list(rng.permutation(len(self.windows)))
            chosen.append(self.windows[self._order.pop()])
        total, gradient = self.stiffness()
        by_scale = np.zeros(1)
        for loss, to_values, to_scale in self._workers.each(self.loss, chosen):
            total += loss
            gradient += to_values
            by_scale += to_scale
        if not np.isfinite(total):
            raise UserError(
                what="the heat-map fit's loss is not finite",
                expected="a finite number",
                hint="lower --heatmaps.rate-m, or switch the fit off with --heatmaps.n-rounds 0",
            )
        rate = config.final_rate + (1.0 - config.final_rate) * 0.5 * (1.0 + np.cos(np.pi * share))
        self._optimiser.step((gradient, by_scale), float(rate))

    def stiffness(self) -> tuple[float, Floats]:
        """Bending and anchor terms of the displacement, and their gradient to it."""
        gradient = self._stiff @ self.values.ravel()
        total = 0.5 * float(gradient @ self.values.ravel())
        return total, gradient.reshape(self.values.shape)

    def moved(self) -> TriangleMesh:
        """Surface with its vertices where they are now."""
        return TriangleMesh(vertices=self.places(), faces=self._surface.faces)


def _stiffness_matrix(shape: tuple[int, int, int], config: HeatmapFitConfig) -> sp.csr_array:
    """Second derivative of the bending and anchor terms, (n_nodes, n_nodes)."""
    n_nodes = int(np.prod(shape))
    total = config.anchor * sp.eye_array(n_nodes, format="csr")
    for axis, n in enumerate(shape):
        bent = sp.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(n - 2, n))
        before, after = (sp.eye_array(int(np.prod(s))) for s in (shape[:axis], shape[axis + 1 :]))
        rows = sp.kron(sp.kron(before, bent), after, format="csr")
        total = total + config.bending * (rows.T @ rows)
    return sp.csr_array((2.0 / config.node_spacing_m**2) * total)


def lobe(lit: LitFacets, middle: Floats) -> Floats:
    """Specular factor of each facet, (n_lit,), as for an antenna in the middle of the window."""
    way = middle - lit.points
    cosine = np.einsum("ij,ij->i", way, lit.normals) / np.linalg.norm(way, axis=1)
    return np.asarray(np.maximum(2.0 * cosine * cosine - 1.0, 0.0))


def _power(image: Array) -> float:
    return float(np.vdot(image, image).real)
