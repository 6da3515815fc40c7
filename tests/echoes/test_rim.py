"""Second look: what the rim of each plane sees, where it continues a known glint."""

import numpy as np
import pytest

from geraf2.echoes.glint_set import Glints
from geraf2.echoes.glints import GlintConfig, find_glints
from geraf2.echoes.rim import RimConfig, continued, find_rim_glints, mirror_centers
from geraf2.imaging.subapertures import SubapertureConfig
from geraf2.scene import LosPrior
from specular import BOX_M, STANDOFF_M, raster, sphere_capture

BOX = LosPrior.from_box((BOX_M, BOX_M, BOX_M))
RADIUS_M = 0.04
NARROW = GlintConfig(subaperture=SubapertureConfig(max_cosine=0.2))


@pytest.fixture(scope="module")
def capture():
    return sphere_capture([[0.0, 0.0, 0.0]], [RADIUS_M])


@pytest.fixture(scope="module")
def glints(capture):
    return find_glints(capture, BOX, NARROW)


@pytest.fixture(scope="module")
def rim(capture, glints):
    return find_rim_glints(capture, BOX, glints, look=NARROW)


def test_the_rim_of_a_sphere_lies_on_it_and_faces_outward(rim):
    assert len(rim) > 12 * 20
    distance = np.linalg.norm(rim.positions, axis=1)
    assert np.abs(distance - RADIUS_M).max() < 1e-3
    outward = rim.positions / distance[:, None]
    angle = np.degrees(np.arccos(np.einsum("ij,ij->i", outward, rim.normals)))
    assert angle.max() < 4.0
    assert np.median(angle) < 1.0


def test_the_rim_is_seen_under_steeper_angles_than_whole_subapertures_reach(glints, rim):
    # Middles of whole sub-apertures reach 21 mm up on a plane 0.4 m away, those of 4 cm 41 mm.
    whole, cut = (float(g.normals[:, 2].max()) for g in (glints, rim))
    assert whole == pytest.approx(0.021 / STANDOFF_M, abs=0.006)
    assert cut == pytest.approx(0.041 / STANDOFF_M, abs=0.006)


def test_the_centre_follows_from_the_glint_alone(capture, glints):
    centers = mirror_centers(glints, capture.poses)
    sideways = np.linalg.norm(centers[:, :2], axis=1)
    assert np.abs(centers[:, 2]).max() < 0.022 + 1e-3
    assert sideways.min() > STANDOFF_M - 1e-9
    assert np.abs(np.cross(centers - glints.positions, glints.normals)).max() < 1e-9


def test_irregular_positions_have_a_rim_too(glints):
    places = raster(41)
    places = places + np.random.default_rng(0).uniform(-1e-3, 1e-3, places.shape)
    uneven = sphere_capture([[0.0, 0.0, 0.0]], [RADIUS_M], n_poses=3, places=places)
    known = find_glints(uneven, BOX, NARROW)
    rim = find_rim_glints(uneven, BOX, known, look=NARROW)
    assert len(rim) > 3 * 20
    assert np.abs(np.linalg.norm(rim.positions, axis=1) - RADIUS_M).max() < 1e-3


def test_what_continues_nothing_is_not_believed(capture, glints):
    elsewhere = Glints(
        **{**vars(glints), "positions": glints.positions + np.array([0.0, 0.0, 0.03])}
    )
    assert len(find_rim_glints(capture, BOX, elsewhere, look=NARROW)) == 0


def test_without_sizes_or_glints_there_is_no_second_look(capture, glints):
    assert len(find_rim_glints(capture, BOX, glints, RimConfig(sizes_m=()), NARROW)) == 0
    nothing = glints.select(np.zeros(len(glints), dtype=bool))
    assert len(find_rim_glints(capture, BOX, nothing, look=NARROW)) == 0


def on_a_sphere(angles, **changes):
    """Glints of one plane on a sphere of 4 cm, by their angle from the looking direction."""
    n = len(angles)
    normals = np.stack([np.cos(angles), np.zeros(n), np.sin(angles)], axis=1)
    values = {
        "positions": RADIUS_M * normals,
        "normals": normals,
        "strengths": np.ones(n),
        "position_sigma_m": np.full(n, 4e-4),
        "normal_sigma_rad": np.full(n, 0.03),
        "poses": np.zeros(n, dtype=np.int64),
    }
    return Glints(**{**values, **changes})


ANGLES = np.array([0.0, 0.05, 0.10, 0.15])
CENTERS = 0.4 * np.stack([np.cos(ANGLES), np.zeros(4), np.sin(ANGLES)], axis=1)
FIRST = np.array([True, False, False, False])


def test_known_glints_are_continued_step_by_step():
    track = on_a_sphere(ANGLES)
    for rounds in (0, 1, 2, 3):
        accepted = continued(track, CENTERS, FIRST, RimConfig(rounds=rounds))
        np.testing.assert_array_equal(accepted, np.arange(4) <= rounds)


@pytest.mark.parametrize(
    "changes",
    [
        {"poses": np.array([0, 1, 0, 0])},
        {
            "positions": on_a_sphere(ANGLES).positions
            + np.array([0, 2, 0, 0])[:, None] * [1e-3, 0, 0]
        },
    ],
    ids=["another plane", "2 mm off the chord"],
)
def test_a_step_that_does_not_fit_is_refused(changes):
    accepted = continued(on_a_sphere(ANGLES, **changes), CENTERS, FIRST, RimConfig(rounds=1))
    np.testing.assert_array_equal(accepted, FIRST)


def test_a_step_over_the_plane_that_is_too_long_is_refused():
    far = CENTERS * np.array([1.0, 1.0, 3.0])
    accepted = continued(on_a_sphere(ANGLES), far, FIRST, RimConfig(rounds=1))
    np.testing.assert_array_equal(accepted, FIRST)


def test_a_distance_that_is_not_positive_is_refused():
    with pytest.raises(ValueError, match="aperture_step_m"):
        RimConfig(aperture_step_m=0.0)


def test_rim_sizes_must_be_smaller_than_the_whole():
    with pytest.raises(ValueError, match="rim_sizes_m"):
        SubapertureConfig(rim_sizes_m=(0.09,))
