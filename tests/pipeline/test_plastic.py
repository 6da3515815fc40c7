"""Content of plastic, from a scan to its surface."""

import numpy as np
import pytest

import geraf2
from geraf2.echoes.glints import GlintConfig
from geraf2.imaging.subapertures import SubapertureConfig
from geraf2.pipeline.surface_samples import evidence_of_run
from geraf2.scene import LosPrior
from geraf2.surfaces import FitConfig
from helpers.specular import BOX_M, capture_of, sphere_paths

RADIUS_M, INDEX = 0.03, 1.64
NARROW = GlintConfig(subaperture=SubapertureConfig(max_cosine=0.2))


def ball(tmp_path, name, *, depths, completion):
    """Run on a ball with echoes at depths behind its front, over its radius."""

    def paths(positions, _):
        front = sphere_paths(positions, [[0.0, 0.0, 0.0]], [RADIUS_M])
        return np.hstack([front + 2.0 * depth * RADIUS_M for depth in depths])

    preset = geraf2.FastPreset(glints=NARROW, fit=FitConfig(spacing_m=0.006, completion=completion))
    options = geraf2.RunOptions(calibrate="no")
    prior = LosPrior.from_box((BOX_M,) * 3)
    return geraf2.reconstruct(capture_of(paths), prior, preset, tmp_path / name, options=options)


@pytest.mark.parametrize(("depths", "used"), [((0.0,), "objects"), ((0.0, 2.0 * INDEX), "smooth")])
def test_plastic_is_closed_by_the_fit_and_metal_by_the_completion(tmp_path, depths, used):
    asked = ball(tmp_path, "asked", depths=depths, completion="objects")
    assert ("n_back_faces" in asked.numbers["glints"]) == (used == "smooth")
    assert evidence_of_run(asked.run, asked.record.config)[1].completion == used
    smooth = ball(tmp_path, "smooth", depths=depths, completion="smooth")
    same = np.array_equal(asked.content.vertices, smooth.content.vertices)
    assert same == (used == "smooth")
