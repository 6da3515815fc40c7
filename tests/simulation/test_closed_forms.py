"""Echoes against closed forms: Mie sphere, flat plate, image in a wall.

Cross-sections follow from abs(s)^2 = lambda^2 sigma / ((4 pi)^3 R^4).
"""

import numpy as np
import pytest

from geraf2.ops.physical_optics import physical_optics
from geraf2.scene import Wall
from geraf2.simulation.elements import mesh_elements, select, wall_elements
from helpers.antennas import blocks_of
from helpers.solids import ball
from helpers.synthetic import waveform_of
from reference.mie import mie_backscatter_rcs

C = 299792458.0
WAVEFORM = waveform_of(path_bias_m=0.0)
FREQUENCIES = WAVEFORM.frequencies_hz
WAVELENGTHS = C / FREQUENCIES
LIMIT_M = 0.0012


def monostatic(elements, areas, positions):
    """Signal at antennas that are alone in their block, so that form factors are their own."""
    positions = np.atleast_2d(positions)
    antennas = blocks_of(positions, offsets=np.arange(len(positions) + 1))
    weights = np.broadcast_to(areas, (len(positions), len(areas))).astype(np.complex128)
    return physical_optics(elements, weights, antennas, WAVEFORM)


def cross_section(signal, range_m):
    return np.abs(signal) ** 2 * (4 * np.pi) ** 3 * range_m**4 / WAVELENGTHS**2


def plate_elements(side):
    half = side / 2
    vertices = np.array([[0, -half, -half], [0, half, -half], [0, half, half], [0, -half, half]])
    return mesh_elements(vertices, np.array([[0, 1, 2], [0, 2, 3]]), LIMIT_M)


def test_mie_series_tends_to_the_geometric_cross_section():
    radius = 0.3  # ka = 490: sigma / (pi a^2) is 1 to a few parts in a thousand
    assert mie_backscatter_rcs(radius, 78e9) == pytest.approx(np.pi * radius**2, rel=5e-3)


def test_mie_series_has_rayleighs_slope_and_factor():
    # sigma = 9 pi a^2 (ka)^4 for a small metal sphere
    radius, frequency = 1e-5, 78e9
    x = 2 * np.pi * frequency / C * radius
    assert mie_backscatter_rcs(radius, frequency) == pytest.approx(
        9 * np.pi * radius**2 * x**4, rel=1e-3
    )


def test_metal_sphere_within_half_a_decibel_of_mie_over_the_band():
    radius, range_m = 0.03, 50.0  # ka = 49: the shadow edge's own echo is 1 / ka = 0.18 dB
    mesh = ball(radius, 5)
    elements, areas = mesh_elements(mesh.vertices, mesh.faces, LIMIT_M)
    got = cross_section(monostatic(elements, areas, [range_m, 0.0, 0.0])[0], range_m)
    mie = np.array([mie_backscatter_rcs(radius, f) for f in FREQUENCIES])
    error_db = 10 * np.log10(got / mie)
    assert np.abs(error_db).max() < 0.5


def test_flat_plate_peak_null_and_lobes_within_a_fifth_of_a_decibel():
    side, range_m = 0.04, 200.0
    elements, areas = plate_elements(side)
    wavelength = C / FREQUENCIES[0]
    null = np.arcsin(wavelength / (2 * side))
    angles = np.concatenate(
        [np.linspace(0, 0.7, 8) * null, np.linspace(1.2, 1.8, 7) * null, [null]]
    )
    positions = range_m * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    got = cross_section(monostatic(elements, areas, positions), range_m)[:, 0]
    peak = 4 * np.pi * side**4 / wavelength**2
    assert 10 * np.log10(got[0] / peak) == pytest.approx(0.0, abs=0.2)
    lobes = np.cos(angles) ** 2 * np.sinc(2 * side / wavelength * np.sin(angles)) ** 2
    assert np.abs(10 * np.log10(got[:-1] / (peak * lobes[:-1]))).max() < 0.2
    assert got[-1] < 1e-4 * peak


def range_gated(signal, path_m, half_width_m):
    """Mean over the band of the part of a signal that arrives near a path length."""
    window = np.hanning(len(FREQUENCIES) + 2)[1:-1]
    paths = path_m + np.linspace(-half_width_m, half_width_m, 3)
    bank = np.exp(2j * np.pi * np.outer(paths, FREQUENCIES) / C) * window / window.sum()
    return bank @ signal


def test_wall_reflects_like_an_infinite_slab_at_normal_incidence():
    wall = Wall(size_m=(0.3, 0.3, 0.3), thickness_m=0.004, permittivity=1.6)
    range_m = 0.25
    position = np.array([0.15 + range_m, 0.0, 0.0])
    patches, areas = wall_elements(wall, 0.005, inside=False)
    front = patches.points[:, 0] > 0.15
    got = monostatic(select(patches, front), areas[front], position)[0]
    # Image of the antenna 2 R away; both faces of the slab, no inner reflections.
    n = np.sqrt(1.6)
    r = (1 - n) / (1 + n)
    wavenumbers = 2 * np.pi * FREQUENCIES / C
    slab = r * (1 - (1 - r**2) * np.exp(-2j * wavenumbers * n * 0.004))
    image = slab / (2 * wavenumbers * 2 * range_m) * np.exp(-2j * wavenumbers * range_m)
    # The edges' echoes, 39 mm of path later, are gated out as far as 3.6 GHz can.
    gated, expected = (range_gated(s, 2 * range_m, 1e-6)[1] for s in (got, image))
    assert 20 * np.log10(abs(gated / expected)) == pytest.approx(0.0, abs=0.5)
    assert np.angle(gated / expected) == pytest.approx(0.0, abs=0.06)
