"""The box of a scan, found without a prior. Scans are coarse: antennas 6 mm apart."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2 import examples, simulate
from geraf2.calibration import box_finder
from geraf2.calibration.box_finder import find_box
from geraf2.calibration.cuboid_search import rough_faces
from geraf2.calibration.found_box import Seen
from geraf2.calibration.free_air import content_region
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.errors import UserError
from geraf2.scene import LosPrior
from geraf2.simulation.spec import RingSpec

SIZE_M, CENTER_M = np.array([0.16, 0.20, 0.18]), np.array([0.01, -0.005, 0.0])
SIDES = ("-x", "+x", "-y", "+y")


def turned(capture, degrees):
    cosine, sine = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    return replace(
        capture,
        poses=tuple(
            replace(
                pose,
                tx_positions=pose.tx_positions @ turn.T,
                rx_positions=pose.rx_positions @ turn.T,
                axes=np.ascontiguousarray(pose.axes @ turn.T),
            )
            for pose in capture.poses
        ),
    ), turn


@pytest.fixture(scope="module")
def scan():
    """All four sides are seen at 10 degrees, where grating lobes show them at 9 degrees."""
    spec = examples.small_scene()
    wall = replace(spec.walls[0], size_m=tuple(SIZE_M), center_m=tuple(CENTER_M))
    planes = replace(spec.scan, n_poses=8, start_angle_deg=10.0)
    return simulate(replace(spec, walls=(wall,), scan=planes), seed=0)[0]


@pytest.fixture(scope="module")
def found(scan):
    return find_box(scan)


@pytest.mark.parametrize("degrees", [0.0, 31.0, -41.0])
def test_a_box_is_found_at_any_yaw(scan, found, degrees):
    capture, turn = turned(scan, degrees)
    box = find_box(capture) if degrees else found
    assert abs(box.yaw_deg - degrees) < 0.3
    np.testing.assert_allclose(box.size_m[:2], SIZE_M[:2], atol=2e-3)
    np.testing.assert_allclose((box.center_m @ turn)[:2], CENTER_M[:2], atol=1e-3)
    assert (box.seen[:2] == Seen.SQUARELY).all()
    assert np.isfinite(box.sigmas_m[:2]).all()


def test_a_found_box_is_a_prior_and_describes_its_evidence(found):
    box = found
    axes, size, center = box.prior.cuboid
    np.testing.assert_allclose(size, box.size_m)
    np.testing.assert_allclose(center, box.center_m)
    np.testing.assert_allclose(axes, box.axes, atol=1e-12)
    off = " ".join(f"{1e3 * offset:.0f}" for offset in box.offsets_m[2])
    assert f"-x +x -y +y seen squarely, -z +z not seen: assumed {off} mm from" in str(box)
    certain = LosPrior(vertices=box.prior.certain, faces=box.prior.faces)
    np.testing.assert_allclose(certain.cuboid[1][:2], box.size_m[:2], rtol=1e-9)
    assert certain.cuboid[1][2] < box.size_m[2] - 0.02
    faces = box.numbers()["faces"]
    assert [faces[name]["seen"] for name in SIDES] == ["squarely"] * 4
    assert faces["+z"]["seen"] == "not"
    low, high = faces["+z"]["interval_m"]
    assert high is None
    assert 0.0 < low < 0.5 * SIZE_M[2]
    assert 0.5 * SIZE_M[2] < faces["+z"]["offset_m"]  # nothing of the content is cut off


def test_a_box_of_which_only_the_top_is_seen_has_any_yaw(scan):
    """Content below the top: planes in one ring 45 degrees off the walls, and one above."""
    spec = examples.small_scene()
    wall = replace(spec.walls[0], size_m=(0.24, 0.24, 0.18))
    planes = replace(
        spec.scan,
        n_poses=4,
        start_angle_deg=45.0,
        standoff_m=0.36,
        rings=(RingSpec(n_poses=1, elevation_deg=90.0),),
    )
    box = find_box(simulate(replace(spec, walls=(wall,), scan=planes), seed=0)[0])
    assert box.seen.tolist() == [[Seen.NOT] * 2, [Seen.NOT] * 2, [Seen.SQUARELY] * 2]
    assert box.yaw_sigma_deg > 20.0
    np.testing.assert_allclose(box.offsets_m[2], 0.09, atol=0.003)


def test_sides_that_no_antenna_faces_are_found_by_their_edges():
    box = find_box(examples.small_capture()[0])
    assert box.seen[0].tolist() == [Seen.SQUARELY] * 2
    assert box.seen[1].tolist() == [Seen.EDGES] * 2
    low, high = np.moveaxis(box.bounds_m[1], -1, 0)
    assert (low < 0.08).all()
    assert (high > 0.08).all()


def test_the_origin_of_the_frame_may_lie_anywhere(scan, found):
    shift = np.array([0.3, -0.2, 1.0])
    poses = tuple(pose.moved(shift) for pose in scan.poses)
    here, there = found, find_box(replace(scan, poses=poses))
    np.testing.assert_allclose(there.center_m - here.center_m, shift, atol=1e-5)
    np.testing.assert_allclose(there.size_m, here.size_m, atol=1e-5)
    np.testing.assert_array_equal(there.seen, here.seen)


def test_walls_extend_to_the_apertures_that_see_them():
    """Planes 25 degrees beside a wall's normal see it 15 cm from its middle, and no other wall."""
    spec = examples.small_scene()
    wall = replace(spec.walls[0], size_m=(0.40, 0.15, 0.20))
    planes = replace(
        spec.scan, n_poses=4, start_angle_deg=65.0, standoff_m=0.36, aperture_m=(0.14, 0.08)
    )
    box = find_box(simulate(replace(spec, walls=(wall,), scan=planes), seed=0)[0])
    assert box.seen[1].tolist() == [Seen.SQUARELY] * 2
    assert abs(box.size_m[1] - 0.15) < 2e-3
    assert (box.bounds_m[0, :, 0] > 0.075).all()


