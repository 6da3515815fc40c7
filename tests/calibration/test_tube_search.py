"""Tubes and drums: from exact flashes, and from a simulated scan."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2 import examples
from geraf2.calibration import box_finder
from geraf2.calibration.box_finder import find_box
from geraf2.calibration.box_search import Flashes
from geraf2.calibration.found_box import FoundTube
from geraf2.calibration.leakage import find_leakage
from geraf2.calibration.tube_search import find_tube
from geraf2.errors import UserError
from geraf2.geometry.triangles import enclosed_volume_m3
from geraf2.ops.physical_optics import AntennaBlocks, SurfaceElements, physical_optics
from geraf2.pipeline import box_check
from geraf2.pipeline.events import Listener
from geraf2.scene import Capture, LosPrior, Wall

UP, CENTER, RADIUS_M = np.array([0.0, 0.0, 1.0]), np.array([0.013, -0.008, 0.0]), 0.062


def flashes(lean=(0.0, 0.0), error_m=0.0, far=True, noise_m=2e-4):
    """Sub-apertures around a tube, in rows at three heights; each sees both walls of it."""
    rng, axis = np.random.default_rng(0), np.array([*lean, 1.0])
    axis /= np.linalg.norm(axis)
    angle, z = (a.ravel() for a in np.meshgrid(np.arange(0, 6.2, 0.13), (-0.06, 0.0, 0.06)))
    ahead = -np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    centers = -0.4 * ahead + z[:, None] * UP
    to = centers - CENTER
    normal = to - np.outer(to @ axis, axis)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    n = len(centers)
    one = np.ones(n)
    deviation = noise_m * rng.normal(size=2 * n)
    normals = np.concatenate([normal, -normal])[: None if far else n]
    offsets = RADIUS_M + normals @ CENTER + deviation[: len(normals)]
    offsets += np.repeat([-error_m, error_m], n)[: len(normals)]
    return Flashes(
        normals=normals,
        offsets_m=offsets,
        far=np.repeat([False, True], n)[: len(normals)],
        levels_db=-10.0 + rng.normal(size=len(normals)),
        weights=np.concatenate([one, one])[: len(normals)],
        subapertures=np.tile(np.arange(n), 2)[: len(normals)],
        centers=centers,
        ahead=ahead,
        loss_shift_m=0.0,
    )


@pytest.mark.parametrize(("lean", "error_m"), [((0.0, 0.0), 0.0), ((0.02, -0.01), 0.012)])
def test_a_tube_is_found_with_its_lean_at_any_error_of_the_delay(lean, error_m):
    found = find_tube(flashes(lean, error_m), UP, 0.4)
    assert found.radius_m == pytest.approx(RADIUS_M, abs=2e-4)
    np.testing.assert_allclose(found.center_m[:2], CENTER[:2], atol=2e-4)
    np.testing.assert_allclose(found.axes[2, :2] / found.axes[2, 2], lean, atol=2e-3)
    assert found.radius_sigma_m < 1.5e-3


def test_a_surface_without_a_far_wall_is_no_tube():
    assert find_tube(flashes(far=False), UP, 0.4) is None


def wall_echo(radius_m, inside, antennas, waveform, slab):
    """Both faces of a tube of 0.16 m, by physical optics."""
    n, m = 260, 24
    angle, z = (
        a.ravel()
        for a in np.meshgrid(2 * np.pi * np.arange(n) / n, 0.16 * ((np.arange(m) + 0.5) / m - 0.5))
    )
    outward = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    along = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    points = radius_m * outward + z[:, None] * UP + CENTER
    half = np.pi * radius_m / n, 0.08 / m
    faces = np.stack([half[0] * along, np.broadcast_to(half[1] * UP, along.shape)], axis=1)
    normals = -outward if inside else outward
    middle = antennas.tx.mean(axis=0)
    weights = 4.0 * half[0] * half[1] * (((middle - points) * normals).sum(axis=1) > 0)
    return sum(
        physical_optics(
            SurfaceElements(
                points=points, normals=normals, edges=faces, shape="rectangle",
                reflector=face, slab=slab,
            ),
            weights[None].astype(np.complex64),
            antennas,
            waveform,
        )
        for face in ("first_face", "second_face")
    )  # fmt: skip


@pytest.fixture(scope="module")
def tube_scan():
    """The small capture's planes around a tube with a ball of 2 cm in it."""
    capture, slab = (
        examples.small_capture()[0],
        Wall(size_m=(0.124, 0.124, 0.16), thickness_m=0.004, permittivity=1.6),
    )
    longer = replace(capture.waveform, path_bias_m=capture.waveform.path_bias_m + 0.002)
    poses = []
    for pose in capture.poses:
        blocks = AntennaBlocks(
            tx=pose.tx_positions,
            rx=pose.rx_positions,
            offsets=np.array([0, pose.n_antennas]),
            boresight=pose.axes[0],
        )
        signal = wall_echo(RADIUS_M, False, blocks, capture.waveform, slab)
        signal = signal + 0.9 * wall_echo(RADIUS_M - 0.004, True, blocks, longer, slab)
        toward = -pose.axes[:1]
        glint = SurfaceElements(points=0.01 * toward)
        amplitude = np.array([[2e-4 + 0j]], dtype=np.complex64)
        signal = signal + physical_optics(glint, amplitude, blocks, longer)
        poses.append(replace(pose, signal=np.asarray(signal, dtype=np.complex64)))
    return Capture(waveform=capture.waveform, poses=tuple(poses))


