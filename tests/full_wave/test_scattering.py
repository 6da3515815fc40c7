"""Scattering matrices: Mie's series, the method of moments, and echoes between dipoles."""

import numpy as np
import pytest

from reference.mie import mie_backscatter_rcs

K = 1655.0  # 79 GHz


def _deviation(scatterer, other):
    pairs = zip(scatterer.blocks, other.blocks, strict=True)
    return max(np.abs(one - two).max() for one, two in pairs)


def _moments(wave, curve, size, n=60, depth=1.5):
    """Scatterer of a meridian at k such that k times its reach is `size`."""
    k = size / curve.reach_m
    spacing = curve.length_m / n
    n_max = wave.waves.highest_order(size)
    at, source = curve.ring(n + n // 2), curve.ring(n, depth * spacing)
    return wave.body.metal_body(at, source, k, n_max, 128)


def test_the_method_of_moments_agrees_with_mie_to_1e_3(wave):
    found = _moments(wave, wave.meridian.Meridian.circle(0.01), 8.0)
    mie = wave.waves.sphere(0.01, found.k, found.n_max)
    assert _deviation(found, wave.body.sphere_scatterer(mie, found.k)) < 1e-5
    assert found.residual < 1e-3


@pytest.mark.parametrize("index", [1.6, 1.6 + 0.02j])
def test_the_method_of_moments_of_a_dielectric_agrees_with_mie_to_1e_3(wave, index):
    radius, k, n = 0.01, 500.0, 50
    curve = wave.meridian.Meridian.circle(radius)
    depth, n_max = 1.5 * curve.length_m / n, wave.waves.highest_order(k * radius)
    outside = curve.ring(n, -depth)
    outside = outside._replace(n_rho=-outside.n_rho, n_z=-outside.n_z)
    rings = curve.ring(n + n // 2), curve.ring(n, depth), outside
    found = wave.body.dielectric_body(*rings, k, n_max, index, 128)
    mie = wave.waves.sphere(radius, k, n_max, index)
    assert _deviation(found, wave.body.sphere_scatterer(mie, k)) < 1e-3
    assert found.residual < 2e-3


def test_a_sphere_away_from_the_origin_conserves_energy_and_echoes_as_one_at_it(wave):
    shift = 0.003
    at = np.array([[0.3, 0.1, 0.05], [0.2, -0.2, 0.3]])
    up = np.broadcast_to([0.0, 0.0, 1.0], at.shape)
    moved = _moments(wave, wave.meridian.Meridian.circle(0.005, shift), 10.0)
    assert moved.energy_error() < 1e-4
    n_max = wave.waves.highest_order(0.005 * moved.k)
    mie = wave.body.sphere_scatterer(wave.waves.sphere(0.005, moved.k, n_max), moved.k)
    there, here = wave.echo.Dipoles(at, up), wave.echo.Dipoles(at - [0, 0, shift], up)
    expected = wave.echo.echoes([mie], [here], [here])[0, 0]
    found = wave.echo.echoes([moved], [there], [there])[0, 0]
    assert np.abs(found - expected).max() < 1e-4 * np.abs(expected).max()


def test_a_body_with_a_neck_conserves_energy(wave):
    corners = [(0, -8), (5, -8), (5, 2), (2.5, 4), (2.5, 8), (0, 8)]
    curve = wave.meridian.Meridian.smoothed(1e-3 * np.array(corners), 0.0008)
    assert _moments(wave, curve, 10.0, n=100).energy_error() < 1e-3


def test_too_few_sources_show_in_the_residual(wave):
    curve = wave.meridian.Meridian.circle(0.01)
    assert _moments(wave, curve, 8.0, n=8).residual > 0.05


def test_a_mirror_image_gives_the_modes_of_negative_order(wave):
    """Antennas at y and -y see the same echo of a body whose M and N are coupled."""
    curve = wave.meridian.Meridian.circle(0.005, 0.003)
    moved = _moments(wave, curve, 8.0)
    at, direction = np.array([[0.2, 0.1, 0.1]]), np.array([[0.3, 0.8, 0.5]])
    flip = np.array([1.0, -1.0, 1.0])
    ends = [wave.echo.Dipoles(at, direction), wave.echo.Dipoles(at * flip, direction * flip)]
    one, two = (wave.echo.echoes([moved], [end], [end])[0, 0, 0, 0] for end in ends)
    assert one == pytest.approx(two, rel=1e-9)


@pytest.mark.parametrize("index", [None, 1.6, 1.6 + 0.01j])
def test_mie_conserves_or_absorbs_energy(wave, index):
    k, radius = K, 0.004
    n_max = wave.waves.highest_order(k * radius)
    sphere = wave.body.sphere_scatterer(wave.waves.sphere(radius, k, n_max, index), k)
    absorbed = 1 - np.abs(1 + 2 * np.diag(sphere.blocks[1])[:3]) ** 2
    if index == 1.6 + 0.01j:
        assert (absorbed > 1e-3).all()
    else:
        assert sphere.energy_error() < 1e-12


def test_a_small_dielectric_sphere_is_a_dipole_of_rayleigh(wave):
    index, x = 1.5, 0.01
    electric = wave.waves.sphere(x, 1.0, 2, index)[1, 0]
    expected = 2j / 3 * x**3 * (index**2 - 1) / (index**2 + 2)
    assert electric == pytest.approx(expected, rel=1e-3)


def test_far_echoes_have_mies_cross_section(wave):
    radius, range_m = 0.01, 1e4
    sphere = wave.waves.sphere(radius, K, wave.waves.highest_order(K * radius))
    at = range_m * np.array([[0.48, 0.6, 0.64]])
    across = np.array([[0.8, 0.0, -0.6]])
    end = wave.echo.Dipoles(at, across)
    echo = wave.echo.echoes([wave.body.sphere_scatterer(sphere, K)], [end], [end])[0, 0, 0, 0]
    found = 4 * np.pi * range_m**4 * abs(echo) ** 2
    expected = mie_backscatter_rcs(radius, K * wave.waves.C0 / (2 * np.pi))
    assert found == pytest.approx(expected, rel=1e-4)


def test_a_large_near_sphere_echoes_as_physical_optics(wave):
    radius, range_m = 0.02, 0.4
    sphere = wave.waves.sphere(radius, K, wave.waves.highest_order(K * radius))
    end = wave.echo.Dipoles(np.array([[range_m, 0, 0]]), np.array([[0, 0, 1.0]]))
    echo = wave.echo.echoes([wave.body.sphere_scatterer(sphere, K)], [end], [end])[0, 0, 0, 0]
    gap = range_m - radius
    expected = -radius / (2 * gap * range_m) * np.exp(2j * K * gap)
    # The next term of the asymptotic series is 1 / (2 k a), 0.015 here.
    assert abs(echo - expected) < 0.03 * abs(expected)


def test_echoes_between_the_computed_frequencies_are_exact_to_1e_5(wave):
    radius = 0.01
    rng = np.random.default_rng(0)
    at = rng.uniform((0.3, -0.1, -0.1), (0.5, 0.1, 0.1), (7, 3))
    end = wave.echo.Dipoles(at, np.broadcast_to([0.0, 0.0, 1.0], at.shape))

    def spheres(wavenumbers):
        n_max = wave.waves.highest_order(max(wavenumbers) * radius)
        return [
            wave.body.sphere_scatterer(wave.waves.sphere(radius, k, n_max), k) for k in wavenumbers
        ]

    wanted = np.linspace(1620, 1696, 9)
    nodes = wave.echo.nodes(1620, 1696, 8)
    few = wave.echo.echoes(spheres(nodes), [end], [end])[0, 0]
    found = wave.echo.interpolated(few, nodes, wanted, 2 * end.ranges)
    exact = wave.echo.echoes(spheres(wanted), [end], [end])[0, 0]
    assert np.abs(found - exact).max() < 1e-5 * np.abs(exact).max()


def test_a_mesh_of_a_meridian_is_closed_and_outward(wave):
    from geraf2.geometry.triangles import count_open_edges, enclosed_volume_m3  # noqa: PLC0415

    mesh = wave.meridian.Meridian.circle(0.01).mesh(0.0005)
    assert count_open_edges(mesh.faces) == 0
    volume = enclosed_volume_m3(mesh.vertices, mesh.faces)
    assert volume == pytest.approx(4 / 3 * np.pi * 1e-6, rel=0.01)


def test_mie_agrees_with_an_independent_code_to_1e_6(wave):
    treams = pytest.importorskip("treams", reason="treams is absent", exc_type=ImportError)
    radius, index, n_max = 0.003, 1.6, 8
    own = wave.waves.sphere(radius, K, n_max, index)
    materials = [treams.Material(index**2), treams.Material(1)]
    theirs = treams.TMatrix.sphere(n_max, K, [radius], materials, poltype="parity")
    modes, values = theirs.basis, np.diag(np.asarray(theirs))
    for pol, order, value in zip(modes.pol, modes.l, values, strict=True):
        assert own[pol, order - 1] == pytest.approx(value, abs=1e-6)
