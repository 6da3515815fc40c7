from dataclasses import replace

import pytest

from geraf2.errors import UserError
from geraf2.pipeline.planes import quarter_planes
from helpers.synthetic import point_capture


def with_angles(*angles):
    capture = point_capture(len(angles), n_side=3)
    poses = zip(capture.poses, angles, strict=True)
    return replace(capture, poses=tuple(replace(pose, angle_deg=a) for pose, a in poses))


@pytest.mark.parametrize(
    ("angles", "planes"),
    [((0, 60, 120, 180, 240, 300), [0, 1, 3, 4]), ((10, None, 350), [0, 2]), ((45,), [0])],
)
def test_quarter_planes_are_the_nearest(angles, planes):
    assert quarter_planes(with_angles(*angles), "scene") == planes


def test_without_an_angle_there_are_none():
    with pytest.raises(UserError, match="no plane has a turntable angle"):
        quarter_planes(with_angles(None, None), "scene")
