"""The hybrid's order: links, then the rim, then a fit that knows how many planes there are."""

import numpy as np
import pytest

from geraf2.imaging.glints import GlintConfig, find_glints
from geraf2.imaging.hybrid import HybridConfig, look_again
from geraf2.imaging.links import linked_to_strong
from geraf2.imaging.subapertures import SubapertureConfig
from geraf2.scene import LosPrior
from specular import BOX_M, sphere_capture

BOX = LosPrior.from_box((BOX_M, BOX_M, BOX_M))
NARROW = GlintConfig(subaperture=SubapertureConfig(max_cosine=0.2))


def test_glints_are_kept_then_continued_from_what_was_kept():
    capture = sphere_capture([[0.0, 0.0, 0.0]], [0.04], n_poses=3)
    glints = find_glints(capture, BOX, NARROW)
    # A weak copy beside the sphere: nothing links it to the sphere, and its rim is not there.
    ghost = glints.select(np.arange(5))
    ghost = type(ghost)(
        **{
            **vars(ghost),
            "positions": ghost.positions + np.array([0.0, 0.0, 0.05]),
            "strengths": 0.01 * ghost.strengths,
        }
    )
    found = look_again(capture, BOX, glints.join(ghost), look=NARROW)
    assert len(found.kept) == len(glints)
    np.testing.assert_array_equal(found.kept.positions, glints.positions)
    assert len(found.rim) > 3 * 20
    assert np.abs(np.linalg.norm(found.rim.positions, axis=1) - 0.04).max() < 1e-3
    assert linked_to_strong(found.kept.join(found.rim), 3).all()


def test_with_few_planes_the_second_look_counts_as_the_first():
    config = HybridConfig()
    assert config.fit_of(36) is config.fit
    assert config.fit_of(12).more_weight == 0.2
    assert config.fit_of(11).more_weight == 1.0


def test_a_weight_that_is_not_positive_is_refused():
    with pytest.raises(ValueError, match="few_planes_weight"):
        HybridConfig(few_planes_weight=0.0)
