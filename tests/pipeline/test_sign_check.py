from dataclasses import replace

import pytest

import geraf2
from geraf2.errors import UserError
from geraf2.pipeline.sign_check import explain_sign_errors


def conjugated(capture):
    poses = tuple(replace(pose, signal=pose.signal.conj()) for pose in capture.poses)
    return replace(capture, poses=poses)


@pytest.mark.parametrize("prior", [None, geraf2.examples.BOX_M])
def test_a_run_of_a_capture_with_the_wrong_sign_names_the_sign(prior, tmp_path):
    wrong = conjugated(geraf2.examples.small_capture()[0])
    with pytest.raises(UserError, match=r"the phase has the wrong sign.*phase_sign"):
        geraf2.reconstruct(wrong, prior, "fast", tmp_path / "out")


def test_other_errors_do_not_change():
    capture, _ = geraf2.examples.small_capture()
    with pytest.raises(UserError, match=r"^no box$"), explain_sign_errors(capture, "capture"):
        raise UserError(what="no box")
