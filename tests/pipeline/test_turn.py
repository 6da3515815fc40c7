"""A turntable in the wrong sense, through a whole run."""

import numpy as np
import pytest

import geraf2
from geraf2.calibration.corrections import with_turn_reversed
from geraf2.io.verdict import Trust
from geraf2.pipeline.stages.calibration import correct_capture
from geraf2.surfaces import FitConfig
from helpers.specular import BOX_M, capture_of, raster, sphere_paths

CENTERS, RADII = np.array([[0.03, 0.01, 0.0], [-0.025, 0.02, 0.01]]), [0.022, 0.018]
BOX = (BOX_M,) * 3
COARSE = geraf2.FastPreset(fit=FitConfig(spacing_m=0.006))


@pytest.fixture(scope="module")
def capture():
    def paths_of(tx, _):
        return sphere_paths(tx, CENTERS, RADII)

    return capture_of(paths_of, n_poses=14, positions=raster(31, 0.004))


def radius_errors_m(mesh):
    """Distance of each vertex to the nearer sphere's surface [m]."""
    away = np.linalg.norm(mesh.vertices[:, None] - CENTERS, axis=2) - RADII
    return np.abs(away).min(axis=1)


def test_a_wrong_sense_is_corrected_and_said(capture, tmp_path):
    right = geraf2.reconstruct(capture, BOX, COARSE, tmp_path / "right")
    wrong = geraf2.reconstruct(with_turn_reversed(capture), BOX, COARSE, tmp_path / "wrong")
    assert np.median(radius_errors_m(wrong.content_mesh)) < 0.003
    assert right.verdict.trust == Trust.RELIABLE
    assert wrong.verdict.trust != Trust.RELIABLE
    assert wrong.verdict.causes[0].name == "sense"
    # Who reads the scene again gets the corrected planes.
    pose = correct_capture(wrong.run, with_turn_reversed(capture)).poses[5]
    np.testing.assert_allclose(pose.axes, capture.poses[5].axes, atol=0.02)


def test_a_stated_sense_is_taken_and_not_doubted(capture, tmp_path):
    options = geraf2.RunOptions(reverse_turn=True)
    turned = with_turn_reversed(capture)
    result = geraf2.reconstruct(turned, BOX, COARSE, tmp_path / "out", options=options)
    assert result.verdict.trust == Trust.RELIABLE


def test_without_calibration_the_sense_stays_and_is_a_cause(capture, tmp_path):
    options = geraf2.RunOptions(calibrate="no")
    turned = with_turn_reversed(capture)
    result = geraf2.reconstruct(turned, BOX, COARSE, tmp_path / "out", options=options)
    assert result.verdict.trust == Trust.NOT_TO_BE_TRUSTED
    assert "sense" in {cause.name for cause in result.verdict.causes}
