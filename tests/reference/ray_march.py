"""Volume-rendering weights straight from their equations, in torch; slow."""

import torch


def ray_march(sdf, cos, step, inv_s, two_way):
    """(n_rays, n_samples) three times -> alpha, transmittance, weight, depth."""
    entering = -torch.relu(-cos)
    near = torch.sigmoid(inv_s * (sdf - entering * step / 2))
    far = torch.sigmoid(inv_s * (sdf + entering * step / 2))
    alpha = (near - far) / near
    before = torch.cumprod(1 - alpha, dim=1)[:, :-1]
    transmittance = torch.cat([torch.ones_like(sdf[:, :1]), before], dim=1)[:, : sdf.shape[1]]
    if two_way == "squared":
        transmittance = transmittance**2
    weight = transmittance * alpha
    middle = torch.cumsum(step, dim=1) - step / 2
    return alpha, transmittance, weight, (weight * middle).sum(dim=1)
