"""Simulated photos of the bare object: silhouette, light, paint, errors."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.scene import Wall
from geraf2.simulation import PhotosSpec, parse_spec, simulate_photos
from geraf2.simulation.object_scene import ObjectScene
from geraf2.simulation.photo_scene import photograph
from geraf2.simulation.photos import ring_cameras
from helpers import solids

RADIUS, CENTER = 0.05, np.array([0.02, 0.0, 0.03])
BOUNDS = Wall(
    size_m=(0.1, 0.1, 0.1), thickness_m=0.02, permittivity=1.0, center_m=(0.02, 0.0, 0.03)
)
BALL = solids.ball(RADIUS, 4, CENTER)
SPEC = PhotosSpec(
    subject="content",
    n_photos=3,
    size_px=(96, 72),
    focal_length_px=96.0,
    pose_error_rms_m=0.0,
    pose_error_rms_deg=0.0,
)


@pytest.fixture(scope="module")
def scene():
    return ObjectScene(BALL, seed=1)


def test_the_silhouette_is_that_of_the_object(scene):
    for camera in ring_cameras(SPEC, BOUNDS, seed=3):
        picture = photograph(scene.trace, camera)
        distance = np.linalg.norm(camera.position - CENTER)
        # A sphere fills a cone; off the axis its outline is an ellipse somewhat larger.
        radius_px = 96.0 * np.tan(np.arcsin(RADIUS / distance))
        assert picture.coverage.sum() == pytest.approx(np.pi * radius_px**2, rel=0.04)
        assert (picture.radiance >= 0.0).all()


def test_photos_need_what_they_show():
    photos = simulate_photos(replace(SPEC, n_photos=1), (), seed=0, content=BALL, num_threads=1)
    again = simulate_photos(replace(SPEC, n_photos=1), (), seed=0, content=BALL, num_threads=2)
    assert np.array_equal(photos.images[0], again.images[0])
    assert photos.masks is not None
    assert 0.1 < photos.masks[0].mean() < 0.9
    with pytest.raises(ValueError, match="need `content`"):
        simulate_photos(SPEC, (), seed=0)
    # Without a box only the bare object can be photographed.
    values = {"figure": {"name": "llama"}, "photos": {"subject": "content"}}
    assert parse_spec(values, where="spec").photos.subject == "content"
