"""`paper_preset.py --only levels`: how far off the true surface each term of the loss is least.

The true surface goes into the field, moved outward by MOVED_M; nothing is trained. A row changes
one setting of the preset `paper` and of `paper-corrected`; its figures are the offset at which
L_MF, with the power that fits best, is least [mm], negative inside, and the loss there. `+-` is
half the difference of two halves of the draws of windows, targets and jitter.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
import torch

from geraf2.learned.config import CorrectedPaperConfig, PaperConfig
from geraf2.learned.heatmaps import TargetChooser
from geraf2.learned.losses import eikonal_loss, heatmap_loss
from geraf2.learned.rendering.lensless import LenslessRenderer
from geraf2.learned.trainer import PaperTrainer
from geraf2.ops.visibility import MeshScene

MOVED_M = (-0.010, -0.006, -0.003, 0.0, 0.003, 0.006)
TRUE_N = 49
FORM_FIELDS = (
    *("two_way", "spreading", "lobe_power", "wall_delay", "bright_targets"),
    *("inv_s_start", "grid_rate", "region", "n_cells", "glint_level"),
)
POWER_FACTORS = np.geomspace(0.4, 2.0, 33)


@dataclass(frozen=True, kw_only=True)
class Change:
    """What a row changes."""

    config: dict[str, Any] = field(default_factory=dict)
    inv_s: float | None = None
    true_n: int = TRUE_N
    slope: float = 1.0
    """|grad f|."""
    planes: tuple[int, int] = (0, 1)
    """First one, and every which."""


def changes() -> dict[str, Change]:
    """Rows of the table."""
    lobes = {f"lobe power {p:g}": Change(config={"lobe_power": p}) for p in (1, 4, 8, 16, 32)}
    windows = {f"window {100 * w:g} cm": Change(config={"window_m": w}) for w in (0.025, 0.1)}
    return {
        "as it is": Change(),
        "weight T^2 alpha": Change(config={"two_way": "squared"}),
        "weight unbiased": Change(config={"two_way": "unbiased"}),
        "no spreading": Change(config={"spreading": "none"}),
        "two-way spreading": Change(config={"spreading": "two-way"}),
        **lobes,
        **{f"s = {s:g} per metre": Change(inv_s=s) for s in (60.0, 110.0, 400.0)},
        "walls delay": Change(config={"wall_delay": True}),
        "walls do not delay": Change(config={"wall_delay": False}),
        "correction by own field": Change(config={"ulos": False}),
        **windows,
        "whole plane": Change(config={"window_m": 0.0}),
        "even planes": Change(planes=(0, 2)),
        "odd planes": Change(planes=(1, 2)),
        "uniform targets": Change(config={"bright_targets": 0.0}),
        "a quarter bright targets": Change(config={"bright_targets": 0.25}),
        "bright targets": Change(config={"bright_targets": 1.0}),
        "one look": Change(config={"n_looks": 1}),
        "25 voxels a side": Change(true_n=25),
        "slope 0.7": Change(slope=0.7),
        "slope 1.3": Change(slope=1.3),
    }


def wall_delay_m(trainer: PaperTrainer) -> float:
    """What the known walls add to a way at right angles [m]."""
    return sum(wall.one_way_delay_m for wall in trainer.prior.walls)


class Levels:
    """Losses along the offset, on one trainer whose settings are exchanged."""

    def __init__(self, trainer: PaperTrainer, truth: MeshScene, n_draws: int) -> None:
        self.trainer, self.n_draws = trainer, n_draws
        grids = {n: trainer.domain.grid(n) for n in (25, TRUE_N)}
        self.distance = {
            n: torch.from_numpy(truth.signed_distance(grid.points()).reshape(grid.shape))
            for n, grid in grids.items()
        }

    def prepare(self, config: PaperConfig, change: Change) -> None:
        """Give the trainer the settings of a row."""
        trainer = self.trainer
        trainer.config = replace(config, **change.config)
        trainer.renderer = LenslessRenderer(
            trainer.sampler,
            trainer.vision,
            trainer.capture.waveform,
            trainer.config,
            wall_delay_m=wall_delay_m(trainer) if trainer.config.wall_delay else 0.0,
        )
        trainer.targets = TargetChooser(trainer.maps, trainer.within, trainer.config.bright_targets)
        trainer.model.sharpness.set(change.inv_s or config.inv_s_end)

    def put(self, change: Change, moved_m: float) -> None:
        """Put the surface, moved outward, into the field."""
        sdf = self.trainer.model.sdf
        sdf.values = torch.nn.Parameter(
            (change.slope * (self.distance[change.true_n] - moved_m)).float()
        )
        sdf.grid = self.trainer.domain.grid(change.true_n)

    def maps(
        self, planes: tuple[int, int], draw: int
    ) -> Iterator[tuple[torch.Tensor, torch.Tensor, Any]]:
        """Measured and rendered heat maps at targets, and what was rendered, plane by plane."""
        trainer = self.trainer
        trainer.generator.manual_seed(5 + draw)
        for plane in trainer.planes[planes[0] :: planes[1]]:
            draw = trainer._draw(plane)
            rendered, antennas, signal = trainer._render(draw)
            found, measured = trainer._heatmaps(draw, antennas, signal)
            yield measured, found, (rendered, draw.rays)

    @torch.no_grad()
    def heatmap(self, change: Change) -> np.ndarray:
        """L_MF at each offset, of each draw: (n_moved, n_draws)."""
        trainer, losses = self.trainer, np.empty((len(MOVED_M), self.n_draws))
        for number, moved in enumerate(MOVED_M):
            self.put(change, moved)
            for draw in range(self.n_draws):
                found = list(self.maps(change.planes, draw))
                measured, rendered = (torch.stack([f[i] for f in found]) for i in (0, 1))
                scale = float((measured * rendered).sum() / rendered.square().sum())
                losses[number, draw] = min(
                    heatmap_loss(
                        factor * scale * rendered,
                        measured,
                        trainer.maps.scale,
                        trainer.config.charbonnier,
                    ).item()
                    for factor in POWER_FACTORS
                )
        return losses

    @torch.no_grad()
    def others(self) -> tuple[list[float], list[float]]:
        """L_GRAD and L_RSDF at each offset."""
        eikonal, depth = [], []
        for moved in MOVED_M:
            self.put(Change(), moved)
            found = [f[2] for f in self.maps((0, 1), 0)]
            eikonal.append(np.mean([eikonal_loss(r.gradient).item() for r, _ in found]))
            depth.append(
                np.mean([self.trainer._depth_alignment(r, rays).item() for r, rays in found])
            )
        return eikonal, depth


def least(losses: np.ndarray) -> float:
    """Offset at which a curve (n_moved,) is least [mm]: of the parabola through the three lowest
    neighbours; NaN where it falls to an end."""
    at = int(np.argmin(losses))
    if at in (0, len(losses) - 1):
        return float("nan")
    curve = np.polyfit(MOVED_M[at - 1 : at + 2], losses[at - 1 : at + 2], 2)
    return float(-0.5e3 * curve[1] / curve[0])


def shown(losses: np.ndarray) -> str:
    """Offset, spread and loss of a row."""
    mean = losses.mean(axis=1)
    at = least(mean)
    where = f"{at:+6.1f}"
    if losses.shape[1] > 1:
        a, b = (least(half.mean(axis=1)) for half in np.array_split(losses, 2, axis=1))
        where += f" +-{0.5 * abs(a - b):4.1f}"
    if np.isnan(at):
        where = f"{'< ' if np.argmin(mean) == 0 else '> '}{1e3 * MOVED_M[np.argmin(mean)]:+.0f}"
    return f"{where:>14} {mean.min():8.4f}"


def level_forms(base: PaperConfig) -> dict[str, PaperConfig]:
    """Return the columns of the table."""
    corrected = replace(base, **{n: getattr(CorrectedPaperConfig(), n) for n in FORM_FIELDS})
    return {"paper": base, "paper-corrected": corrected}


def level_rows(
    trainers: dict[str, PaperTrainer], truth: MeshScene, n_draws: int, only: list[str] | None
) -> None:
    """Print the table for `paper` and for its corrected form, a trainer each."""
    forms = {name: trainer.config for name, trainer in trainers.items()}
    levels = {name: Levels(trainer, truth, n_draws) for name, trainer in trainers.items()}
    trainer, base = trainers["paper"], forms["paper"]
    print(
        f"closed forms: weight T^2 alpha {-5e3 / (6.0 * base.inv_s_end):+.1f} mm, "
        f"walls {-1e3 * wall_delay_m(trainer):+.1f} mm"
    )
    print(f"{'least at mm':24}" + "".join(f"{name:>24}" for name in forms))
    for name, change in changes().items():
        if only and name not in only:
            continue
        cells = []
        for name_of_form, config in forms.items():
            levels[name_of_form].prepare(config, change)
            cells.append(shown(levels[name_of_form].heatmap(change)))
        print(f"{name:24}" + "".join(f"{cell:>24}" for cell in cells), flush=True)
    for name, config in forms.items():
        levels[name].prepare(config, Change())
        eikonal, depth = levels[name].others()
        rise = base.stage2.rsdf_weight * max(abs(b - a) for a, b in pairwise(depth))
        print(
            f"{name}: lambda L_GRAD {base.eikonal_weight * min(eikonal):.4f} to "
            f"{base.eikonal_weight * max(eikonal):.4f}; lambda L_RSDF "
            + " ".join(f"{d:.4f}" for d in depth)
            + f" (steepest {rise:.4f} between neighbours)",
            flush=True,
        )
