"""Evidence of `best`: glints, those of the rim, outlines that glints do not contradict."""

from dataclasses import replace

import numpy as np

from geraf2.echoes.glints import GlintConfig, find_glints
from geraf2.imaging.subapertures import SubapertureConfig
from geraf2.scene import LosPrior
from geraf2.surfaces.refinement import (
    RefineConfig,
    select_glints,
    uncontradicted,
)
from helpers.glint_sets import glints_on_sphere
from helpers.shadows import outlines
from helpers.specular import BOX_M, sphere_capture

BOX = LosPrior.from_box((BOX_M, BOX_M, BOX_M))
NARROW = GlintConfig(subaperture=SubapertureConfig(max_cosine=0.2))


def test_glints_are_kept_and_continued_at_the_rim():
    capture = sphere_capture([[0.0, 0.0, 0.0]], [0.04], n_poses=3)
    glints = find_glints(capture, BOX, NARROW)
    found = select_glints(capture, BOX, glints, first=NARROW)
    np.testing.assert_array_equal(found.seen.positions[: len(glints)], glints.positions)
    assert len(found.rim) > 3 * 20
    assert np.abs(np.linalg.norm(found.rim.positions, axis=1) - 0.04).max() < 1e-3


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
