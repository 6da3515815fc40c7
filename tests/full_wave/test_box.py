"""Walls about a full-wave body: plates, their ends, images and shadows."""

import numpy as np
import pytest

from geraf2.scene import Wall

K = np.array([1630.0, 1680.0])
UP = np.array([0.0, 0.0, 1.0])


def _wall(side_m=0.16, permittivity=1.6):
    return Wall(size_m=(side_m,) * 3, thickness_m=0.004, permittivity=permittivity)


@pytest.mark.parametrize("angle_deg", [0.0, 20.0, 60.0])
def test_a_plate_without_loss_passes_what_it_does_not_reflect(wave, angle_deg):
    angle = np.deg2rad(angle_deg)
    step = np.array([[np.cos(angle), np.sin(angle), 0.0]])
    for r, t in zip(*wave.box.plate(wave.box.cosine_to(0, step), _wall(), K), strict=True):
        assert np.abs(r) ** 2 + np.abs(t) ** 2 == pytest.approx(np.ones((2, 1)), abs=1e-12)


def test_a_plate_passes_all_tm_at_brewsters_angle(wave):
    step = np.array([[1.0, np.sqrt(1.6), 0.0]])
    (te, tm), _ = wave.box.plate(wave.box.cosine_to(0, step), _wall(), K)
    assert np.abs(tm).max() < 1e-12 < np.abs(te).min()


def test_a_metal_wall_mirrors_the_antenna(wave):
    """A near wall of nearly infinite permittivity, large enough to have no end."""
    wall, at = _wall(200.0, 1e10), np.array([[100.3, 0.0, 0.0]])
    echo = wave.box.flashes(at, at, UP, wall, K)[0]
    assert echo == pytest.approx(-np.exp(2j * K * 0.3) / 0.6, rel=1e-2)


def test_the_field_over_the_edge_of_a_wall_is_half_that_of_a_plane(wave):
    meeting = np.array([[0.0, 0.0, 0.0], [0.0, 50.0, 0.0]])
    image, target = meeting - np.array([0.4, 0, 0]), meeting + np.array([0.1, 0, 0])
    middle, edge = wave.box._window(image, meeting, target, _wall(100.0), 0, K)[0]
    assert middle == pytest.approx(1.0, abs=1e-3)
    assert edge == pytest.approx(0.5, abs=1e-3)


def test_air_as_a_wall_changes_nothing(wave):
    antennas = np.array([[0.4, 0.02, 0.01], [0.4, 0.0, -0.05]])
    (leg,) = wave.box.legs(antennas, UP, _wall(permittivity=1.0 + 1e-12), K)
    assert leg.positions is antennas
    # Of the moments only what is along the path, which radiates nothing there, is gone.
    unit = antennas / np.linalg.norm(antennas, axis=1, keepdims=True)
    across = UP - (unit @ UP)[:, None] * unit
    assert np.abs(leg.directions - across).max() < 1e-9


def test_a_body_casts_its_shadow_on_the_far_wall(wave):
    """What antenna and image scatter to each other takes from the far wall's flash."""
    k, radius, wall = K[:1], 0.03, _wall()
    n_max = wave.waves.highest_order(k[0] * radius)
    ball = wave.body.sphere_scatterer(wave.waves.sphere(radius, k[0], n_max), k[0])
    side = np.linspace(-0.012, 0.012, 7)
    at = np.stack(np.meshgrid(0.4, side, side), -1).reshape(-1, 3)
    legs = wave.box.legs(at, UP, wall, k)
    ends = [wave.echo.Dipoles(leg.positions, leg.directions) for leg in legs]
    (mirror,) = (i for i, leg in enumerate(legs) if leg.positions[0, 0] < -0.4)
    found = wave.echo.echoes([ball], ends, ends)[..., 0]
    cross = found[0, mirror] + found[mirror, 0]
    over_wall = found[mirror, mirror]
    mirrored = wave.mirror.Mirror(np.array([-1.0, 0, 0]), 0.076, wall)
    again = wave.mirror.returned([ball], ends[0], ends[0], [mirrored])[0, :, 0]
    near = wave.box.flashes(at, at, UP, _wall(0.16), k)[:, 0]
    lined = wave.box._image(at, at, wave.box.direct(at, UP, k).directions, wall, k, (0, 0.08))
    length = np.linalg.norm(at - lined.positions, axis=1)
    front = (lined.directions[0] @ UP) * np.exp(1j * k * length) / length
    far = near - front
    shadowed = far + cross + over_wall + again
    assert np.linalg.norm(shadowed) < 0.6 * np.linalg.norm(far)
    assert np.linalg.norm(shadowed - again) > 1.2 * np.linalg.norm(far)  # a shadow cast twice


def test_what_a_mirror_returns_is_the_coupling_of_a_body_and_its_image(wave):
    """Two metal spheres, one the other's image, by the method of moments: all orders at once."""
    k, radius, h = 1655.0, 0.004, 0.02
    curves = [wave.meridian.Meridian.circle(radius, z) for z in (-h, h)]
    n = 48
    at = wave.meridian.joined([curve.ring(n + n // 2) for curve in curves])
    source = wave.meridian.joined([curve.ring(n, 1.5 * curves[0].length_m / n) for curve in curves])
    n_max = wave.waves.highest_order(k * (h + radius))
    both = wave.body.metal_body(at, source, k, n_max, 128)
    n_one = wave.waves.highest_order(k * radius)
    one = wave.body.sphere_scatterer(wave.waves.sphere(radius, k, n_one), k)
    antennas = np.array([[0.02, 0.01, -0.3], [0.0, 0.03, -0.25], [-0.04, 0.0, -0.35]])
    moment, flip = np.array([0.3, 1.0, 0.2]), np.array([1.0, 1.0, -1.0])
    pair = [(antennas, moment), (antennas * flip, -moment * flip)]

    def ends(shift):
        return [wave.echo.Dipoles(p + np.array([0, 0, shift]), np.tile(m, (3, 1))) for p, m in pair]

    real = ends(0.0)
    whole = wave.echo.echoes([both], real[:1], real)[0, :, :, 0].sum(axis=0)
    own = ends(h)
    once = wave.echo.echoes([one], own, own)[..., 0].sum(axis=(0, 1))
    mirrored = wave.mirror.Mirror(np.array([0, 0, 1.0]), h, _wall(1.0, 1e12))
    twice = sum(
        wave.mirror.returned([one], rx, tx, [mirrored])[0, :, 0] for rx in own for tx in own
    )
    coupling = whole - once
    assert np.abs(coupling).max() > 0.01 * np.abs(once).max()
    assert np.abs(twice - coupling).max() < 0.1 * np.abs(coupling).max()
