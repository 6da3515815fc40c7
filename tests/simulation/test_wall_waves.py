"""Far walls by waves against Fresnel integrals, Lommel functions and a direct double integral."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.special import fresnel, jv

from geraf2.ops.physical_optics import physical_optics
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Wall
from geraf2.simulation.elements import select, wall_elements
from geraf2.simulation.shadow_waves import FaceFrame, Shadow, lattice_over
from geraf2.simulation.spec import AWR1843
from geraf2.simulation.wall_waves import box_faces, is_square, shadow_echo
from geraf2.simulation.walls import BoxScene
from helpers.antennas import blocks_of

C = 299792458.0
FREQUENCY = 79e9
WAVELENGTH = C / FREQUENCY
EYE_M, SHEET_M = 0.5, 0.1  # of the antenna and of the sheet over the wall
BOX = Wall(size_m=(0.12, 0.12, 0.12), thickness_m=0.004, permittivity=1.6)


def shadow_on_wall(mesh, half_m, eye=(0.0, 0.0, EYE_M)):
    """V on the wall z = 0 at 2.5 mm, eye and sheet above it; and the cells' positions."""
    frame = FaceFrame(origin=np.zeros(3), rows=np.eye(3))
    half = np.array([half_m, half_m])
    shadow = Shadow(
        MeshScene(mesh.vertices, mesh.faces),
        frame,
        lattice_over(-half, half, 0.00125),
        lattice_over(-np.array([0.08, 0.08]), np.array([0.08, 0.08]), 0.0025),
        SHEET_M,
        np.array([FREQUENCY]),
    )
    squared = 1.0 + shadow.change(np.asarray(eye))[:, 0].astype(np.complex128)
    return squared, shadow.wall.positions(0.0)[:, :2]


def fresnel_between(low, high):
    """(1 + j) / 2 times the integral of exp(-j pi t^2 / 2): 1 over all t."""
    (s_low, c_low), (s_high, c_high) = fresnel(low), fresnel(high)
    return (1 + 1j) / 2 * (c_high - c_low - 1j * (s_high - s_low))


def test_shadow_of_a_plates_edge_is_that_of_fresnel_integrals():
    # From y = 0 on, ends far away: near y = 0 a half plane.
    plate = trimesh.creation.box(bounds=[[-0.12, 0.0, 0.0999], [0.12, 0.12, 0.1001]])
    squared, positions = shadow_on_wall(plate, 0.12)
    length = SHEET_M * (EYE_M - SHEET_M) / EYE_M
    scale = np.sqrt(2.0 / (WAVELENGTH * length))
    crossing = positions * (EYE_M - SHEET_M) / EYE_M
    blocked = fresnel_between(
        scale * (-0.12 - crossing[:, 0]), scale * (0.12 - crossing[:, 0])
    ) * fresnel_between(scale * (0.0 - crossing[:, 1]), scale * (0.12 - crossing[:, 1]))
    near = (np.abs(positions) < 0.03).all(axis=1)
    got, wanted = np.abs(np.sqrt(squared[near])), np.abs(1.0 - blocked[near])
    assert wanted.min() < 0.15
    assert wanted.max() > 1.15
    assert np.sqrt(np.mean((got - wanted) ** 2)) < 0.03


def lommel_v(order, u, v):
    terms = np.arange(30)
    powers = order + 2 * terms
    return np.sum((-1.0) ** terms * (v[:, None] / u) ** powers * jv(powers, v[:, None]), axis=1)


def test_poissons_spot_behind_a_disc_is_lommels():
    radius = 0.02
    disc = trimesh.creation.cylinder(radius=radius, height=2e-4, sections=256)
    disc.apply_translation([0.0, 0.0, SHEET_M])
    squared, positions = shadow_on_wall(disc, 0.025)
    # abs(V)^2 = V0(u, v)^2 + V1(u, v)^2 in the shadow (Born and Wolf, section 8.8).
    k = 2 * np.pi / WAVELENGTH
    off = np.linalg.norm(positions, axis=1) * (EYE_M - SHEET_M) / EYE_M
    near = off < 0.012
    length = SHEET_M * (EYE_M - SHEET_M) / EYE_M
    u, v = k * radius**2 / length, k * radius * off[near] / length
    wanted = lommel_v(0, u, v) ** 2 + lommel_v(1, u, v) ** 2
    got = np.sqrt(np.abs(squared[near]))
    # The rim is seen at 11 degrees, whose cosine, 0.981, is not in Lommel's functions.
    assert got[np.argmin(v)] == pytest.approx(0.981, abs=0.03)
    assert np.sqrt(np.mean((got - np.sqrt(wanted)) ** 2)) < 0.04


def far_face(box, cell_m=0.0025):
    patches, areas = wall_elements(box, cell_m, inside=True)
    keep = next(m for m in box_faces(patches) if patches.points[m, 0].max() < 0)
    return select(patches, keep), areas[keep]


def blocks(positions, apart_m=0.0):
    half = np.array([0.0, apart_m / 2, 0.0])
    return blocks_of(positions + half, positions - half, offsets=np.arange(len(positions) + 1))


def bare_echo(face, areas, antennas, waveform, walls):
    weights = np.broadcast_to(areas.astype(np.complex64), (len(antennas.tx), len(areas)))
    return physical_optics(face, weights, antennas, waveform, walls=walls)


