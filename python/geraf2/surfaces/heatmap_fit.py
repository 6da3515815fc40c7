"""A surface is moved to where its heat maps are the measured ones, phase and all.

The surface is the lensless model where its sharpness has no limit (`geraf2.rendering.surface`);
what is learned is a field of displacements along its normals. The start has to be right to a
quarter of a wavelength in most places, as one drawn through glints is (docs/math.md, heat-map fit).
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from geraf2._types import Floats, Progress
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.fields.learning_rate import set_rates
from geraf2.geometry.triangles import split_triangles, vertex_normals, with_area
from geraf2.io.mesh import TriangleMesh
from geraf2.ops import matched_filter, sdf_grid, signal_tracer
from geraf2.ops.visibility import MeshScene
from geraf2.rendering.lensless import antenna_clusters
from geraf2.rendering.surface import Facets, SurfaceRenderer
from geraf2.scene import Capture, Grid, LosPrior
from geraf2.surfaces.config import HeatmapFitConfig
from geraf2.surfaces.isosurface import signed_distances
from geraf2.surfaces.surface_fit import choose_targets, wall_excess_path

_DOMAIN_MARGIN_VOXELS = 4
_SCALE_RATE = 0.01
"""Learning rate of the logarithm of the amplitude's scale."""


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
    tx: Floats
    rx: Floats
    middle: Floats
    targets: Floats
    """Withheld ones last, (n_targets, 3) [m]."""
    measured: Tensor
    """Complex heat map at the targets, (n_targets,)."""
    n_fitted: int
    corners: Tensor = field(default_factory=lambda: torch.zeros((0, 3), dtype=torch.int64))
    """Vertices of the facets in view, (n_lit, 3)."""
    shift: Tensor = field(default_factory=lambda: torch.zeros((0, 3), dtype=torch.float64))
    """Where they seem to be less where they are, (n_lit, 3) [m]."""
    gain: Tensor = field(default_factory=lambda: torch.zeros(0, dtype=torch.float64))
    """Spreading, (n_lit,)."""
    phase: complex = 1.0 + 0.0j


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
    windows = measured_windows(capture, prior, config, rng, num_threads)
    found, residuals = [split_surface(surface, config.max_edge_m)], []
    for number in range(config.n_rounds):
        fit = HeatmapRound(found[-1], capture, prior, windows, config, num_threads)
        residuals.append(fit.residual)
        for step in range(config.n_steps):
            share = (number + step / config.n_steps) / config.n_rounds
            fit.step(share, rng)
            if progress is not None and step % 10 == 0:
                progress(share)
        found.append(fit.moved())
    residuals.append(HeatmapRound(found[-1], capture, prior, windows, config, num_threads).residual)
    best = int(np.argmin(residuals))
    return HeatmapFit(found[best], tuple(residuals), best)


def moved_field(sdf: SdfGrid, surface: TriangleMesh, *, num_threads: int | None = None) -> SdfGrid:
    """Signed distance to a closed surface on the grid of another field [m]."""
    values = signed_distances(surface, sdf.grid.points(), num_threads=num_threads)
    values = values.reshape(sdf.grid.shape)
    return SdfGrid(grid=sdf.grid, values=values.astype(np.float32))


def measured_windows(
    capture: Capture,
    prior: LosPrior,
    config: HeatmapFitConfig,
    rng: np.random.Generator,
    num_threads: int | None,
) -> list[_Window]:
    """Windows of all planes with their measured heat maps."""
    low, high = (np.asarray(bound) for bound in prior.bounds)
    spacing_m = config.target_spacing_m
    inner = np.maximum(high - low - 2.0 * config.wall_margin_m, spacing_m)
    nx, ny, nz = (int(n) + 1 for n in inner / spacing_m)
    grid = Grid.centered(prior.center_m, spacing_m, (nx, ny, nz))
    points = grid.points()
    windows = []
    for plane, pose in enumerate(capture.poses):
        for group in antenna_clusters(pose.phase_centers, min(config.parts, pose.n_antennas)):
            chosen = group
            if len(group) > config.n_antennas:
                chosen = np.sort(rng.choice(group, config.n_antennas, replace=False))
            tx, rx = pose.tx_positions[chosen], pose.rx_positions[chosen]
            signal = np.ascontiguousarray(pose.signal[chosen])
            image = matched_filter(signal, tx, rx, grid, capture.waveform, num_threads=num_threads)
            image = np.asarray(image).ravel()
            drawn = rng.permutation(
                choose_targets(
                    image, config.n_targets, rng, f"the heat map of plane {plane} ({pose.name})"
                )
            )
            windows.append(
                _Window(
                    plane=plane,
                    tx=tx,
                    rx=rx,
                    middle=pose.phase_centers[group].mean(axis=0),
                    targets=points[drawn],
                    measured=torch.from_numpy(image[drawn]),
                    n_fitted=len(drawn) - max(1, round(config.withheld * len(drawn))),
                )
            )
    return windows


