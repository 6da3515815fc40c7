"""Procedural objects with thin parts and holes; no constant of a reconstruction is chosen on them.

A slatted chair, spectacles, a key, a mug with a handle, a pair of scissors. Units of about a
centimetre, +x is forward.
"""

import numpy as np

from geraf2._types import Floats
from geraf2.simulation.implicit import Figure, Solid, blend, block, limb, ring, tube, turned


def slatted_chair() -> Figure:
    """Chair on four legs, its back two posts and two rails."""
    parts: list[Solid] = [block((0.0, 0.0, 4.6), (2.3, 2.2, 0.26), 0.15)]
    for y in (-1.85, 1.85):
        parts += [
            limb((1.95, y, 4.5), (2.1, 1.05 * y, 0.3), 0.3, 0.26),
            limb((-2.0, y, 4.5), (-2.35, 1.05 * y, 0.3), 0.3, 0.26),
            limb((-2.0, y, 4.5), (-2.8, y, 10.2), 0.3, 0.28),
        ]
    for z, half in ((7.2, 0.45), (9.6, 0.55)):
        x = -2.0 - 0.8 * (z - 4.5) / 5.7
        parts.append(block((x, 0.0, z), (0.2, 1.9, half), 0.12))
    return Figure(blend(parts, 0.15), (-3.5, -2.8, -0.4), (2.9, 2.8, 11.0))


def spectacles() -> Figure:
    """Spectacles without lenses on their rims, the temples folded one behind the other."""
    parts: list[Solid] = [limb((0.0, -0.85, 2.9), (0.0, 0.85, 2.9), 0.24, 0.24)]
    for side, behind in ((-1.0, -1.0), (1.0, -1.9)):
        hinge, bend = (behind, 6.0 * side, 3.1), (behind, -3.2 * side, 3.1)
        parts += [
            ring((0.0, 3.3 * side, 2.3), (2.5, 2.05), 0.24),
            limb((0.0, 5.75 * side, 2.9), hinge, 0.22, 0.2),
            limb(hinge, bend, 0.2, 0.2),
            limb(bend, (behind, -5.6 * side, 1.7), 0.2, 0.2),
        ]
    return Figure(blend(parts, 0.1), (-2.5, -7.0, -0.4), (0.7, 7.0, 5.0))


def _beyond(z: float, points: Floats) -> Floats:
    return np.asarray(points[..., 2] - z)


def key() -> Figure:
    """Door key on its bit, the bow with its hole on top."""
    parts = [
        ring((0.0, 0.0, 9.6), (1.25, 1.25), 0.36),
        limb((0.0, 0.0, 8.3), (0.0, 0.0, 0.4), 0.36, 0.36),
        limb((0.0, 0.0, 7.6), (0.0, 0.0, 7.6001), 0.6, 0.6),
        block((0.0, 0.95, 1.75), (0.16, 0.9, 0.4), 0.08),
        block((0.0, 0.75, 0.75), (0.16, 0.7, 0.35), 0.08),
    ]
    return Figure(blend(parts, 0.15), (-1.0, -2.1, -0.4), (1.0, 2.4, 11.7))


def mug() -> Figure:
    """Empty mug with a thin wall and a handle."""
    outside = turned(np.array([[0.9, 3.0], [1.0, 3.1], [7.2, 3.1], [7.3, 3.1]]))
    inside = turned(np.array([[3.1, 2.8], [12.0, 2.8]]))
    arc = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 25)
    handle = tube(
        np.stack([3.0 + 2.1 * np.cos(arc), 0.0 * arc, 4.4 + 2.2 * np.sin(arc)], axis=1), 0.38
    )
    body = blend([outside, handle], 0.25)

    def hollow(points: Floats) -> Floats:
        open_top = np.maximum(body(points), _beyond(8.4, points))
        flat = np.maximum(open_top, -_beyond(0.0, points))
        return np.asarray(np.maximum(flat, -inside(points)))

    return Figure(hollow, (-3.8, -3.8, -0.6), (6.0, 3.8, 9.0))


def scissors() -> Figure:
    """Half-open scissors on their tips, two loops on top."""
    parts: list[Solid] = []
    for side in (-1.0, 1.0):
        # Blade from the tip across the pivot (0, 6) to its loop.
        parts += [
            limb((0.12 * side, -1.5 * side, 0.3), (0.12 * side, 0.0, 6.0), 0.2, 0.42),
            limb((0.12 * side, 0.0, 6.0), (0.12 * side, 1.55 * side, 9.4), 0.42, 0.3),
            ring((0.12 * side, 2.3 * side, 10.4), (1.15, 1.5), 0.27),
        ]
    return Figure(blend(parts, 0.15), (-0.9, -4.2, -0.4), (0.9, 4.2, 12.6))
