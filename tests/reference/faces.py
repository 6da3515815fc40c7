"""Echoes of the faces of a dielectric body, for one number at a time; slow."""

import math


def normal(error, sigma):
    return math.exp(-0.5 * (error / sigma) ** 2) / (math.sqrt(2.0 * math.pi) * sigma)


def densities(depth, paths, agreements, model):
    """Densities by front, back and both faces of each body on a line of sight, [1 / m^3] each.

    depth: of the echo behind the first point of the line [m].
    paths: where the line enters and leaves each body, in order [m].
    agreements: of the normals there.
    model: index, cell_m and area_m2.
    """
    n, cell, area = (model[name] for name in ("index", "cell_m", "area_m2"))
    found, crossed = [], 0.0
    for (enter, leave), (k_front, k_back) in zip(paths, agreements, strict=True):
        thickness = leave - enter
        optical = n * thickness
        r = depth - enter - (n - 1.0) * crossed
        own = 0.002 + 0.08 * crossed
        h = min(1.0, max(0.0, (0.8 - optical / cell) / 0.3))
        both = h * k_front * k_back
        front = (k_front - both) * normal(r, own)
        back = (k_back - 0.5 * both) * normal(r - optical, own + 0.05 * optical)
        merged = both * normal(r - 0.67 * optical, own + 0.12 * optical)
        found.append([density / area for density in (front, back, merged)])
        crossed += thickness
    return found


def chord(beside, radius, index):
    """Path in a ball of a wave that enters it so far beside its middle, by Snell's law."""
    return 2.0 * radius * math.cos(math.asin(beside / (radius * index)))
