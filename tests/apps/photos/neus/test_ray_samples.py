import numpy as np
import torch

from geraf2.apps.photos.neus.ray_samples import (
    even_edges,
    importance_edges,
    intersect_box,
    middle_and_step,
)


def random_rays(n, seed=0):
    generator = torch.Generator().manual_seed(seed)
    origins = 2.0 * torch.randn((n, 3), generator=generator, dtype=torch.float64)
    directions = torch.randn((n, 3), generator=generator, dtype=torch.float64)
    return origins, directions / directions.norm(dim=1, keepdim=True)


def test_a_ray_is_inside_between_entry_and_exit_and_nowhere_else():
    origins, directions = random_rays(300)
    low, high = torch.tensor([-1.0, -0.5, -0.7]).double(), torch.tensor([0.4, 1.0, 0.9]).double()
    near, far = intersect_box(origins, directions, low, high)
    t = torch.linspace(0.0, 8.0, 801, dtype=torch.float64)
    points = origins[:, None] + t[:, None] * directions[:, None]
    inside = ((points >= low) & (points <= high)).all(dim=2)
    expected = (t >= near[:, None]) & (t <= far[:, None])
    # points that lie on the surface to rounding may fall to either side
    away = ((t - near[:, None]).abs() > 1e-9) & ((t - far[:, None]).abs() > 1e-9)
    assert inside.any()
    assert torch.equal(inside & away, expected & away)


def test_a_ray_along_a_face_and_an_axis_is_no_nan():
    near, far = intersect_box(
        torch.tensor([[0.0, 0.0, -1.0]]),
        torch.tensor([[0.0, 0.0, 1.0]]),
        torch.zeros(3),
        torch.ones(3),
    )
    assert torch.isfinite(near).all()
    assert torch.isfinite(far).all()


def test_a_ray_that_misses_is_sampled_where_it_passes_closest():
    edges = even_edges(torch.zeros(1), torch.ones(1), 64)
    middles, _ = middle_and_step(edges)
    found = importance_edges(edges, 0.04 + (middles - 0.6).abs(), 200.0, 16)
    assert np.median(np.abs(found.numpy() - 0.6)) < 0.02
