"""Effects of waves, second bounce and dielectric objects on a whole small capture."""

from dataclasses import replace

import numpy as np
import pytest

import geraf2
from geraf2.simulation import WorldSpec, simulate
from geraf2.simulation.dielectric import face_reflection


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
