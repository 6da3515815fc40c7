"""Photo of a signed distance, sample by sample from the equations of NeuS (2021)."""

import math


def logistic(x, inv_s):
    return 1.0 / (1.0 + math.exp(-inv_s * x))


def render_ray(sdf, gradients, colours, direction, edges, inv_s):
    """Colour, opacity and depth of one ray; one list entry a sample, edges one more."""
    through, opacity, depth, colour = 1.0, 0.0, 0.0, [0.0, 0.0, 0.0]
    for i in range(len(sdf)):
        step, middle = edges[i + 1] - edges[i], 0.5 * (edges[i + 1] + edges[i])
        slope = min(0.0, sum(g * d for g, d in zip(gradients[i], direction, strict=True)))
        before = logistic(sdf[i] - 0.5 * slope * step, inv_s)
        after = logistic(sdf[i] + 0.5 * slope * step, inv_s)
        alpha = max(0.0, (before - after) / before)
        weight = through * alpha
        through *= 1.0 - alpha
        opacity += weight
        depth += weight * middle
        colour = [c + weight * s for c, s in zip(colour, colours[i], strict=True)]
    return colour, opacity, depth
