"""Optimiser of the paper's method: rates of the parameters."""

import math

import torch

from geraf2.learned.config import FULL_RATE_STEPS, PaperConfig, StageConfig
from geraf2.learned.fields import LearnedSdfGrid
from geraf2.learned.model import PaperModel


def make_optimiser(model: PaperModel, config: PaperConfig, stage: StageConfig) -> torch.optim.AdamW:
    """AdamW with one group per parameter of a stage, each with its rate and weight decay."""
    groups, is_grid = [], config.field == "grid"
    for name, parameter in model.named_parameters():
        part = name.split(".")[0]
        if part == "reflectivity" and not stage.train_reflectivity:
            continue
        if part == "sharpness" and config.sharpness == "scheduled":
            continue
        if part == "sdf":
            rate = config.mlp_rate
            if isinstance(model.sdf, LearnedSdfGrid):
                # Finer voxels get fewer samples a step, hence noisier gradients.
                rate = config.grid_rate * config.grid_n[0] / model.sdf.grid.shape[0]
                # Adam's steps are equally long for noise and signal: more steps erode more.
                rate *= min(FULL_RATE_STEPS / max(config.stage1.n_steps, 1), 1.0)
            rate *= stage.shape_rate
        elif part == "power":
            rate = config.power_rate
        elif part == "reflectivity" and is_grid:
            rate = 10.0 * config.other_rate  # logits of a grid: no other weight multiplies them
        else:
            rate = config.other_rate
        is_network = not is_grid and part in ("sdf", "reflectivity")
        decay = config.weight_decay if is_network else 0.0
        group = {"params": [parameter], "lr": rate, "weight_decay": decay}
        groups.append(group | {"name": name, "base_rate": rate})
    return torch.optim.AdamW(groups, eps=1e-10)


def take_over(optimiser: torch.optim.Optimizer, earlier: torch.optim.Optimizer) -> None:
    """Copy the state of another optimiser for parameters of the same name.

    Without the moments of earlier gradients, Adam's first steps have full length, even for noise,
    and undo the result of small rates.
    """
    known = {group["name"]: earlier.state.get(group["params"][0]) for group in earlier.param_groups}
    for group in optimiser.param_groups:
        state = known.get(group["name"])
        if state:
            optimiser.state[group["params"][0]] = {k: v.clone() for k, v in state.items()}


def set_rates(optimiser: torch.optim.Optimizer, progress: float, final: float) -> None:
    """Cosine from each base rate to `final` times it as progress goes from 0 to 1."""
    share = final + (1.0 - final) * 0.5 * (1.0 + math.cos(math.pi * min(progress, 1.0)))
    for group in optimiser.param_groups:
        group["lr"] = share * group["base_rate"]
