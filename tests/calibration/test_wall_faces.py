import numpy as np
import pytest

from geraf2.calibration.wall_faces import MODE_SIGMAS_M, N_MODES, WallFaces
from geraf2.scene import LosPrior

SIDES_M = (0.2, 0.3, 0.4)


def test_a_box_has_six_walls_with_coordinates_of_their_own():
    prior = LosPrior.from_box(SIDES_M, (0.01, 0.02, 0.03))
    walls = WallFaces.of(prior)
    assert len(walls.centers) == 6
    for number, center in enumerate(walls.centers):
        normal = walls.normals[number]
        assert walls.across[number] @ normal == pytest.approx(0.0, abs=1e-12)
        axis = int(np.abs(normal).argmax())
        off = center - prior.center_m
        assert off[axis] == pytest.approx(0.5 * SIDES_M[axis] * np.sign(normal[axis]))
        assert np.delete(off, axis) == pytest.approx(0.0, abs=1e-12)
        on_wall = np.abs((prior.vertices - center) @ normal) < 1e-9
        local = (prior.vertices[on_wall] - center) @ walls.across[number].T
        assert np.abs(local) == pytest.approx(1.0)


def test_shapes_vanish_at_the_rim_and_slopes_are_their_derivatives():
    walls = WallFaces.of(LosPrior.from_box(SIDES_M))
    position = np.array([[0.5, -0.25], [1.0, 0.3], [0.0, 0.0]])
    inverse = np.linalg.pinv(walls.across[2])
    number = np.full(3, 2)
    points = walls.centers[2] + position @ inverse.T
    found, slopes = walls.modes(number, points)
    assert found.shape == (3, N_MODES) == (3, len(MODE_SIGMAS_M))
    assert found[0, :4] == pytest.approx(
        [1.0, 0.5, -0.25, np.sin(0.75 * np.pi) * np.sin(0.375 * np.pi)]
    )
    assert found[1, 3:] == pytest.approx(0.0, abs=1e-12)
    assert found[2, 3] == pytest.approx(1.0)
    across = walls.across[2] / np.linalg.norm(walls.across[2], axis=1, keepdims=True)
    inner = [0, 2]
    for axis in range(2):
        high, low = (walls.modes(number, points + s * 1e-6 * across[axis])[0] for s in (1, -1))
        # Truncation, (1e-6 / 0.1 m)^2, is far below rounding, 1e-16 / 1e-6.
        assert slopes[inner, axis] == pytest.approx((high - low)[inner] / 2e-6, abs=1e-7)


def test_a_rough_surface_has_few_walls():
    rng = np.random.default_rng(0)
    prior = LosPrior.from_box(SIDES_M)
    noise = LosPrior(vertices=prior.vertices, faces=rng.permutation(prior.faces))
    assert len(WallFaces.of(noise).centers) == 6


@pytest.mark.parametrize("turn_deg", [0.0, 8.0, -15.0, 25.0])
@pytest.mark.parametrize("shift_m", [0.0, 0.06, -0.11, 0.15])
def test_rim_bias_is_the_mean_range_of_antennas_that_see_the_wall(turn_deg: float, shift_m: float):
    walls, size_m = WallFaces.of(LosPrior.from_box(SIDES_M)), 0.08
    face = int(walls.centers[:, 0].argmax())
    turn = np.deg2rad(turn_deg)
    axes = np.array(
        [[-np.cos(turn), np.sin(turn), 0.0], [-np.sin(turn), -np.cos(turn), 0.0], [0.0, 0.0, 1.0]]
    )
    middle = walls.centers[face] + np.array([0.4, shift_m, 0.0])
    # Twin: antennas one by one; those whose foot lies beyond the rim send nothing back.
    antennas = middle + np.linspace(-0.5, 0.5, 2001)[:, None] * size_m * axes[1]
    heard = np.abs(antennas[:, 1]) < 0.5 * SIDES_M[1]
    found = walls.rim_bias(np.array([face]), middle[None], axes[None], size_m)
    assert heard.any()
    bias = abs(antennas[heard, 0].mean() - middle[0])
    assert found[0] == pytest.approx(bias * np.cos(turn), abs=1e-5)