def test_bare_wall_echoes_as_its_mirror_image_times_fresnel_integrals():
    waveform = replace(AWR1843, n_samples=1, path_bias_m=0.0)
    box = replace(BOX, size_m=(0.2, 0.2, 0.2))
    face, areas = far_face(box)
    positions = np.stack([np.full(7, 0.4), np.linspace(-0.05, 0.05, 7), np.full(7, 0.01)], axis=1)
    got = bare_echo(replace(face, slab_crossing=0.0), areas, blocks(positions), waveform, ())[:, 0]
    k = 2 * np.pi * waveform.frequencies_hz[0] / C
    distance, half = 0.4 + 0.096, 0.096
    r = (1 - np.sqrt(1.6)) / (1 + np.sqrt(1.6))
    wanted = r / (4 * k * distance) * np.exp(-2j * k * distance)
    scale = 2.0 / np.sqrt(2 * np.pi / k * distance)
    for axis in (1, 2):
        wanted = wanted * fresnel_between(
            scale * (-half - positions[:, axis]), scale * (half - positions[:, axis])
        )
    assert np.abs(np.abs(got / wanted) - 1.0).max() < 0.05


def test_nothing_is_left_of_a_wall_behind_a_larger_plate():
    plate = trimesh.creation.box(extents=[0.002, 0.2, 0.2])
    scene = BoxScene(blocker=MeshScene(plate.vertices, plate.faces), walls=(BOX,), waveform=AWR1843)
    antennas = blocks(0.01 * np.array([[40.0, y, 0.5] for y in (-0.6, 0.0, 0.6)]), 0.005)
    face, areas = far_face(BOX)
    bare = bare_echo(face, areas, antennas, AWR1843, (BOX,))
    left = bare + shadow_echo(scene, face, areas, antennas)
    assert np.linalg.norm(left) < 0.06 * np.linalg.norm(bare)


def direct_echo(antenna_pair, rim, points, normals, areas, slab, frequency):
    """(U0 + Us) of the transmitter times that of the receiver, summed over the wall; no near wall.

    rim: points of the sheet, (n, 3), and their area each.
    """
    k = 2 * np.pi * frequency / C
    fields = []
    for antenna in antenna_pair:
        range_m = np.linalg.norm(points - antenna, axis=1)
        field = np.exp(-1j * k * range_m) / range_m
        sheet, cell = rim
        out = np.linalg.norm(sheet - antenna, axis=1)
        for start in range(0, len(points), 500):
            part = slice(start, start + 500)
            on = points[part, None] - sheet
            r = np.linalg.norm(on, axis=2)
            kernel = (1j * k + 1 / r) * -on[..., 0] / r * np.exp(-1j * k * (r + out)) / r / out
            field[part] -= cell / (2 * np.pi) * kernel.sum(axis=1)
        fields.append(field)
    toward = [antenna - points for antenna in antenna_pair]
    cosine = np.mean([np.sum(t * normals, 1) / np.linalg.norm(t, axis=1) for t in toward], axis=0)
    inner = np.sqrt(slab.permittivity - 1 + cosine**2)
    r = (cosine - inner) / (cosine + inner)
    both = r * (1 - (1 - r**2) * np.exp(-2j * k * slab.thickness_m * inner))
    return 1j / (4 * np.pi) * np.sum(areas * cosine * both * fields[0] * fields[1])


def test_echo_is_the_direct_double_integral_over_a_bulged_wall():
    waveform = replace(AWR1843, n_samples=1, path_bias_m=0.0)
    face, areas = far_face(BOX, 0.002)
    bulge = 0.003 * np.cos(np.pi / 0.112 * face.points[:, 1]) - 0.0015
    points = face.points + bulge[:, None] * [1.0, 0.0, 0.0]
    slope = -0.003 * np.pi / 0.112 * np.sin(np.pi / 0.112 * face.points[:, 1])
    normals = np.stack([np.ones(len(points)), -slope, np.zeros(len(points))], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    face = replace(face, points=points, normals=normals)
    disc = trimesh.creation.cylinder(radius=0.02, height=2e-4, sections=128)
    disc.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
    scene = BoxScene(blocker=MeshScene(disc.vertices, disc.faces), walls=(), waveform=waveform)
    positions = np.array([[0.3, -0.01, 0.0], [0.3, 0.01, 0.005]])
    antennas = blocks(positions, 0.005)
    change = shadow_echo(scene, face, areas, antennas)
    weights = areas.astype(np.complex64)
    got = change + bare_echo(face, weights, antennas, waveform, ())
    line = np.arange(-0.01875, 0.02, 0.0015)
    y, z = (grid.ravel() for grid in np.meshgrid(line, line))
    within = y**2 + z**2 < 0.02**2
    sheet = np.stack([np.zeros(within.sum()), y[within], z[within]], axis=1)
    cell = np.pi * 0.02**2 / within.sum()
    wanted = np.array(
        [
            [
                direct_echo(pair, (sheet, cell), points, normals, areas, BOX, frequency)
                for frequency in waveform.frequencies_hz
            ]
            for pair in zip(antennas.tx, antennas.rx, strict=True)
        ]
    )
    bare = bare_echo(face, weights, antennas, waveform, ())
    assert np.linalg.norm(got - bare) > 0.4 * np.linalg.norm(bare)
    assert np.linalg.norm(got - wanted) < 0.03 * np.linalg.norm(bare)


@pytest.mark.parametrize(("height_m", "wanted"), [(0.5, True), (0.08, False), (0.05, False)])
def test_shadow_is_a_waves_only_from_well_above_the_figure(height_m, wanted):
    # From the object's own height its shadow has no end: the sheet once took 17 GB.
    face = far_face(BOX)[0]
    box = trimesh.creation.box(bounds=[[-0.06, -0.02, -0.02], [0.0, 0.02, 0.02]])
    normal = face.normals.mean(axis=0)
    middle = face.points.mean(axis=0)
    antennas = blocks(middle + height_m * normal + np.zeros((1, 3)))
    assert is_square(face, antennas, MeshScene(box.vertices, box.faces)) == wanted
