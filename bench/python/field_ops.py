"""Ray march and grid interpolation beside torch autograd on the same equations, in one run.

    python bench/python/field_ops.py

One thread, float32, CPU time, medians of interleaved repeats; the difference is that of the
gradients, relative to their norm.
"""

import argparse
import statistics
import time
from collections.abc import Callable

import torch

from geraf2.ops import ray_march, sdf_grid, simd_level
from geraf2.scene import Grid

GRID = Grid(origin_m=(0.0, 0.0, 0.0), spacing_m=0.002, shape=(96, 96, 96))
INV_S = 84.0

Loss = Callable[[], torch.Tensor]


def torch_march(sdf: torch.Tensor, cos: torch.Tensor, step: torch.Tensor) -> torch.Tensor:
    """Depth by NeuS, equation 13, as it is commonly written."""
    half = 0.5 * cos.clamp(max=0.0) * step
    near, far = torch.sigmoid(INV_S * (sdf - half)), torch.sigmoid(INV_S * (sdf + half))
    alpha = ((near - far) / near).clamp(0.0, 1.0)
    one = torch.ones_like(alpha[:, :1])
    transmittance = torch.cumprod(torch.cat([one, 1.0 - alpha], dim=1), dim=1)[:, :-1]
    middle = torch.cumsum(step, dim=1) - 0.5 * step
    return (transmittance * alpha * middle).sum(dim=1)


def torch_sample(values: torch.Tensor, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Trilinear value and its gradient, both of which sdf_grid returns."""
    points = points.detach().requires_grad_(True)
    origin = points.new_tensor(GRID.origin_m)
    last = points.new_tensor(GRID.shape) - 1.0
    # grid_sample counts axes from the last to the first.
    position = (2.0 * (points - origin) / (GRID.spacing_m * last) - 1.0).flip(1)
    value = torch.nn.functional.grid_sample(
        values[None, None], position[None, None, None], align_corners=True, padding_mode="border"
    ).reshape(-1)
    (gradient,) = torch.autograd.grad(value.sum(), points, create_graph=True)
    return value, gradient


def march_losses(n_rays: int, n_samples: int) -> tuple[torch.Tensor, Loss, Loss]:
    random = torch.Generator().manual_seed(0)
    shape = (n_rays, n_samples)
    sdf = 0.03 + 0.1 * (2.0 * torch.rand(shape, generator=random) - 1.0)
    cos = 2.0 * torch.rand(shape, generator=random) - 1.0
    step = torch.full(shape, 0.006)
    sdf.requires_grad_(True)
    return (
        sdf,
        lambda: torch.as_tensor(ray_march(sdf, cos, step, INV_S).depth).pow(2).sum(),
        lambda: torch_march(sdf, cos, step).pow(2).sum(),
    )


def grid_losses(n_points: int) -> tuple[torch.Tensor, Loss, Loss]:
    """The value squared; grid_sample has no second derivative, so no eikonal term beside it."""
    random = torch.Generator().manual_seed(0)
    values = torch.randn(GRID.shape, generator=random).requires_grad_(True)
    points = 0.19 * torch.rand((n_points, 3), generator=random)

    def ours() -> torch.Tensor:
        return torch.as_tensor(sdf_grid(values, GRID, points).value).pow(2).sum()

    return values, ours, lambda: torch_sample(values, points)[0].pow(2).sum()


def step_ms(leaf: torch.Tensor, loss: Loss) -> float:
    leaf.grad = None
    start = time.process_time()
    loss().backward()  # type: ignore[no-untyped-call]
    return 1e3 * (time.process_time() - start)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rays", type=int, default=1024)
    parser.add_argument("--samples", type=int, default=32)
    parser.add_argument("--points", type=int, default=100000)
    parser.add_argument("--repeats", type=int, default=21)
    options = parser.parse_args()
    torch.set_num_threads(1)
    cases = {
        f"ray_march, {options.rays} x {options.samples}": march_losses(
            options.rays, options.samples
        ),
        f"sdf_grid linear, {options.points} points": grid_losses(options.points),
    }
    for name, (leaf, ours, theirs) in cases.items():
        grads = []
        for loss in (ours, theirs):
            step_ms(leaf, loss)
            assert leaf.grad is not None
            grads.append(leaf.grad)
        times = [[step_ms(leaf, loss) for loss in (ours, theirs)] for _ in range(options.repeats)]
        native, autograd = (statistics.median(column) for column in zip(*times, strict=True))
        difference = float((grads[0] - grads[1]).norm() / grads[1].norm())
        print(
            f"{name}, forward + backward, {simd_level()}: geraf2 {native:.2f} ms, "
            f"torch {autograd:.2f} ms, ratio {autograd / native:.1f}, "
            f"gradients differ by {difference:.1e}"
        )


if __name__ == "__main__":
    main()
