"""Effects of waves, second bounce and dielectric objects on a whole small capture."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import geraf2
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Wall
from geraf2.simulation import WorldSpec, simulate
from geraf2.simulation.dielectric import face_reflection
from geraf2.simulation.echo import EchoScene, plane_echo, wall_layers
from geraf2.simulation.spec import AWR1843, FigureSpec, SceneSpec
from geraf2.simulation.wall_waves import box_faces
from geraf2.simulation.walls import wall_shapes
from helpers.antennas import blocks_of


def small_spec(**world):
    spec = geraf2.examples.small_scene()
    return replace(
        spec,
        figure=replace(spec.figure, name="chair", height_m=0.05),
        scan=replace(spec.scan, n_poses=1, spacing_m=0.01),
        disturbance=replace(spec.disturbance, snr_db=np.inf),
        numerics=replace(spec.numerics, antenna_block_m=0.07),
        world=WorldSpec(**world),
    )


def signal(**world):
    return simulate(small_spec(**world), seed=1, num_threads=2)[0].poses[0].signal


@pytest.fixture(scope="module")
def ideal():
    return signal()


@pytest.mark.parametrize("effect", ["wall_waves", "multipath", "second_bounce"])
def test_effect_changes_the_capture_and_threads_do_not(ideal, effect):
    got = signal(**{effect: True})
    change = np.linalg.norm(got - ideal) / np.linalg.norm(ideal)
    assert 0.002 < change < 0.8
    again = simulate(small_spec(**{effect: True}), seed=1, num_threads=1)[0].poses[0].signal
    assert (got == again).all()


def test_a_dielectric_figure_echoes_less_and_from_its_back_face_too():
    spec = small_spec()
    spec = replace(spec, walls=())
    metal, plastic, lossy = (
        simulate(replace(spec, world=WorldSpec(**world)), seed=1)[0].poses[0].signal
        for world in (
            {},
            {"figure_permittivity": 3.45},
            {"figure_permittivity": 3.45, "figure_loss_tangent": 2.0},
        )
    )
    assert face_reflection(np.ones(1), 3.45)[0] == pytest.approx(-0.3, abs=1e-4)
    # Nothing comes back through so much loss, and captures are of unit power: metal's is left.
    assert np.linalg.norm(lossy - metal) < 1e-3 * np.linalg.norm(metal)
    assert np.linalg.norm(plastic - metal) > 0.1 * np.linalg.norm(metal)


def test_a_bulged_skewed_lossy_wall_is_dark_behind_a_larger_plate():
    box = Wall(size_m=(0.12, 0.12, 0.12), thickness_m=0.004, permittivity=1.6)
    world = WorldSpec(preset="hard", effects=("bulge", "turn"))
    shapes = wall_shapes(SceneSpec(figure=FigureSpec(name="ball"), walls=(box,), world=world), 1)
    plate = trimesh.creation.box(extents=[0.002, 0.3, 0.3])
    layer = wall_layers((box,), 0.005, shapes, inside_patch_m=0.0025)[1]
    pair = layer.elements[0]
    far = next(m for m in box_faces(pair) if pair.points[m, 0].max() < -0.03)
    elements = tuple(
        replace(e, points=e.points[far], normals=e.normals[far], edges=e.edges[far])
        for e in layer.elements
    )
    layer = replace(layer, elements=elements, areas=layer.areas[far])
    scene = EchoScene(
        waveform=AWR1843,
        walls=(box,),
        blocker=MeshScene(plate.vertices, plate.faces),
        figure=replace(layer, areas=0.0 * layer.areas),
        wall_layers=(replace(layer, can_be_hidden=False),),
        wall_amplitude=0.9,
        wall_waves=True,
    )
    middles = np.array([[0.4, y, z] for y in (-0.006, 0.006) for z in (0.0, 0.004)])
    half = np.array([0.0, 0.0025, 0.0])
    antennas = blocks_of(middles + half, middles - half, pattern_exponent=6)
    bare = plane_echo(scene, antennas).walls
    left = plane_echo(replace(scene, wall_layers=(layer,)), antennas).walls
    assert np.linalg.norm(left) < 0.03 * np.linalg.norm(bare)