def test_a_rival_follows_a_hypothesis_that_the_scan_contradicts(scan, found, monkeypatch):
    def with_false_first(*args):
        for true in rough_faces(*args):
            yield replace(true, offsets_m=np.array([[0.03, 0.03], [0.09, 0.09], [0.09, 0.09]]))
            yield true

    monkeypatch.setattr(box_finder, "rough_faces", with_false_first)
    np.testing.assert_array_equal(find_box(scan).offsets_m, found.offsets_m)


def test_the_walls_of_the_scene_do_not_give_the_size(scan, found):
    other = tuple(replace(wall, size_m=(0.3, 0.3, 0.3)) for wall in scan.walls)
    unlike = find_box(replace(scan, walls=other))
    np.testing.assert_array_equal(unlike.offsets_m, found.offsets_m)


def test_noise_has_no_walls(scan):
    rng = np.random.default_rng(0)
    noise = tuple(
        replace(pose, signal=rng.normal(size=(pose.n_antennas, 64)).astype("f4").view("c8"))
        for pose in scan.poses
    )
    with pytest.raises(UserError, match=r"no walls of a box are found .*box X Y Z"):
        find_box(replace(scan, poses=noise))


def test_a_box_whose_wall_faces_cancel_is_found(scan):
    """Two round trips in the wall are three wavelengths: each wall has two weak echoes."""
    spec = examples.small_scene()
    index = np.sqrt(spec.walls[0].permittivity)
    middle_hz = scan.waveform.frequencies_hz.mean()
    thickness_m = 1.5 * SPEED_OF_LIGHT_M_PER_S / middle_hz / index
    wall = replace(
        spec.walls[0], size_m=tuple(SIZE_M), center_m=tuple(CENTER_M), thickness_m=thickness_m
    )
    planes = replace(spec.scan, n_poses=8, start_angle_deg=10.0)
    capture = simulate(replace(spec, walls=(wall,), scan=planes), seed=0)[0]
    for walls in (capture.walls, ()):
        box = find_box(replace(capture, walls=walls))
        np.testing.assert_allclose(box.size_m[:2], SIZE_M[:2], atol=5e-3)
        assert abs(box.yaw_deg) < 0.5


def test_content_in_free_air_has_no_walls_and_a_region():
    capture, truth = simulate(replace(examples.small_scene(), walls=()), seed=0)
    with pytest.raises(UserError, match="no walls of a box are found"):
        find_box(capture)
    region = content_region(capture)
    _, size, center = region.cuboid
    assert (truth.vertices > center - 0.5 * size).all()
    assert (truth.vertices < center + 0.5 * size).all()
    assert (size < np.ptp(truth.vertices, axis=0) + 0.2).all()
    poses = tuple(replace(pose, signal=np.zeros_like(pose.signal)) for pose in capture.poses)
    with pytest.raises(UserError, match=r"content's region is not found .* box X Y Z"):
        content_region(replace(capture, poses=poses))


def test_antennas_within_the_walls_are_refused(scan):
    middle = scan.poses[3]
    poses = (*scan.poses[:3], middle.moved(0.38 * middle.axes[0]), *scan.poses[4:])
    with pytest.raises(UserError, match="planes of antennas within the walls: 1"):
        find_box(replace(scan, poses=poses))


def test_one_flat_surface_is_no_box(scan, monkeypatch):
    refined, only = box_finder._refined, np.array([[Seen.SQUARELY, 0], [0, 0], [0, 0]])
    monkeypatch.setattr(box_finder, "_refined", lambda *a: replace(refined(*a), seen=only))
    with pytest.raises(UserError, match="one flat surface, which may be content"):
        find_box(scan)


def test_planes_that_meet_before_any_box_have_no_walls(scan):
    near = tuple(
        pose.moved((pose.phase_centers.mean(axis=0) @ pose.axes[0] + 0.03) * -pose.axes[0])
        for pose in scan.poses
    )
    with pytest.raises(UserError, match=r"no walls .* the planes meet 30 mm in front of them"):
        find_box(replace(scan, poses=near))
