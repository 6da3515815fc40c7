"""The network that says what each echo of plastic is of: against a slow twin, and on bodies."""

import numpy as np
import pytest

from geraf2.echoes.face_network import AT_ONCE, guess_faces, load_network, trained_network
from geraf2.errors import UserError
from geraf2.io.checkpoint import Checkpoint, save_checkpoint
from helpers.glint_sets import glints_at
from helpers.specular import fibonacci_sphere
from reference.face_network import run

INDEX, RADIUS_M = 1.64, 0.02
FRONT, BACK = 0, 1


@pytest.fixture
def few():
    rng = np.random.default_rng(3)
    normals = rng.standard_normal((7, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return rng.uniform(-0.05, 0.05, (7, 3)), normals, rng.uniform(0.1, 2.0, 7)


def both_faces(n=300):
    """Echoes of the fronts of a ball, then of its back faces."""
    legs = fibonacci_sphere(n)
    places = np.concatenate([RADIUS_M * legs, (1.0 - 2.0 * INDEX) * RADIUS_M * legs])
    return glints_at(places, np.concatenate([legs, legs]))


def test_the_network_is_that_of_the_twin(few):
    network = trained_network()
    logits, log_thickness = network(*few)
    expected = run(network.arrays, *few)
    np.testing.assert_allclose(logits, expected[:, :4], atol=2e-4)
    np.testing.assert_allclose(log_thickness, expected[:, 4], atol=2e-4)


def test_neither_order_nor_place_nor_turn_about_the_vertical_matters(few):
    positions, normals, strengths = few
    network, order = trained_network(), np.random.default_rng(0).permutation(len(positions))
    turn = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    found = network(positions, normals, strengths)
    moved = network(
        positions[order] @ turn.T + [0.3, -0.2, 0.5],
        normals[order] @ turn.T,
        5.0 * strengths[order],
    )
    for one, other in zip(found, moved, strict=True):
        np.testing.assert_allclose(other, one[order], atol=2e-4)


def test_both_faces_of_a_ball_are_told_apart():
    guess, is_back = guess_faces(both_faces()), np.repeat([False, True], 300)
    assert guess.probability.shape == (600, 4)
    np.testing.assert_allclose(guess.probability.sum(axis=1), 1.0)
    kinds = guess.probability.argmax(axis=1)
    assert (kinds[~is_back] == FRONT).mean() > 0.95
    assert (kinds[is_back] == BACK).mean() > 0.95
    assert np.median(guess.thickness_m[is_back]) == pytest.approx(2.0 * RADIUS_M, rel=0.25)


def test_a_metal_ball_has_fronts_alone():
    legs = fibonacci_sphere(300)
    kinds = guess_faces(glints_at(0.03 * legs, legs)).probability.argmax(axis=1)
    assert (kinds == FRONT).mean() > 0.95


@pytest.mark.parametrize("n", [1, AT_ONCE, AT_ONCE + 1])
def test_any_number_of_glints_has_a_guess(n):
    legs = fibonacci_sphere(n)
    guess = guess_faces(glints_at(0.03 * legs, legs))
    assert np.isfinite(guess.probability).all()
    assert (guess.thickness_m > 0.0).all()


def test_weights_of_something_else_are_refused(tmp_path):
    path = tmp_path / "other.safetensors"
    other = Checkpoint(kind="completion", version=1, arrays={"a": np.zeros(2)}, header={})
    save_checkpoint(path, other)
    with pytest.raises(UserError, match=r"other\.safetensors"):
        load_network(path)
