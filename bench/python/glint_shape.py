"""Depth and width of rendered glints against measured ones, with the true surface in the field.

    python bench/python/glint_shape.py SCENE --los LOS.ply --truth TRUTH.ply \
        [--lobe-powers 8 32] [--inv-s 200 800] [--planes 12] [--draws 6]

Nothing is trained. For a window of antennas of each plane this takes the nearest place of the true
surface, and looks at the powers of both heat maps (`paper-corrected`) along the line of sight
through it, and across. Depth: how far the rendered peak lies behind the measured one, as
`--paper.glint-level` finds it, median over planes [mm]; the surface has to move by as much towards
the radar. Width: root mean square over
4 cm to either side, median over planes and both directions [mm]. Planes whose glint has less than
a sixth of the power of the brightest are left out.
"""

import argparse
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch

from geraf2._types import Floats
from geraf2.learned.glint_level import DEPTHS_M, depth_difference, line_of_sight
from geraf2.learned.trainer import PaperTrainer, PlaneDraw
from geraf2.ops.visibility import MeshScene
from paper_levels import Change, Levels, level_forms
from paper_preset import add_scene_arguments, make_bench

ACROSS_M = np.arange(-0.04, 0.0401, 0.004)
LEAST_POWER = 1.0 / 6.0


class GlintPowers(NamedTuple):
    """Powers of a heat map about a glint."""

    depth: Floats
    """At DEPTHS_M."""
    across: Floats
    """At ACROSS_M in both directions, (2, n)."""


def glint_targets(trainer: PaperTrainer, draw: PlaneDraw, vertices: Floats) -> Floats:
    """Places along and across the line from a window to the nearest vertex, (n, 3) [m]."""
    pose = trainer.capture.poses[draw.plane]
    window = pose.phase_centers[draw.antennas].mean(axis=0)
    glint = vertices[np.linalg.norm(vertices - window, axis=1).argmin()]
    line = line_of_sight(glint, window)
    sight = (line[-1] - line[0]) / np.linalg.norm(line[-1] - line[0])
    first = np.asarray(pose.axes)[1]
    first = first - sight * (first @ sight)
    first /= np.linalg.norm(first)
    across = [glint + ACROSS_M[:, None] * way for way in (first, np.cross(sight, first))]
    return np.concatenate([line, *across])


def split(powers: Floats) -> GlintPowers:
    n = len(DEPTHS_M)
    return GlintPowers(powers[:n], powers[n:].reshape(2, -1))


@torch.no_grad()
def glints(
    trainer: PaperTrainer, vertices: Floats, planes: list[int], n_draws: int
) -> list[tuple[GlintPowers, GlintPowers]]:
    """Measured and rendered powers, the mean over draws of rays, of a window of each plane."""
    trainer.generator.manual_seed(7)
    found = []
    for plane in planes:
        antennas, rendered = None, []
        for _ in range(n_draws):
            draw = trainer._draw(plane)
            antennas = draw.antennas if antennas is None else antennas
            draw = draw._replace(antennas=antennas)
            places = glint_targets(trainer, draw, vertices)
            own, measured = trainer._powers(draw, trainer._rendered(draw).signal, places)
            rendered.append(own)
        found.append((split(measured), split(np.mean(rendered, axis=0))))
    return found


def widths(across: Floats) -> Floats:
    """Root mean square width in both directions, (2,) [m]."""
    share = across / across.sum(axis=1, keepdims=True)
    mean = share @ ACROSS_M
    return np.asarray(np.sqrt(share @ ACROSS_M**2 - mean**2))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add_scene_arguments(parser, (1, 0))
    parser.add_argument("--lobe-powers", type=float, nargs="+", default=[8.0, 32.0])
    parser.add_argument("--inv-s", type=float, nargs="+", default=[200.0, 800.0])
    parser.add_argument("--planes", type=int, default=12)
    parser.add_argument("--draws", type=int, default=6, help="of rays and samples")
    options = parser.parse_args()
    bench = make_bench(options, 0)
    config = level_forms(bench.base)["paper-corrected"]
    trainer = bench.trainer(config)
    levels = Levels(trainer, MeshScene(bench.truth.vertices, bench.truth.faces), 1)
    planes = trainer.planes[: options.planes]
    print(f"{'lobe':>5} {'s':>6} {'behind mm':>10} {'width mm':>9} {'measured':>9} {'planes':>7}")
    for power in options.lobe_powers:
        for inv_s in options.inv_s:
            change = Change(inv_s=inv_s)
            levels.prepare(replace(config, lobe_power=power), change)
            levels.put(change, 0.0)
            found = glints(trainer, bench.truth.vertices, planes, options.draws)
            least = LEAST_POWER * max(m.depth.max() for m, _ in found)
            bright = [(m, r) for m, r in found if m.depth.max() >= least]
            depths = [depth_difference(r.depth, m.depth) for m, r in bright]
            behind = np.median([depth for depth in depths if depth is not None])
            measured, rendered = (
                np.median([widths(pair[k].across) for pair in bright]) for k in (0, 1)
            )
            print(
                f"{power:5g} {inv_s:6g} {1e3 * behind:+10.2f} {1e3 * rendered:9.1f} "
                f"{1e3 * measured:9.1f} {len(bright):7}",
                flush=True,
            )


if __name__ == "__main__":
    main()
