from dataclasses import replace

import numpy as np
import pytest

from geraf2.echoes.glint_set import Glints


@pytest.fixture
def glints():
    rng = np.random.default_rng(0)
    return Glints(
        positions=rng.random((7, 3)),
        normals=rng.random((7, 3)),
        strengths=rng.random(7),
        position_sigma_m=rng.random(7),
        normal_sigma_rad=rng.random(7),
        poses=np.arange(7),
        probability=rng.random(7),
    )


def test_saving_and_loading_keeps_everything(glints, tmp_path):
    glints.save(tmp_path / "glints.npz")
    back = Glints.load(tmp_path / "glints.npz")
    assert len(back) == 7
    for name in Glints.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(back, name), getattr(glints, name))


def test_fields_of_different_length_are_refused(glints):
    with pytest.raises(ValueError, match="strengths must have shape"):
        replace(glints, strengths=glints.strengths[:3])