def test_a_scan_of_a_tube_gives_its_cylinder_as_prior(tube_scan):
    tube = find_box(tube_scan)
    assert isinstance(tube, FoundTube)
    assert tube.radius_m == pytest.approx(RADIUS_M, abs=2.0e-3)
    np.testing.assert_allclose(tube.center_m[:2], CENTER[:2], atol=2e-3)
    prior = tube.prior
    volume = np.pi * tube.radius_m**2 * tube.size_m[2]
    assert enclosed_volume_m3(prior.vertices, prior.faces) == pytest.approx(volume, rel=1e-3)
    numbers = tube.numbers()
    assert numbers["shape"] == "tube"
    assert set(numbers["faces"]) == {"-z", "+z"}
    assert str(tube).startswith(f"tube of radius {1e3 * tube.radius_m:.1f} +- ")


def test_leakage_is_searched_around_a_tube(tube_scan, monkeypatch):
    found, around = find_box(tube_scan), []

    def searched(capture, prior, peaks):
        around.append(prior.size_m)
        return find_leakage(capture, prior, peaks)

    monkeypatch.setattr(box_finder, "_LEAKAGE_DB", -np.inf)
    monkeypatch.setattr(box_finder, "find_leakage", searched)
    assert find_box(tube_scan).radius_m == found.radius_m
    np.testing.assert_allclose(around[0][:2], 2.0 * found.radius_m, rtol=1e-2)


def checked(capture, size, center):
    prior = LosPrior.from_box(size, center)
    return box_check.check_prior(capture, prior, "--box", None, Listener(), None)


def test_a_cuboid_around_a_tube_becomes_the_tube_and_keeps_its_height(tube_scan):
    check = checked(tube_scan, (0.13, 0.13, 0.2), (0.012, -0.008, 0.01))
    assert check.is_warning
    assert "200 mm high; ends -z +z as given: it replaces the cuboid" in check.text
    assert check.prior.cuboid is None
    low, high = check.prior.bounds
    assert high[2] - low[2] == pytest.approx(0.2, abs=2e-3)
    assert 0.5 * (high + low)[2] == pytest.approx(0.01, abs=2e-3)


def test_another_box_around_a_tube_is_refused(tube_scan):
    with pytest.raises(
        UserError, match=r"another box than the prior, .* no cuboid.*got tube of radius"
    ):
        checked(tube_scan, (0.3, 0.25, 0.2), (0.0, 0.0, 0.0))
