import numpy as np
import pytest

from geraf2.echoes.wall_faces import WallFaces
from geraf2.scene import LosPrior

SIDES_M = (0.2, 0.3, 0.4)


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
