"""Walls of real boxes against sums, samples and turned plates."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.io.mesh import write_mesh
from geraf2.ops.physical_optics import physical_optics
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Wall
from geraf2.simulation import (
    DisturbanceSpec,
    FigureSpec,
    NumericsSpec,
    ScanSpec,
    SceneSpec,
    WorldSpec,
    simulate,
)
from geraf2.simulation.dielectric import n_crossings
from geraf2.simulation.echo import EchoScene, Layer, plane_echo, wall_layers
from geraf2.simulation.simulate import _patch_amplitudes
from geraf2.simulation.solids import build_solid
from geraf2.simulation.spec import AWR1843
from geraf2.simulation.walls import edge_lines, wall_shapes
from helpers.antennas import blocks_of

BOX = Wall(size_m=(0.22, 0.2, 0.18), thickness_m=0.004, permittivity=1.6, center_m=(0.01, 0, 0))
INNER = Wall(size_m=(0.12, 0.1, 0.09), thickness_m=0.003, permittivity=1.8)
NOTHING = MeshScene(np.array([[0, 0, 9.0], [0, 1, 9], [1, 0, 9]]), np.array([[0, 1, 2]]))
C = 299792458.0
SPEC = SceneSpec(
    figure=FigureSpec(name="hammer", height_m=0.03),
    walls=(BOX,),
    scan=ScanSpec(n_poses=1, aperture_m=(0.018, 0.018), spacing_m=0.006),
    numerics=NumericsSpec(wall_patch_m=0.01),
    disturbance=DisturbanceSpec(snr_db=np.inf),
)


def shape(seed=0, walls=(BOX,), **world):
    return wall_shapes(replace(SPEC, walls=walls, world=WorldSpec(**world)), seed)[0]


def signals(spec=SPEC, **world):
    capture, _ = simulate(replace(spec, world=WorldSpec(**world)), seed=0)
    return np.concatenate([pose.signal for pose in capture.poses])


def test_a_bulge_is_the_sum_of_its_modes_reaches_its_size_and_keeps_the_edges():
    bulged, half = shape(wall_bulge_m=0.003), 0.5 * np.asarray(BOX.size_m)
    grid = np.linspace(-1.0, 1.0, 41)
    for axis in range(3):
        sides = half[[(axis + 1) % 3, (axis + 2) % 3]]
        u, v = (g.ravel() for g in np.meshgrid(sides[0] * grid, sides[1] * grid, indexing="ij"))
        for side in (-1.0, 1.0):
            got, slope = bulged.displacement(axis, side, u, v)
            assert np.abs(got).max() == pytest.approx(0.003)
            rim = (np.abs(u) == sides[0]) | (np.abs(v) == sides[1])
            assert np.abs(got[rim]).max() < 1e-12
            weights = bulged.weights_m[axis, int(side > 0)]
            for i in range(0, u.size, 97):
                position = (u[i] / sides[0] + 1) / 2, (v[i] / sides[1] + 1) / 2
                slow = sum(
                    weights[m - 1, n - 1]
                    * np.sin(m * np.pi * position[0])
                    * np.sin(n * np.pi * position[1])
                    for m in (1, 2, 3)
                    for n in (1, 2, 3)
                )
                assert got[i] == pytest.approx(slow, abs=1e-12)
            for k, step in enumerate(([1e-6, 0.0], [0.0, 1e-6])):
                high = bulged.displacement(axis, side, u + step[0], v + step[1])[0]
                low = bulged.displacement(axis, side, u - step[0], v - step[1])[0]
                assert slope[:, k] == pytest.approx((high - low) / 2e-6, abs=1e-7)


@pytest.mark.parametrize("inside", [False, True])
def test_the_echo_of_a_bulged_wall_is_the_integral_over_it(inside):
    """First face of the wall across x that faces the radar, against points half a millimetre apart.

    The points know nothing of patches, form factors or layers: a height over a plane, its slopes
    by differences, and the boundary integral of docs/math/echo-models.md#physical-optics-echo.
    """
    bulged = shape(wall_bulge_m=0.003)
    side = -1.0 if inside else 1.0
    half = 0.5 * np.asarray(BOX.size_m) - (BOX.thickness_m if inside else 0.0)
    lines = [np.arange(-h + 2.5e-4, h, 5e-4) for h in half[1:]]
    y, z = np.meshgrid(*lines, indexing="ij")
    height = bulged.displacement(0, side, y, z)[0]
    points = np.stack([BOX.center_m[0] + side * (half[0] + height), y, z], axis=-1)
    normals = np.cross(*(np.gradient(points, 5e-4, axis=k) for k in (0, 1)))  # of length dA / dy dz
    position = np.array([0.4, 0.01, -0.02])
    ray = position - points
    distance = np.linalg.norm(ray, axis=-1)
    cos = (normals * ray).sum(axis=-1) / distance / np.linalg.norm(normals, axis=-1)
    within = np.sqrt(1.6 - 1 + cos**2)
    r = (cos - within) / (cos + within)
    weights = (normals * ray).sum(axis=-1) / distance**3
    path = 2.0 * distance + AWR1843.path_bias_m
    if inside:  # through the near wall and back
        entry = ray[..., 0] / distance
        slab = np.sqrt(1.6 - 1 + entry**2)
        weights = weights * (1 - ((entry - slab) / (entry + slab)) ** 2) ** 2
        path = path + 2.0 * 0.004 * (slab - entry)
    expected = np.zeros(4, complex)
    for face, more in ((r, 0.0), (-r * (1 - r**2), 2.0 * 0.004 * within)):
        turns = np.exp(-2j * np.pi * (path + more)[..., None] * AWR1843.frequencies_hz[::8] / C)
        summed = ((face * weights)[..., None] * turns).sum(axis=(0, 1))
        expected += 1j / (4 * np.pi) * 2.5e-7 * summed
    layer = wall_layers((BOX,), 0.005, (bulged,))[int(inside)]
    towards = layer.elements.normals[:, 0] > 0.5
    antennas = blocks_of([position, position])
    only = Layer(
        elements=layer.elements,
        areas=layer.areas * towards,
        can_be_hidden=False,
        walls=layer.walls,
    )
    scene = EchoScene(waveform=AWR1843, walls=(BOX,), blocker=NOTHING, figure=only)
    got = plane_echo(scene, antennas).figure[0, ::8]
    assert np.abs(got - expected).max() < 0.03 * np.abs(expected).max()


def test_a_turned_box_is_a_scene_turned_oppositely_in_a_straight_one(tmp_path):
    spec = replace(SPEC, walls=(replace(BOX, center_m=(0, 0, 0)),))
    mesh, angle = build_solid(spec.figure), np.deg2rad(-2.0)
    x, y, z = mesh.vertices.T
    turned = np.stack(
        [np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, z], axis=1
    )
    write_mesh(replace(mesh, vertices=turned), tmp_path / "turned.ply", frame="capture")
    middle = 0.5 * (turned.min(axis=0) + turned.max(axis=0))
    figure = FigureSpec(mesh=str(tmp_path / "turned.ply"), height_m=0.03, center_m=tuple(middle))
    other = replace(spec, figure=figure, scan=replace(spec.scan, start_angle_deg=-2.0))
    assert signals(spec, box_turn_deg=2.0) == pytest.approx(signals(other), abs=2e-3)


def test_crossings_are_those_of_samples_along_the_leg():
    rng = np.random.default_rng(0)
    starts = np.array([[0.4, 0.02, 0.03], [0.3, 0.3, -0.1]])
    points = rng.uniform(-0.16, 0.16, (60, 3))
    boxes = [(np.asarray(w.center_m), 0.5 * np.asarray(w.size_m)) for w in (BOX, INNER)]
    expected = np.zeros((2, 60), int)
    for i, start in enumerate(starts):
        legs = start + np.linspace(0.0, 1.0, 20001)[None, :, None] * (points - start)[:, None]
        for center, half in boxes:
            inside = (np.abs(legs - center) < half).all(axis=2)
            expected[i] += np.abs(np.diff(inside.astype(int), axis=1)).sum(axis=1)
    assert np.array_equal(n_crossings(starts, points, (BOX, INNER)), expected)
    assert set(expected.ravel()) >= {0, 1, 2, 3, 4}


def test_a_lossy_wall_takes_its_share_at_each_crossing():
    tx = np.array([[0.4, 0.0, 0.0], [0.4, 0.006, 0.0]])
    antennas = blocks_of(tx, tx - [0, 0.005, 0])
    outside, inside = wall_layers((BOX,), 0.02)
    scene = EchoScene(
        waveform=AWR1843, walls=(BOX,), blocker=NOTHING, figure=outside, wall_amplitude=0.9
    )

    def direct(layer):
        lit = np.maximum(np.sign(layer.elements.normals @ [1.0, 0, 0]), 0)[None] * layer.areas
        lossy = replace(layer.elements, slab_crossing=0.9)
        return physical_optics(lossy, lit.astype(complex), antennas, AWR1843, walls=(BOX,))

    def lit_only(layer):
        chosen = layer.elements.normals[:, 0] > 0.5
        return Layer(elements=layer.elements, areas=layer.areas * chosen, can_be_hidden=False)

    for layer, power in ((outside, 0), (inside, 2)):
        got = plane_echo(replace(scene, figure=lit_only(layer)), antennas).figure
        expected = 0.9**power * direct(layer)
        assert got == pytest.approx(expected, rel=1e-3, abs=1e-3 * np.abs(expected).max())


def test_lines_are_dense_all_there_and_as_strong_as_asked():
    lines = edge_lines(BOX)
    steps = [np.linalg.norm(np.diff(line, axis=0), axis=1) for line in lines]
    assert max(step.max() for step in steps) <= AWR1843.center_wavelength_m / 4
    length = sum(step.sum() + step[0] for step in steps)
    # Edges; two strips of tape over top and bottom, each 5 cm down both sides; two lines a strip.
    assert length == pytest.approx(4 * (0.22 + 0.2 + 0.18) + 4 * 0.2 + 8 * 0.05, abs=0.01)
    positions = np.abs(np.concatenate(lines) - BOX.center_m) / (0.5 * np.asarray(BOX.size_m))
    assert positions.max(axis=1) == pytest.approx(1.0, abs=0.003)
    free = replace(SPEC, walls=())
    assert np.array_equal(signals(free, edge_energy_fraction=0.1), signals(free))
    plain = signals()
    mixed = signals(edge_energy_fraction=0.5)
    part = np.vdot(plain, mixed) / np.vdot(plain, plain)
    assert 0.01 < np.linalg.norm(mixed - part * plain) / np.linalg.norm(mixed) < 0.7


def test_patches_weaken_half_of_a_surface_in_pieces_of_their_length():
    world = WorldSpec(patch_loss_db=6.0, patch_length_m=0.02)
    line = np.arange(0.0, 40.0, 0.002)[:, None] * [1.0, 0.0, 0.0]
    kept = _patch_amplitudes(replace(SPEC, world=world), line, 0)
    assert set(kept) == {1.0, 10 ** (-0.3)}
    assert np.mean(kept < 1.0) == pytest.approx(0.5, abs=0.05)
    # Rice: a process of covariance exp(-x^2 / 2 L^2) changes sign every pi L.
    changes = np.count_nonzero(np.diff(kept))
    assert 40.0 / changes == pytest.approx(np.pi * 0.02, rel=0.2)
