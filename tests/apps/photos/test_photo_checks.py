"""Only what is implausible about photos is reported, in one line."""

import re
from dataclasses import replace

import numpy as np
import pytest

from geraf2.apps.photos.photo_checks import check_photos, require_photos_in_view
from geraf2.errors import UserError
from geraf2.scene.photos import PhotoSet
from helpers.scene_photos import SIZE, ring_of_cameras


def photo_set(n_photos=16, *, brightness=100, **options):
    cameras = tuple(ring_of_cameras(n_photos, **options))
    image = np.full((SIZE[1], SIZE[0], 3), brightness, np.uint8)
    return PhotoSet(
        names=tuple(f"photo{index}.png" for index in range(n_photos)),
        cameras=cameras,
        images=(image,) * n_photos,
    )


def posed(change, only=range(16)):
    """Good photos of which some have changed poses, (4, 4) -> (4, 4)."""
    photos = photo_set()
    cameras = tuple(
        replace(c, camera_to_world=change(c.camera_to_world)) if index in only else c
        for index, c in enumerate(photos.cameras)
    )
    return replace(photos, cameras=cameras)


def only_message(photos):
    findings = check_photos(photos)
    assert len(findings) == 1
    return findings[0].severity, findings[0].message


def test_good_photos_have_no_finding():
    assert check_photos(photo_set()) == ()
    assert check_photos(photo_set(height=-0.3)) == ()
    assert check_photos(photo_set(height=0.9)) == ()


TURN = np.array([[0.0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
MIRROR = np.array([1.0, -1.0, 1.0, 1.0])[:, None] ** [0, 0, 0, 1]  # of the positions alone
ONE_POSITION = posed(lambda pose: pose).cameras[0].camera_to_world


@pytest.mark.parametrize(
    ("photos", "severity", "words"),
    [
        (posed(lambda p: p @ FLIP), "error", "16 of 16 cameras face away.*--camera-axes"),
        (posed(lambda p: p * MIRROR), "error", ""),
        (posed(lambda p: p * [1.0, 1.0, 1.0, 1e3]), "error", "--unit"),
        (posed(lambda p: p * [1.0, 1.0, 1.0, 1e-2]), "error", "--unit"),
        (posed(lambda _: ONE_POSITION), "error", "one position"),
        (posed(lambda p: p @ TURN, only=[3]), "warning", r"photo3\.png"),
        (photo_set(arc=np.radians(120.0)), "warning", "one side: 2"),
        (photo_set(8), "warning", "only 8 photos"),
        (photo_set(2), "error", "at least 3"),
    ],
)
def test_what_is_implausible_is_one_line(photos, severity, words):
    found, message = only_message(photos)
    assert found == severity
    assert re.search(words, message)


def test_one_side_is_seen_where_cameras_stand_above_each_other():
    low, high = photo_set(8, arc=1.5), photo_set(8, arc=1.5, height=0.6)
    both = replace(
        low,
        names=low.names + tuple("b" + name for name in high.names),
        cameras=low.cameras + high.cameras,
        images=low.images + high.images,
    )
    assert "one side" in only_message(both)[1]


def test_over_exposed_photos():
    photos = photo_set()
    burnt = np.full_like(photos.images[0], 255)
    images = (burnt, burnt, *photos.images[2:])
    severity, message = only_message(replace(photos, images=images))
    assert severity == "warning"
    assert "2 of 16 photos are over-exposed" in message
    # What is burnt out behind the object does no harm.
    dark = np.zeros(burnt.shape[:2], bool)
    dark[:5] = True
    part = burnt.copy()
    part[:5] = 90
    masked = replace(photos, images=(part, *photos.images[1:]), masks=(dark,) * 16)
    assert check_photos(masked) == ()


def test_photos_and_radar_look_at_the_same():
    photos = photo_set()
    require_photos_in_view(photos, np.zeros(3), 0.4, "photos")
    with pytest.raises(UserError, match="and the radar view different scenes"):
        require_photos_in_view(photos, np.array([0.0, 0.0, 0.6]), 0.4, "photos")
    with pytest.raises(UserError, match="unit"):
        require_photos_in_view(photos, np.zeros(3), 0.01, "photos")
