"""Complex heat maps that windows of a scan's planes measured, at positions drawn in the box."""

from dataclasses import dataclass

import numpy as np

from geraf2._types import Array, Floats, Ints
from geraf2.apps.inspection.workers import Workers
from geraf2.ops import MatchedFilterPlan, matched_filter, signal_tracer
from geraf2.records import Waveform
from geraf2.scene import Capture, Grid, LosPrior
from geraf2.surfaces.clusters import antenna_clusters
from geraf2.surfaces.facets import LitFacets
from geraf2.surfaces.surface_fit import choose_targets

_PARTS = 2
"""Windows of a plane: sub-apertures side by side."""
_N_ANTENNAS = 120
"""Most antennas of a window; of larger ones so many are drawn."""
_N_TARGETS = 300
"""Positions at which a window's heat map is compared: half drawn by power, half anywhere."""
_SPACING_M = 0.005
"""Spacing of the grid from which they are drawn [m]."""
_MARGIN_M = 0.02
"""Distance to the bounds of the box below which none is drawn [m]: its walls echo there."""
_N_DRAWING = 100
"""Antennas whose heat map decides where targets are drawn."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredWindow:
    """Neighbouring antennas of a plane and the heat map that they measured."""

    plane: int
    middle: Floats
    """Of the antennas, (3,) [m]."""
    antennas: tuple[Floats, Floats]
    """Transmitter and receiver of each, (n_antennas, 3) [m]."""
    waveform: Waveform
    plan: MatchedFilterPlan
    """From signals to the targets, which are summed one by one: they are isolated."""
    measured: Array
    """Complex heat map at the targets, (n_targets,)."""

    def image(self, amplitudes: Array, points: Floats) -> Array:
        """Heat map of facets (n_points, 3) [m] with real amplitudes (n_points,), (n_targets,)."""
        real = amplitudes.astype(np.float32)
        signal = signal_tracer(real, points, *self.antennas, self.waveform, num_threads=1)
        return self.plan.execute(signal)


def measure_windows(
    capture: Capture, prior: LosPrior, rng: np.random.Generator, workers: Workers
) -> list[MeasuredWindow]:
    """Windows of all planes with their measured heat maps."""
    low, high = (np.asarray(bound) for bound in prior.bounds)
    inner = np.maximum(high - low - 2.0 * _MARGIN_M, _SPACING_M)
    nx, ny, nz = (int(n) + 1 for n in inner / _SPACING_M)
    grid = Grid.centered(prior.center_m, _SPACING_M, (nx, ny, nz))
    points = grid.points()

    def measure(plane: int, group: Ints, rng: np.random.Generator) -> MeasuredWindow:
        pose, waveform = capture.poses[plane], capture.waveform
        middle = pose.phase_centers[group].mean(axis=0)
        group = rng.permutation(group)[:_N_ANTENNAS]
        few, used = np.sort(group[:_N_DRAWING]), np.sort(group)
        drawing = np.ascontiguousarray(pose.signal[few])
        antennas = pose.tx_positions[few], pose.rx_positions[few]
        image = matched_filter(drawing, *antennas, grid, waveform, num_threads=1)
        name = f"the heat map of plane {plane} ({pose.name})"
        targets = points[choose_targets(np.asarray(image).ravel(), _N_TARGETS, rng, name)]
        antennas = pose.tx_positions[used], pose.rx_positions[used]
        plan = MatchedFilterPlan(*antennas, targets, waveform, method="exact", num_threads=1)
        measured = plan.execute(np.ascontiguousarray(pose.signal[used]))
        return MeasuredWindow(
            plane=plane,
            middle=middle,
            antennas=antennas,
            waveform=waveform,
            plan=plan,
            measured=measured,
        )

    jobs = [
        (plane, group)
        for plane, pose in enumerate(capture.poses)
        for group in antenna_clusters(pose.phase_centers, min(_PARTS, pose.n_antennas))
    ]
    return workers.each(measure, *zip(*jobs, strict=True), rng.spawn(len(jobs)))


def lobe(lit: LitFacets, middle: Floats) -> Floats:
    """Specular factor of each facet, (n_lit,), as for an antenna in the middle of the window."""
    path = middle - lit.points
    cosine = np.einsum("ij,ij->i", path, lit.normals) / np.linalg.norm(path, axis=1)
    return np.asarray(np.maximum(2.0 * cosine * cosine - 1.0, 0.0))
