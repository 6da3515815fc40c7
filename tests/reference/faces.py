"""Density of an echo by the faces of a dielectric body, for one number at a time; slow."""

import math


def normal(error, sigma):
    return math.exp(-0.5 * (error / sigma) ** 2) / (math.sqrt(2.0 * math.pi) * sigma)


def densities(depth, paths, agreements, model):
    """Densities by front, back and both faces of each body on a line of sight, [1 / m^3] each.

    depth: of the echo behind the first point of the line [m].
    paths: where the line enters and leaves each body, in order [m].
    agreements: of the normals there.
    model: index, cell_m, area_m2, shares of front, back and both, and the width of the round.
    """
    n, cell, area, wide = (model[name] for name in ("index", "cell_m", "area_m2", "width"))
    front_share, back_share, both_share = model["shares"]
    found, crossed, left = [], 0.0, 1.0
    for (enter, leave), (k_front, k_back) in zip(paths, agreements, strict=True):
        thickness = leave - enter
        optical = n * thickness
        r = depth - enter - (n - 1.0) * crossed
        own = wide * 0.002 + 0.08 * crossed
        h = min(1.0, max(0.0, (0.8 - optical / cell) / 0.3))
        found.append(
            [
                left * front_share * (k_front - h * k_front * k_back) * normal(r, own) / area,
                left
                * back_share
                * (k_back - 0.5 * h * k_front * k_back)
                * normal(r - optical, own + 0.05 * optical)
                / area,
                left
                * both_share
                * h
                * k_front
                * k_back
                * normal(r - 0.67 * optical, own + 0.12 * optical)
                / area,
            ]
        )
        crossed += thickness
        left *= 0.5
    return found