class HeatmapRound:
    """One linearisation: which facets are in view, along which normals they move."""

    def __init__(
        self,
        surface: TriangleMesh,
        capture: Capture,
        prior: LosPrior,
        windows: list[_Window],
        config: HeatmapFitConfig,
        num_threads: int | None,
    ) -> None:
        self._surface, self._config = surface, config
        self._waveform, self._num_threads = capture.waveform, num_threads
        self._vertices = torch.from_numpy(np.asarray(surface.vertices, dtype=np.float64))
        self._normals = torch.from_numpy(vertex_normals(surface.vertices, surface.faces))
        self._grid = self._domain()
        self.values = torch.zeros(self._grid.shape, dtype=torch.float64, requires_grad=True)
        self.log_scale = torch.zeros(1, dtype=torch.float64, requires_grad=True)
        self._order: list[int] = []
        self._optimiser = torch.optim.Adam(
            [
                {"params": [self.values], "lr": config.rate_m, "base_rate": config.rate_m},
                {"params": [self.log_scale], "lr": _SCALE_RATE, "base_rate": _SCALE_RATE},
            ],
            betas=(0.9, 0.95),
        )
        self._look(prior, windows)
        self.residual = self._calibrate()

    def _domain(self) -> Grid:
        vertices, spacing_m = self._surface.vertices, self._config.node_spacing_m
        low = vertices.min(axis=0) - _DOMAIN_MARGIN_VOXELS * spacing_m
        high = vertices.max(axis=0) + _DOMAIN_MARGIN_VOXELS * spacing_m
        x, y, z = (float(v) for v in low)
        nx, ny, nz = (int(np.ceil(n)) + 1 for n in (high - low) / spacing_m)
        return Grid(origin_m=(x, y, z), spacing_m=spacing_m, shape=(nx, ny, nz))

    def _look(self, prior: LosPrior, windows: list[_Window]) -> None:
        """Find what each window sees; one that sees nothing is left out."""
        faces = np.asarray(self._surface.faces)
        facets = Facets.of_triangles(np.asarray(self._surface.vertices)[faces])
        renderer = SurfaceRenderer(
            facets,
            Facets.of_triangles(np.asarray(prior.vertices, dtype=np.float64)[prior.faces]),
            MeshScene(self._surface.vertices, self._surface.faces, num_threads=self._num_threads),
            self._waveform,
            prior.center_m,
            excess_path=wall_excess_path(prior, num_threads=self._num_threads),
            num_threads=self._num_threads,
        )
        self.windows = []
        for window in windows:
            lit = renderer.lit_content(window.middle)
            if lit.index.size:
                window.corners = torch.from_numpy(faces[lit.index])
                window.shift = torch.from_numpy(lit.points - facets.points[lit.index])
                window.gain = torch.from_numpy(lit.amplitudes / facets.areas[lit.index])
                self.windows.append(window)
        if not self.windows:
            raise UserError(
                what="no antenna sees any of the content",
                hint="is the box where the scene says? `geraf2 info SCENE`",
            )

    def places(self) -> Tensor:
        """Vertices, moved (n_vertices, 3) [m]."""
        shift = sdf_grid(
            self.values,
            self._grid,
            self._vertices,
            interpolation="cubic",
            num_threads=self._num_threads,
        ).value
        return self._vertices + torch.as_tensor(shift)[:, None] * self._normals

    def image(self, window: _Window, places: Tensor, n_targets: int | None = None) -> Tensor:
        """Heat map of a window at its first targets, or all, less its phase; dtype as measured."""
        a, b, c = (places[window.corners[:, k]] for k in range(3))
        doubled = torch.linalg.cross(b - a, c - a)
        length = torch.linalg.vector_norm(doubled, dim=1)
        amplitude = 0.5 * length * window.gain * torch.exp(self.log_scale)
        signal: Tensor = signal_tracer(
            amplitude.to(window.measured.real.dtype),
            (a + b + c) / 3.0 + window.shift,
            window.tx,
            window.rx,
            self._waveform,
            normals=doubled / length[:, None].clamp(min=1e-15),
            num_threads=self._num_threads,
        )
        return matched_filter(
            signal,
            window.tx,
            window.rx,
            window.targets[:n_targets],
            self._waveform,
            num_threads=self._num_threads,
        )

    def loss(self, window: _Window, places: Tensor) -> Tensor:
        """Share of a window's heat map, as power, that is not explained; without the withheld."""
        image = self.image(window, places, window.n_fitted)
        return _unexplained(image * window.phase, window.measured[: window.n_fitted])

    @torch.no_grad()
    def _calibrate(self) -> float:
        """Scale by magnitudes, phases of the planes by correlation; what the withheld leave.

        That is the root mean square over windows of what is not explained of the withheld targets.
        """
        places = self.places()
        images = [self.image(window, places) for window in self.windows]
        both = rendered = 0.0
        turns: dict[int, complex] = {}
        for window, whole in zip(self.windows, images, strict=True):
            image, seen = whole[: window.n_fitted], window.measured[: window.n_fitted]
            both += float((image.abs() * seen.abs()).sum())
            rendered += float(_power(image).sum())
            size = float(torch.sqrt(_power(image).sum() * _power(seen).sum()))
            turn = complex((image.conj() * seen).sum()) / max(size, 1e-300)
            turns[window.plane] = turns.get(window.plane, 0.0j) + turn
        scale = both / rendered if both > 0.0 and rendered > 0.0 else 1.0
        self.log_scale.fill_(float(np.log(scale)))
        losses = []
        for window, whole in zip(self.windows, images, strict=True):
            turn = turns[window.plane]
            window.phase = turn / abs(turn) if abs(turn) > 0.0 else 1.0 + 0.0j
            rest = whole[window.n_fitted :] * (scale * window.phase)
            losses.append(float(_unexplained(rest, window.measured[window.n_fitted :])))
        return float(np.sqrt(np.mean(losses)))

    def step(self, share: float, rng: np.random.Generator) -> None:
        """One step; `share` of all of them are done."""
        config = self._config
        set_rates(self._optimiser, share, config.final_rate)
        self._optimiser.zero_grad()
        places = self.places()
        loss = self._stiffness()
        for _ in range(min(config.n_windows, len(self.windows))):
            if not self._order:
                self._order = list(rng.permutation(len(self.windows)))
            loss = loss + self.loss(self.windows[self._order.pop()], places)
        if not bool(torch.isfinite(loss)):
            raise UserError(
                what="the heat-map fit's loss is not finite",
                expected="a finite number",
                hint="lower --heatmaps.rate-m, or switch the fit off with --heatmaps.n-rounds 0",
            )
        torch.autograd.backward(loss)
        self._optimiser.step()

    def _stiffness(self) -> Tensor:
        """Bending and anchor terms of the displacement."""
        h = self.values / self._config.node_spacing_m
        bent = h.new_zeros(())
        for axis in range(3):
            n = h.shape[axis]
            low, middle, high = (h.narrow(axis, k, n - 2) for k in range(3))
            bent = bent + (low - 2.0 * middle + high).square().sum()
        return self._config.bending * bent + self._config.anchor * h.square().sum()

    @torch.no_grad()
    def moved(self) -> TriangleMesh:
        """Surface with its vertices where they are now."""
        return TriangleMesh(vertices=self.places().numpy(), faces=self._surface.faces)


def _unexplained(image: Tensor, measured: Tensor) -> Tensor:
    return _power(image - measured).sum() / _power(measured).sum()


def _power(image: Tensor) -> Tensor:
    return image.real.square() + image.imag.square()
