"""How fast a field learns, over a training."""

import math

import torch


def set_rates(optimiser: torch.optim.Optimizer, progress: float, final: float) -> None:
    """Cosine from each rate to `final` of it as progress goes from 0 to 1."""
    share = final + (1.0 - final) * 0.5 * (1.0 + math.cos(math.pi * min(progress, 1.0)))
    for group in optimiser.param_groups:
        group["lr"] = share * group["base_rate"]
