"""Clusters of spheres: against the method of moments, one sphere away from the middle, any turn."""

import numpy as np
import pytest

K = 1655.0  # 79 GHz
AT = np.array([[0.3, 0.1, 0.05], [0.2, -0.2, 0.3], [0.02, 0.01, -0.3]])
MOMENT = np.tile([0.3, 0.8, 0.5], (3, 1))
# Two spheres of 4 and 3 mm with a gap of 3 mm: coupling is more than the echo of each alone.
RADII, HEIGHTS = (0.004, 0.003), (-0.004, 0.006)


def _orders(radii, extra=2.5):
    """As bodies of the captures have them."""
    return [int(np.ceil(K * r + extra * (K * r) ** (1 / 3) + 1)) for r in radii]


def _echo(wave, scatterer, turn=None):
    turn = np.eye(3) if turn is None else turn
    rx, tx = (wave.echo.Dipoles((AT + s) @ turn.T, MOMENT @ turn.T) for s in (0.0, [0.01, 0.02, 0]))
    return wave.cluster.cluster_echoes([scatterer], [rx], [tx])[0, 0, :, 0]


def _pair(wave, turn=None, index=None):
    turn = np.eye(3) if turn is None else turn
    balls = [
        wave.cluster.Ball(radius, tuple(turn @ [0.0, 0.0, height]))
        for radius, height in zip(RADII, HEIGHTS, strict=True)
    ]
    return wave.cluster.cluster(balls, _orders(RADII), K, index)


def test_two_spheres_agree_with_the_method_of_moments(wave):
    curves = [
        wave.meridian.Meridian.circle(radius, height)
        for radius, height in zip(RADII, HEIGHTS, strict=True)
    ]
    at = wave.meridian.joined([curve.ring(105) for curve in curves])
    depth = 1.5 / 70
    source = wave.meridian.joined([curve.ring(70, depth * curve.length_m) for curve in curves])
    both = wave.body.metal_body(at, source, K, wave.waves.highest_order(K * 0.009), 128)
    rx, tx = (wave.echo.Dipoles(AT + s, MOMENT) for s in (0.0, [0.01, 0.02, 0]))
    expected = wave.echo.echoes([both], [rx], [tx])[0, 0, :, 0]
    found = _echo(wave, _pair(wave))
    assert np.abs(found - expected).max() < 1e-4 * np.abs(expected).max()
    ball = wave.cluster.Ball
    alone = sum(
        _echo(wave, wave.cluster.cluster([ball(r, (0, 0, z))], _orders([r]), K))
        for r, z in zip(RADII, HEIGHTS, strict=True)
    )
    assert np.abs(alone - expected).max() > 0.5 * np.abs(expected).max()


@pytest.mark.parametrize("index", [None, 1.6 + 0.01j])
def test_a_turned_cluster_echoes_alike_and_is_reciprocal(wave, index):
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    turned = _pair(wave, turn, index)
    assert turned.residual < 1e-6
    expected = _echo(wave, _pair(wave, index=index))
    found = _echo(wave, turned, turn)
    assert np.abs(found - expected).max() < 1e-4 * np.abs(expected).max()


def test_one_sphere_of_a_cluster_is_mies(wave):
    radius, middle = 0.004, np.array([0.003, -0.002, 0.005])
    (order,) = _orders([radius], extra=6.0)
    scatterer = wave.cluster.cluster([wave.cluster.Ball(radius, tuple(middle))], [order], K, 1.6)
    mie = wave.body.sphere_scatterer(wave.waves.sphere(radius, K, order, 1.6), K)
    rx, tx = (wave.echo.Dipoles(AT - middle + s, MOMENT) for s in (0.0, [0.01, 0.02, 0]))
    expected = wave.echo.echoes([mie], [rx], [tx])[0, 0, :, 0]
    assert np.abs(_echo(wave, scatterer) - expected).max() < 1e-5 * np.abs(expected).max()


def test_bodies_turned_by_their_symmetry_are_the_same(wave):
    for name in ("ring", "molecule", "beads"):
        body = wave.bodies.BODIES[name]
        angle = np.deg2rad(body.alike_deg)
        c, s = np.cos(angle), np.sin(angle)
        middles = np.array([[ball.radius_m, *ball.middle_m] for ball in body.balls])
        turned = middles.copy()
        turned[:, 1:3] = middles[:, 1:3] @ [[c, s], [-s, c]]
        for row in turned:
            assert np.abs(middles - row).max(axis=1).min() < 1e-9
