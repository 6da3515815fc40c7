"""Lensless rendering, slowly: every sample, one factor after another, in torch."""

import torch


def amplitudes(alpha, transmittance, gradient, points, shift, center, form):
    """Amplitude (n,) and normals (n, 3) of samples towards antennas about one centre (3,)."""
    normals = torch.nn.functional.normalize(gradient, dim=1, eps=1e-6)
    leg = points - center
    length = torch.linalg.vector_norm(leg, dim=1)
    corrected = (transmittance + shift).clamp(min=0.0)
    amplitude = alpha * corrected ** form["two_way_power"]
    if form["lobe_power"] != 1.0:
        cosine = (normals * leg).sum(dim=1) / length
        lobe = (2.0 * cosine.square() - 1.0).clamp(min=0.0)
        # pow has no derivative to a base of zero where the exponent is below one
        lit = lobe > 0.0
        amplitude = amplitude * torch.where(
            lit, torch.where(lit, lobe, 1.0).pow(form["lobe_power"] - 1.0), 0.0
        )
    if form.get("reference") is not None:
        amplitude = amplitude * (form["reference"] / length).square()
    return amplitude, normals
