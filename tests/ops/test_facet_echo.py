import numpy as np
import pytest

from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.ops.facet_echo import FacetEcho
from helpers.synthetic import WAVEFORM


@pytest.fixture
def problem():
    """Antennas, targets, points and the echo between them."""
    rng = np.random.default_rng(0)
    tx = np.array([0.4, 0.0, 0.0]) + 0.05 * rng.standard_normal((9, 3))
    rx = tx + np.array([0.0, 0.004, 0.0])
    targets, points = 0.05 * rng.standard_normal((7, 3)), 0.02 * rng.standard_normal((40, 3))
    return tx, rx, targets, points, FacetEcho(tx, rx, targets, WAVEFORM, num_threads=1)


def naive_matrix(tx, rx, targets, points):
    """K, entry after entry."""
    k = 2.0 * np.pi * WAVEFORM.frequencies_hz / SPEED_OF_LIGHT_M_PER_S

    def path(x, antenna):
        return np.linalg.norm(x - tx[antenna]) + np.linalg.norm(x - rx[antenna])

    return np.array(
        [
            [
                np.mean([np.exp(1j * k * (path(x, i) - path(p, i))).sum() for i in range(len(tx))])
                for p in points
            ]
            for x in targets
        ]
    )


def test_the_image_is_that_of_the_matrix(problem):
    *geometry, echo = problem
    rng, matrix = np.random.default_rng(1), naive_matrix(*geometry)
    amplitudes = rng.standard_normal(40)
    largest = np.abs(matrix).max()
    found = echo.image(amplitudes, geometry[3])
    np.testing.assert_allclose(found, matrix @ amplitudes, atol=5e-3 * largest)


def test_wrong_shapes_are_refused(problem):
    *_, points, echo = problem
    with pytest.raises(ValueError, match="amplitudes"):
        echo.image(np.ones(3), points)
