"""A point target and its image, with a gradient: the kernels on their own.

python examples/matched_filter.py
"""

import torch

from geraf2 import Grid, Waveform, matched_filter

waveform = Waveform(
    start_frequency_hz=77.3704e9, chirp_slope_hz_per_s=70.15e12, sample_rate_hz=625e3, n_samples=32
)
lines = torch.arange(-0.06, 0.061, 0.003, dtype=torch.float64)
y, z = torch.meshgrid(lines, lines, indexing="ij")
antennas = torch.stack([torch.full_like(y, -0.36), y, z], dim=-1).reshape(-1, 3)  # (n, 3) [m]

target = torch.tensor([0.01, -0.02, 0.015], dtype=torch.float64)
path = 2 * (antennas - target).norm(dim=1)  # transmitter and receiver at one position
frequencies = torch.from_numpy(waveform.frequencies_hz)
signal = torch.exp(-2j * torch.pi * frequencies * path[:, None] / 299792458.0)
signal.requires_grad_()

grid = Grid.cube((0.0, 0.0, 0.0), 0.03, 31)
image = matched_filter(signal, antennas, antennas, grid, waveform)
brightest = torch.tensor(grid.points())[image.abs().argmax()]
print(f"target {target.tolist()}, brightest voxel {[round(v, 3) for v in brightest.tolist()]}")

image.abs().square().sum().backward()
print(f"gradient to the signal: {tuple(signal.grad.shape)}, norm {signal.grad.norm():.3g}")
