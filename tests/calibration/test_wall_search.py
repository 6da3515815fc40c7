"""Boxes that are no cuboids: from exact flashes, and from a simulated scan."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2 import examples, simulate
from geraf2.calibration.box_finder import find_box
from geraf2.calibration.box_search import Flashes, rough_faces
from geraf2.calibration.found_box import FoundBody, FoundBox, Seen
from geraf2.calibration.wall_search import find_walls
from geraf2.geometry.triangles import enclosed_volume_m3, unit_normals
from geraf2.pipeline import box_check
from geraf2.pipeline.events import Listener
from geraf2.report.view_layers import box_faces
from geraf2.scene import LosPrior

UP, OFFSET_M, SKEW_DEG = np.array([0.0, 0.0, 1.0]), 0.08, 8.0
WAVEFORM = examples.small_capture()[0].waveform
CUBOID = (0.0, 90.0, 180.0, 270.0)
SKEWED = (0.0, 98.0, 180.0, 278.0)


def normals_of(azimuth_deg, lean_deg):
    azimuth, lean = np.deg2rad(azimuth_deg), np.deg2rad(lean_deg)
    level = np.cos(azimuth) * np.cos(lean), np.sin(azimuth) * np.cos(lean), np.sin(lean)
    return np.stack(np.broadcast_arrays(*level), axis=1)


def flashes(normals, error_m=0.0):
    """Sub-apertures around four walls in rows at three heights; each sees walls before it."""
    rng = np.random.default_rng(0)
    angle, z = (a.ravel() for a in np.meshgrid(np.arange(0, 6.2, 0.1), (-0.06, 0.0, 0.06)))
    ahead = -np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    parts = []
    for normal in normals:
        level = normal / np.linalg.norm(normal[:2])
        for far, sign in ((False, -1.0), (True, 1.0)):
            own = np.flatnonzero(sign * ahead @ level > np.cos(0.1))
            noisy = normal + 0.005 * rng.normal(size=(len(own), 3))
            offset = OFFSET_M + 3e-4 * rng.normal(size=len(own)) + sign * error_m
            parts.append((noisy / np.linalg.norm(noisy, axis=1)[:, None], offset, own, far))
    found, offsets, subapertures, far = zip(*parts, strict=True)
    n = [len(each) for each in offsets]
    return Flashes(
        normals=np.concatenate(found),
        offsets_m=np.concatenate(offsets),
        far=np.repeat(far, n),
        levels_db=-10.0 + rng.normal(size=sum(n)),
        weights=np.ones(sum(n)),
        subapertures=np.concatenate(subapertures),
        centers=-0.4 * ahead + z[:, None] * UP,
        ahead=ahead,
        loss_shift_m=0.0,
    )


@pytest.mark.parametrize(
    ("azimuth_deg", "lean_deg", "error_m"),
    [(SKEWED, 0.0, 0.0), (CUBOID, 8.0, 0.01), ((10.0, 95.0, 195.0, 290.0), (5, -3, 9, 0), 0.0)],
)
def test_each_wall_has_its_own_yaw_lean_and_offset(azimuth_deg, lean_deg, error_m):
    true = normals_of(azimuth_deg, lean_deg)
    seen = flashes(true, error_m)
    rough = find_walls(seen, UP, 0.4, WAVEFORM)
    assert rough.score > next(rough_faces(seen, UP, 0.4, WAVEFORM)).score
    found = rough.normals[[0, 1, 0, 1], [1, 1, 0, 0]]
    order = (true @ found.T).argmax(axis=1)
    assert (np.einsum("ij,ij->i", true, found[order]) > np.cos(0.01)).all()
    np.testing.assert_allclose(rough.offsets_m[:2], OFFSET_M, atol=2e-3)
    assert rough.shift_m == pytest.approx(error_m, abs=2e-3)
    assert np.isnan(rough.offsets_m[2]).all()


def test_walls_at_right_angles_are_a_cuboid():
    seen = flashes(normals_of(CUBOID, 0.0))
    walls = find_walls(seen, UP, 0.4, WAVEFORM)
    assert walls.score < next(rough_faces(seen, UP, 0.4, WAVEFORM)).score


def test_two_walls_are_no_body():
    assert find_walls(flashes(normals_of(SKEWED[:2], 0.0)), UP, 0.4, WAVEFORM) is None


def a_body(azimuth_deg=SKEWED, lean_deg=0.0):
    east, north, west, south = normals_of(azimuth_deg, lean_deg)
    seen = np.array([[Seen.SQUARELY] * 2, [Seen.SQUARELY] * 2, [Seen.EDGES] * 2])
    return FoundBody(
        axes=np.eye(3),
        planes=np.array([[west, east], [south, north], [-UP, UP]]),
        angle_sigmas_rad=np.full((3, 2, 2), 0.005),
        turn_sigma_rad=np.full(3, 0.005),
        offsets_m=np.full((3, 2), OFFSET_M),
        sigmas_m=np.full((3, 2), 5e-4),
        bounds_m=np.zeros((3, 2, 2)),
        seen=seen,
    )


def test_a_body_is_the_prior_within_its_planes():
    body, shift = a_body(lean_deg=(0.0, 5.0, 0.0, 5.0)), np.array([0.3, -0.1, 0.2])
    prior = body.prior
    np.testing.assert_allclose(
        (prior.vertices @ body.normals.reshape(6, 3).T).max(axis=0), OFFSET_M, rtol=1e-9
    )
    assert (
        (unit_normals(prior.vertices[prior.faces]) @ body.normals.reshape(6, 3).T > 0.999)
        .any(axis=1)
        .all()
    )
    assert LosPrior.from_mesh(prior.mesh).cuboid is None
    moved = body.moved(shift)
    np.testing.assert_allclose(moved.prior.vertices, prior.vertices + shift, atol=1e-12)
    np.testing.assert_allclose(moved.size_m, body.size_m)
    faces = box_faces(moved.numbers())
    corners = np.concatenate([face.corners_m for face in faces])
    np.testing.assert_allclose(corners.min(axis=0), moved.prior.bounds[0], atol=1e-6)
    assert "corners of 82.0 98.0 82.0 98.0 degrees" in str(a_body())
    assert "-x +x -y +y lean outward by 0.0 0.0 5.0 5.0 +- 0.3 degrees" in str(body)


@pytest.mark.parametrize(
    ("azimuth_deg", "lean_deg", "is_cuboid"),
    [
        (CUBOID, 0.0, True),
        ((3.0, 93.0, 183.0, 273.0), (2.0, -1.0, -2.0, 1.0), True),  # a cuboid, turned and leaning
        (SKEWED, 0.0, False),
        (CUBOID, 5.0, False),
        (CUBOID, (5.0, 0.0, 0.0, 0.0), False),
    ],
)
def test_a_turned_cuboid_is_not_contradicted(azimuth_deg, lean_deg, is_cuboid):
    assert (a_body(azimuth_deg, lean_deg).contradiction() < 1.0) == is_cuboid


@pytest.fixture(scope="module")
def scan():
    """The walls across x are 8 degrees off their right angles to the others."""
    spec = examples.small_scene()
    wall = replace(spec.walls[0], size_m=(0.16, 0.16, 0.18))
    planes = replace(spec.scan, n_poses=8)
    world = replace(spec.world, box_skew_deg=SKEW_DEG)
    return simulate(replace(spec, walls=(wall,), scan=planes, world=world), seed=0)[0]


def test_a_scan_of_a_skewed_box_gives_its_corners(scan):
    body = find_box(scan)
    assert isinstance(body, FoundBody)
    yaw = np.rad2deg(body.angles_rad[..., 0])
    np.testing.assert_allclose(np.abs(yaw[0].mean() - yaw[1].mean()), SKEW_DEG, atol=0.5)
    np.testing.assert_allclose(np.rad2deg(body.angles_rad[..., 1]), 0.0, atol=1.0)
    true_m = 0.16 * np.cos(np.deg2rad(SKEW_DEG)), 0.16
    np.testing.assert_allclose(body.size_m[:2], true_m, atol=2e-3)
    volume = enclosed_volume_m3(body.prior.vertices, body.prior.faces)
    assert volume == pytest.approx(0.16**2 * body.size_m[2], rel=0.03)


def test_a_given_cuboid_becomes_the_body_and_keeps_its_height(scan):
    def checked(*size):
        prior = LosPrior.from_box(size)
        return box_check.check_prior(scan, prior, "--box", None, Listener(), None)

    check = checked(0.16, 0.16, 0.3)
    assert check.is_warning
    assert isinstance(check.found, FoundBox)
    assert "-z +z as given: it replaces the cuboid of the prior" in check.text
    assert np.ptp(check.prior.bounds[:, 2]) == pytest.approx(0.3)
