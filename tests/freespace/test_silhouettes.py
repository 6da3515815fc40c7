"""Silhouettes against two kinds of shadow that the method does not compute: wave optics and rays.

With waves the content blocks the path there and back, so that its edge lies where a quarter
of the flash is left and not a half.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.errors import UserError
from geraf2.freespace.silhouettes import (
    Silhouettes,
    find_silhouettes,
)
from geraf2.scene import Capture, Pose, Wall
from helpers.shadows import shadows
from helpers.synthetic import WAVEFORM
from reference import wall_shadow

WALL = Wall(size_m=(0.22, 0.22, 0.22), thickness_m=0.004, permittivity=1.6, center_m=(0, 0.01, 0))
STANDOFF_M = 0.4
INNER_M = 0.106
Y, Z = np.arange(-0.069, 0.07, 0.003), np.arange(-0.12, 0.121, 0.003)

# What is blocked along z, and along y.
SHAPES = {
    "top": (lambda z: z < 0.03, lambda y: y < 9.0),
    "post": (lambda z: z < 9.0, lambda y: np.abs(y) < 0.006),
    "body": (lambda z: z < 9.0, lambda y: np.abs(y) < 0.025),
}


@cache
def shadow_capture(shape, law, side=-1.0, tilt=0.0, noise=0.02, strength=1.0, bulge_m=0.0):
    """One plane before the wall at +-x; a screen through the middle of the box."""
    distances = (STANDOFF_M, STANDOFF_M + INNER_M, INNER_M, WAVEFORM.center_wavelength_m)
    along_z, along_y = SHAPES[shape]
    nothing = lambda positions: np.zeros(positions.shape, dtype=bool)  # noqa: E731
    flash = getattr(wall_shadow, law)
    tall = along_z(np.array(1.0))

    def bulge(positions):
        return bulge_m * np.cos(0.5 * np.pi * positions / INNER_M)

    def along(positions):
        return bulge(positions) - np.tan(tilt) * positions

    ry = flash(Y, along_y if tall else nothing, *distances, along)
    rz = flash(Z, nothing if tall else along_z, *distances, bulge)
    y, z = (a.ravel() for a in np.meshgrid(Y, Z, indexing="ij"))
    response = strength * np.outer(ry, rz).ravel()
    antennas = np.stack([np.full(y.size, side * STANDOFF_M), y + 0.01, z], axis=1)
    path_m = 2 * (STANDOFF_M + INNER_M + WALL.one_way_delay_m) + 0.15
    turns = path_m * WAVEFORM.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    signal = response[:, None] * np.exp(-2j * np.pi * turns + 0.7j)
    rng = np.random.default_rng(0)
    signal = signal + noise * (rng.normal(size=signal.shape) + 1j * rng.normal(size=signal.shape))
    pose = Pose(
        signal=signal.astype(np.complex64),
        tx_positions=antennas + np.array([0.0, 0.001, 0.0]),
        rx_positions=antennas - np.array([0.0, 0.001, 0.0]),
        axes=np.array([[-side, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    )
    return Capture(waveform=WAVEFORM, poses=(pose,), walls=(WALL,))


def edges(silhouettes, shape):
    """Where the outline crosses a line of points across the shape, relative to the middle [m]."""
    t = np.linspace(-0.06, 0.06, 2401)
    points = np.zeros((t.size, 3))
    points[:, 2 if shape == "top" else 1] = t
    points[:, 1] += 0.01
    free = silhouettes.free_distance(points) > 0.0
    return t[np.flatnonzero(np.diff(free.astype(int)))]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(
    ("law", "larger_m"), [("flash", (-0.0005, 0.001)), ("geometric_flash", (-0.0005, 0.0005))]
)
def test_the_outline_is_where_the_screen_ends(shape, law, larger_m):
    found = find_silhouettes(shadow_capture(shape, law))
    assert found.axes.tolist() == [0]
    expected = {"top": [0.03], "post": [-0.006, 0.006], "body": [-0.025, 0.025]}[shape]
    at = edges(found, shape)
    assert len(at) == len(expected)
    outwards = (at - expected) * np.sign(expected)
    assert (outwards > larger_m[0]).all()
    assert (outwards < larger_m[1]).all()


@pytest.mark.parametrize("law", ["flash", "geometric_flash"])
@pytest.mark.parametrize("bulge_m", [-0.001, 0.001])
def test_a_wall_that_bulges_is_a_curved_mirror(law, bulge_m):
    capture = shadow_capture("post", law, bulge_m=bulge_m)
    found = find_silhouettes(capture)
    assert found.thresholds.tolist() == [0.25 if law == "flash" else 0.5]
    outwards = edges(found, "post") * [-1.0, 1.0] - 0.006
    assert (outwards > -0.0005).all()
    assert (outwards < 0.002).all()


@pytest.mark.parametrize(("tilt_deg", "axes"), [(-2.5, []), (2.5, [0])])
def test_antennas_that_miss_the_box_by_a_tilted_wall_give_no_outline(tilt_deg, axes):
    y, z = (a.ravel() for a in np.meshgrid(np.arange(0.092, 0.098, 1e-3), Z, indexing="ij"))
    ramp = 2.0 * np.tan(np.radians(tilt_deg)) * y
    path_m = 2 * (STANDOFF_M + INNER_M + WALL.one_way_delay_m) + 0.15 + ramp
    turns = path_m[:, None] * WAVEFORM.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    antennas = np.stack([np.full(y.size, -STANDOFF_M), y + 0.01, z], axis=1)
    pose = replace(
        shadow_capture("body", "geometric_flash").poses[0],
        signal=np.exp(-2j * np.pi * turns).astype(np.complex64),
        tx_positions=antennas,
        rx_positions=antennas,
    )
    found = find_silhouettes(Capture(waveform=WAVEFORM, poses=(pose,), walls=(WALL,)))
    assert found.axes.tolist() == axes
    assert ("lines of sight" in str(found.reason)) == (not axes)


def test_the_reason_for_no_outline_is_stated():
    capture = shadow_capture("body", "geometric_flash")
    assert str(find_silhouettes(capture).reason) == ""
    pose, weak = capture.poses[0], shadow_capture("body", "geometric_flash", strength=0.0)
    beside, inside = (pose.moved(np.array(at)) for at in ([0.0, 0.3, 0.0], [0.35, 0.0, 0.0]))
    silent = replace(pose, signal=np.zeros_like(pose.signal))
    for found, reason in (
        (find_silhouettes(replace(capture, walls=())), "not known"),
        (find_silhouettes(replace(capture, poses=(beside,))), "right angle"),
        (find_silhouettes(replace(capture, poses=(inside,))), ""),
        (find_silhouettes(replace(capture, poses=(silent,))), ""),
        (find_silhouettes(weak), "at least 25% are needed"),
    ):
        assert len(found) == 0
        assert reason in str(found.reason)
        assert (found.free_distance(np.zeros((3, 3))) == -np.inf).all()


def test_the_delay_of_an_inner_box_is_subtracted():
    capture = shadow_capture("body", "geometric_flash")
    # A quarter of a turn of phase on the path there and back, of what its walls cover.
    inner = Wall(size_m=(0.12, 0.09, 0.12), thickness_m=0.0009, permittivity=1.6)
    feet = capture.poses[0].phase_centers
    crossed = (np.abs(feet[:, 1]) < 0.045) & (np.abs(feet[:, 2]) < 0.06)
    turns = 4 * inner.one_way_delay_m * WAVEFORM.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    delayed = capture.poses[0].signal * np.exp(-2j * np.pi * crossed[:, None] * turns)
    pose = replace(capture.poses[0], signal=delayed.astype(np.complex64))
    nested = replace(capture, poses=(pose,), walls=(WALL, inner))
    straight = edges(find_silhouettes(capture), "body")
    np.testing.assert_allclose(edges(find_silhouettes(nested), "body"), straight, atol=1e-4)
    unknown = edges(find_silhouettes(replace(nested, walls=(WALL,))), "body")
    assert len(unknown) != 2 or np.abs(unknown - straight).max() > 5e-4


def test_planes_from_both_sides_give_one_outline():
    one, other = (shadow_capture("top", "geometric_flash", side=side) for side in (-1.0, 1.0))
    both = replace(one, poses=(one.poses[0], other.poses[0]))
    found = find_silhouettes(both)
    assert len(found) == 1
    np.testing.assert_allclose(edges(found, "top"), [0.03], atol=1.5e-3)


def made(transmission, *, axis=1, known=None):
    return shadows([transmission], [axis], known)


def disc(radius_m=0.03, hole_m=0.0):
    x, z = np.meshgrid(np.arange(61) * 0.002 - 0.06, np.arange(81) * 0.002 - 0.08, indexing="ij")
    r = np.hypot(x, z)
    # linear over two cells, as a blurred edge
    blocked = np.clip((radius_m - r) / 0.004 + 0.5, 0, 1)
    return np.clip(1.0 - blocked + np.clip((hole_m - r) / 0.004 + 0.5, 0, 1) * (hole_m > 0), 0, 1)


def test_free_distance_is_that_to_the_outline():
    rng = np.random.default_rng(0)
    points = rng.uniform([-0.05, -1.0, -0.05], [0.05, 1.0, 0.05], (500, 3))
    expected = np.hypot(points[:, 0], points[:, 2]) - 0.03
    np.testing.assert_allclose(made(disc()).free_distance(points), expected, atol=7e-4)


def test_a_hole_with_the_full_flash_is_free():
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (500, 3))
    r = np.hypot(points[:, 0], points[:, 2])
    hole = made(disc(hole_m=0.012))
    expected = np.where(r < 0.021, 0.012 - r, r - 0.03)
    np.testing.assert_allclose(hole.free_distance(points), expected, atol=7e-4)
    # A little light inside may be the content's own echo.
    dim = replace(
        hole, transmission=np.where(disc(0.02)[None] < 0.9, 0.75, 1.0) * hole.transmission
    )
    np.testing.assert_allclose(dim.free_distance(points), r - 0.03, atol=7e-4)


def test_unknown_cells_may_hold_content():
    known = np.ones((61, 81), dtype=bool)
    known[:, 61:] = False  # z above 0.04
    x = np.zeros((100, 3))
    x[:, 2] = np.linspace(0.0, 0.07, 100)
    found = made(disc(), known=known).free_distance(x)
    assert (found[x[:, 2] > 0.0405] == -np.inf).all()
    expected = np.minimum(x[:, 2] - 0.03, 0.04 - x[:, 2])
    np.testing.assert_allclose(found[x[:, 2] < 0.0395], expected[x[:, 2] < 0.0395], atol=1e-3)


def test_a_saved_file_is_read_back(tmp_path):
    path = tmp_path / "silhouettes.npz"
    for outlines in (
        made(disc()),
        find_silhouettes(replace(shadow_capture("body", "flash"), walls=())),
    ):
        outlines.save(path)
        found = Silhouettes.load(path)
        for name in Silhouettes.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(found, name), getattr(outlines, name))
    np.savez(path, **{**vars(made(disc())), "known": np.ones(3, dtype=bool)})
    with pytest.raises(UserError, match="array known is not what geraf2 writes"):
        Silhouettes.load(path)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(UserError, match="cannot read the arrays"):
        Silhouettes.load(path)
