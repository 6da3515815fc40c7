from dataclasses import replace

import numpy as np
import pytest

from geraf2.echoes.wall_delay import (
    box_delay_m,
    learn_wall_delay,
    unknown_delay_m,
)
from geraf2.imaging.peaks import PeakSet
from geraf2.ops.visibility import MeshScene
from geraf2.scene import LosPrior, Wall
from helpers.synthetic import waveform_of

SIZE = (0.2, 0.2, 0.2)
OUTER = Wall(size_m=SIZE, thickness_m=0.004, permittivity=1.6)
INNER = Wall(size_m=(0.1, 0.1, 0.1), thickness_m=0.003, permittivity=2.0)
NORMAL_DELAY = (np.sqrt(1.6) - 1.0) * 0.004


@pytest.fixture(scope="module")
def scene():
    prior = LosPrior.from_box(SIZE)
    return MeshScene(prior.vertices, prior.faces)


def delay(scene, walls, center, direction, distance):
    direction = np.array([direction], dtype=float)
    direction /= np.linalg.norm(direction)
    center = np.array([center], dtype=float)
    return float(box_delay_m(scene, walls, center, direction, np.array([distance]))[0])


def test_normal_incidence_adds_the_optical_thickness_less_the_thickness(scene):
    assert delay(scene, (OUTER,), [0.4, 0, 0], [-1, 0, 0], 0.35) == pytest.approx(NORMAL_DELAY)
    assert pytest.approx(OUTER.one_way_delay_m) == NORMAL_DELAY


@pytest.mark.parametrize("angle", [0.2, 0.6, 1.0])
def test_oblique_incidence_follows_the_refracted_ray(scene, angle):
    # Start on the ray that meets the face's middle at the angle.
    direction = np.array([-np.cos(angle), np.sin(angle), 0.0])
    center = np.array([0.1, 0.0, 0.0]) - 0.3 * direction
    # Optical path of the refracted ray inside the slab, less the path in air between the same
    # wavefronts: t eps / q - t tan(a') sin(a) - t cos(a) with Snell's a'.
    inside = np.arcsin(np.sin(angle) / np.sqrt(1.6))
    path = 0.004 * np.sqrt(1.6) / np.cos(inside)
    slipped = 0.004 * (np.tan(angle) - np.tan(inside)) * np.sin(angle)
    expected = path + slipped - 0.004 / np.cos(angle)
    assert delay(scene, (OUTER,), center, direction, 0.35) == pytest.approx(expected, rel=1e-6)


def test_an_echo_outside_the_wall_has_no_delay(scene):
    assert delay(scene, (OUTER,), [0.4, 0, 0], [-1, 0, 0], 0.25) == 0.0
    assert delay(scene, (OUTER,), [0.4, 0.3, 0], [-1, 0, 0], 0.5) == 0.0


def test_an_inner_wall_counts_only_for_echoes_inside_it(scene):
    both = NORMAL_DELAY + (np.sqrt(2.0) - 1.0) * 0.003
    for distance, expected in ((0.33, NORMAL_DELAY), (0.37, both), (0.47, NORMAL_DELAY)):
        found = delay(scene, (OUTER, INNER), [0.4, 0, 0], [-1, 0, 0], distance)
        assert found == pytest.approx(expected)


def test_a_displaced_inner_wall_counts_at_its_position(scene):
    moved = Wall(**{**vars(INNER), "center_m": (0.0, 0.03, 0.0)})
    with_inner = delay(scene, (OUTER, moved), [0.4, 0.06, 0], [-1, 0, 0], 0.4)
    without = delay(scene, (OUTER, INNER), [0.4, 0.06, 0], [-1, 0, 0], 0.4)
    assert without == pytest.approx(NORMAL_DELAY)
    assert with_inner > without + 1e-3


def test_no_echo_no_delay(scene):
    nothing = np.zeros((0, 3))
    assert box_delay_m(scene, (OUTER,), nothing, nothing, np.zeros(0)).shape == (0,)


