"""Evidence of `best`: outlines that glints do not contradict."""

from dataclasses import replace

import numpy as np

from geraf2.surfaces.refinement import RefineConfig, uncontradicted
from helpers.glint_sets import glints_on_sphere
from helpers.shadows import outlines


def ball_glints(n=400, seed=0, radius_m=0.04):
    return glints_on_sphere(radius_m, n, seed=seed)


def test_outlines_that_glints_contradict_are_dropped():
    seen, config = ball_glints(), RefineConfig()
    right, wrong, elsewhere = (
        outlines([0], [r, r, r], known)
        for r, known in ((0.04, None), (0.03, None), (0.04, np.zeros((81, 81), dtype=bool)))
    )
    kept = [len(uncontradicted(one, seen, config)) for one in (right, wrong, elsewhere)]
    assert kept == [1, 0, 0]
    # 2 % of the glints may contradict it.
    assert len(uncontradicted(right, seen.join(ball_glints(8, radius_m=0.07)), config)) == 1
    # Of glints that are false with certainty no outline is to be doubted.
    false = replace(ball_glints(40, radius_m=0.06), probability=np.full(40, 1e-6))
    assert len(uncontradicted(right, seen.join(false), config)) == 1
