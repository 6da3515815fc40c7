import numpy as np
import pytest

from geraf2.echoes.wall_delay import box_delay_m
from geraf2.ops.visibility import MeshScene
from geraf2.scene import LosPrior, Wall

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
