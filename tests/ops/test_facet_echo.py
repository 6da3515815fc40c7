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


def test_image_and_adjoint_are_the_matrix_and_its_own(problem):
    *geometry, echo = problem
    rng, matrix = np.random.default_rng(1), naive_matrix(*geometry)
    amplitudes = rng.standard_normal(40)
    image = rng.standard_normal((7, 2)) @ [1.0, 1j]
    largest = np.abs(matrix).max()
    found = echo.image(amplitudes, geometry[3])
    np.testing.assert_allclose(found, matrix @ amplitudes, atol=5e-3 * largest)
    back = echo.adjoint(image, geometry[3])
    np.testing.assert_allclose(back, matrix.conj().T @ image, atol=5e-3 * largest)
    both = np.vdot(image, found).real, np.vdot(back, amplitudes).real
    np.testing.assert_allclose(*both, rtol=1e-4)


def test_the_path_turns_as_differences_say(problem):
    tx, rx, _, points, echo = problem
    step = 1e-6 * np.eye(3)

    def path(x):
        return sum(np.linalg.norm(x - side.mean(axis=0), axis=1) for side in (tx, rx))

    slopes = [(path(points + d) - path(points - d)) / 2e-6 for d in step]
    np.testing.assert_allclose(echo.path_gradient(points), np.transpose(slopes), atol=1e-8)


def test_wrong_shapes_are_refused(problem):
    *_, points, echo = problem
    with pytest.raises(ValueError, match="amplitudes"):
        echo.image(np.ones(3), points)
    with pytest.raises(ValueError, match="image"):
        echo.adjoint(np.ones(3, dtype=np.complex64), points)