def wall_echoes(thickness, permittivity, bias, *, n=40, walls=("near", "far"), seed=0):
    """Echoes as a slab's two faces give them, with 0.1 mm of scatter, and some of the content."""
    rng = np.random.default_rng(seed)
    optical = np.sqrt(permittivity) * thickness
    ranges = {
        "near": 0.3 + 0.5 * optical + bias,
        "far": 0.5 + 1.5 * optical - 2.0 * thickness + bias,
    }
    parts = [ranges[name] + 1e-4 * rng.standard_normal(n) for name in walls]
    parts.append(rng.uniform(0.35, 0.45, n))
    echoes = np.concatenate(parts)
    sideways = rng.uniform(-0.05, 0.05, (len(echoes), 2))
    return PeakSet(
        subapertures=np.arange(len(echoes)),
        directions=np.tile([-1.0, 0.0, 0.0], (len(echoes), 1)),
        ranges_m=echoes,
        magnitudes=rng.uniform(0.5, 1.0, len(echoes)),
        noise=np.zeros(len(echoes)),
        subaperture_centers=np.column_stack([np.full(len(echoes), 0.4), sideways]),
        subaperture_coordinates=sideways,
        subaperture_planes=np.zeros(len(echoes), dtype=np.int64),
        tops=np.ones(len(echoes)),
        periods=np.full((len(echoes), 2), np.inf),
    )


@pytest.mark.parametrize("permittivity", [1.4, 1.6, 2.2])
@pytest.mark.parametrize("bias", [-0.001, 0.0, 0.0015])
def test_both_walls_give_the_delay_and_the_constant_error(scene, permittivity, bias):
    learned = learn_wall_delay(wall_echoes(0.004, permittivity, bias), scene)
    expected = (np.sqrt(permittivity) - 1.0) * 0.004 + bias
    assert learned == pytest.approx(expected, abs=5e-5)


def test_the_near_wall_alone_counts_half(scene):
    learned = learn_wall_delay(wall_echoes(0.004, 16 / 9, 0.0, walls=("near",)), scene)
    assert learned == pytest.approx((4 / 3 - 1.0) * 0.004, abs=5e-5)


def test_no_wall_seen_is_no_delay(scene):
    assert learn_wall_delay(wall_echoes(0.004, 1.6, 0.0, walls=()), scene) == 0.0
    assert learn_wall_delay(wall_echoes(0.004, 1.6, 0.0, walls=("far",)), scene) == 0.0
    assert learn_wall_delay(wall_echoes(0.004, 1.6, 0.0, n=11, walls=("near",)), scene) == 0.0
    assert learn_wall_delay(wall_echoes(0.004, 1.6, 0.0, n=0), scene) == 0.0


@pytest.mark.parametrize("shift", [-0.009, -0.006, 0.0])
def test_the_shift_of_faces_that_cancel_is_no_delay(scene, shift):
    """Near and far echoes both lie before their middles; no board delays by less than nothing."""
    echoes = wall_echoes(0.004, 1.6, shift)
    found = unknown_delay_m(echoes, scene, waveform_of())
    assert found == pytest.approx((np.sqrt(1.6) - 1.0) * 0.004, abs=1.5e-3)


def test_lines_of_sight_that_miss_the_box_are_not_used(scene):
    echoes = wall_echoes(0.004, 1.6, 0.0)
    aside = replace(echoes, subaperture_centers=echoes.centers + np.array([0.0, 1.0, 0.0]))
    assert learn_wall_delay(aside, scene) == 0.0


def test_slanted_lines_of_sight_are_not_used(scene):
    echoes = wall_echoes(0.004, 1.6, 0.0)
    angle = 0.3
    directions = np.tile([-np.cos(angle), np.sin(angle), 0.0], (len(echoes.ranges_m), 1))
    ranges = (echoes.ranges_m - 0.3) + 0.3 / np.cos(angle)
    slanted = replace(echoes, directions=directions, ranges_m=ranges)
    assert learn_wall_delay(slanted, scene) == 0.0
